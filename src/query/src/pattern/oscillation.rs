//! Going back and forth between two receptacles: the mark of Lost Memory. Counts only;
//! never judges an episode.

/// The longest back and forth of an episode.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Oscillation {
    /// `nav_to` calls in the run: 3 for A-B-A, 4 for A-B-A-B.
    pub length: usize,
    /// Index of its first step.
    pub first_step: usize,
}

/// The longest run of directly consecutive `nav_to` calls that alternate between two receptacles
/// (A-B-A...), the first of them if several are equally long; `None` below three calls.
///
/// `places` holds, step by step, where the call went: `None` for every tool but `nav_to` and for a
/// `nav_to` without an argument. Same rule as `queries/oscillations.sql`.
///
/// ```
/// use reel_query::pattern::{Oscillation, oscillation};
/// let places = [Some("bed"), Some("table"), Some("bed"), Some("table"), None, Some("bed")];
/// assert_eq!(oscillation(places), Some(Oscillation { length: 4, first_step: 0 }));
/// ```
pub fn oscillation<T: PartialEq>(
    places: impl IntoIterator<Item = Option<T>>,
) -> Option<Oscillation> {
    let mut longest: Option<Oscillation> = None;
    let (mut before_last, mut last) = (None, None);
    let mut turns = 0;
    for (step, place) in places.into_iter().enumerate() {
        let turned_back =
            place.is_some() && place == before_last && last.is_some() && place != last;
        turns = if turned_back { turns + 1 } else { 0 };
        if turns > 0 && longest.is_none_or(|run| turns + 2 > run.length) {
            longest = Some(Oscillation {
                length: turns + 2,
                first_step: step - turns - 1,
            });
        }
        (before_last, last) = (last, place);
    }
    longest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Letters are receptacles, `.` is another tool.
    fn run(text: &str) -> Option<(usize, usize)> {
        let places = text.chars().map(|place| (place != '.').then_some(place));
        oscillation(places).map(|run| (run.length, run.first_step))
    }

    #[test]
    fn only_an_unbroken_alternation_counts() {
        for quiet in ["", "a", "ab", "aaa", "abc", "ab.a", "a.a", ".a.", "abba"] {
            assert_eq!(run(quiet), None, "{quiet}");
        }
        assert_eq!(run("aba"), Some((3, 0)));
        assert_eq!(run("cabab"), Some((4, 1)));
        assert_eq!(run("aba.bab.abab"), Some((4, 8)));
        assert_eq!(run("abab.baba"), Some((4, 0)), "the first of equals");
        assert_eq!(
            run("abacac"),
            Some((4, 2)),
            "a run ends where a third receptacle comes in"
        );
        assert_eq!(run("ab.ab"), None);
    }
}
