//! Names as numbers: a sorted index that grows by what only records know, and forgets that again.
//! Never reads a name.

/// Most names beyond the task's own that are kept from one episode to the next.
const EXTRA_MAX: usize = 4096;

/// Names and their numbers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Names {
    names: Vec<Box<str>>,
    /// Fingerprint and number of each, sorted.
    sorted: Vec<(u64, u32)>,
    /// How many of them the task knows.
    known: usize,
}

impl Names {
    /// The number of a name, new or old.
    pub(crate) fn number(&mut self, name: &str) -> u32 {
        let fingerprint = fingerprint(name);
        let first = self
            .sorted
            .partition_point(|(other, _)| *other < fingerprint);
        let alike = self.sorted[first..]
            .iter()
            .take_while(|(other, _)| *other == fingerprint);
        if let Some((_, number)) = alike
            .clone()
            .find(|(_, number)| *self.names[*number as usize] == *name)
        {
            return *number;
        }
        let number = u32::try_from(self.names.len()).expect("an episode has few names");
        let at = first + alike.count();
        self.names.push(name.into());
        self.sorted.insert(at, (fingerprint, number));
        number
    }

    pub(crate) fn name(&self, number: u32) -> &str {
        &self.names[number as usize]
    }

    pub(crate) fn len(&self) -> usize {
        self.names.len()
    }

    /// What came so far stays for ever.
    pub(crate) fn keep(&mut self) {
        self.known = self.names.len();
    }

    /// Whether a name is one of those that stay.
    pub(crate) fn is_kept(&self, number: u32) -> bool {
        (number as usize) < self.known
    }

    /// Forgets names beyond those that stay, if there are too many; true if so.
    pub(crate) fn trim(&mut self) -> bool {
        let too_many = self.names.len() > self.known + EXTRA_MAX;
        if too_many {
            self.names.truncate(self.known);
            self.sorted
                .retain(|(_, number)| (*number as usize) < self.known);
        }
        too_many
    }
}

/// Tells nearly all names apart by one number, so that a search compares numbers and only one text.
/// Names here share long beginnings and ends.
fn fingerprint(name: &str) -> u64 {
    const ODD: u64 = 0x9e37_79b9_7f4a_7c15;
    let mix = |sum: u64, word: u64| (sum.rotate_left(23) ^ word).wrapping_mul(ODD);
    let mut words = name.as_bytes().chunks_exact(8);
    let mut sum = name.len() as u64;
    for word in words.by_ref() {
        sum = mix(
            sum,
            u64::from_le_bytes(word.try_into().expect("eight bytes")),
        );
    }
    words
        .remainder()
        .iter()
        .fold(sum, |sum, byte| mix(sum, u64::from(*byte)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_one_fingerprint_are_told_apart() {
        let mut names = Names::default();
        let a = names.number("a");
        // as if "b" had the fingerprint of "c"
        names.names.push("b".into());
        names.sorted.insert(0, (fingerprint("c"), 1));
        names.sorted.sort_unstable();
        let c = names.number("c");
        assert_eq!(
            (names.number("a"), names.number("c"), names.name(c)),
            (a, c, "c")
        );
        assert_ne!(c, 1);
    }

    #[test]
    fn numbers_stay_and_extra_names_are_forgotten() {
        let mut names = Names::default();
        let [b, a] = ["b", "a"].map(|name| names.number(name));
        names.keep();
        assert_eq!(
            (names.number("a"), names.number("b"), names.name(a)),
            (a, b, "a")
        );
        for extra in 0..EXTRA_MAX {
            names.number(&format!("extra {extra}"));
        }
        assert!(!names.trim());
        names.number("one more");
        assert!(names.trim());
        assert_eq!(
            (names.len(), names.number("a"), names.number("c")),
            (2, a, 2)
        );
    }
}
