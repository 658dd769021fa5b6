//! Searches whose first candidates are known.

use super::*;

/// Values of episodes that turn from 1 to 0 at the given candidates.
fn values(turns: &[usize], candidate: usize) -> Values {
    let value = |turn: &usize| f64::from(u8::from(candidate < *turn));
    let named = turns.iter().enumerate();
    named
        .map(|(number, turn)| (format!("episode {number}"), value(turn)))
        .collect()
}

/// Measures what is asked for; gives the search and how much was measured.
fn run(candidates: usize, measure: impl Fn(usize) -> Option<Values>) -> (Bisection, usize) {
    let mut bisection = Bisection::new(candidates);
    let mut measured = 0;
    while let Some(candidate) = bisection.next_candidate() {
        bisection.record(candidate, measure(candidate));
        measured += 1;
        assert!(measured <= candidates, "nothing is measured twice");
    }
    (bisection, measured)
}

#[test]
fn every_episode_and_the_mean_find_their_first_candidate() {
    for candidates in 2..40 {
        for turn in 1..candidates {
            let turns = [turn, candidates - 1, candidates + 1, 1];
            let (bisection, measured) = run(candidates, |at| Some(values(&turns, at)));
            let changes = bisection.changes();
            assert_eq!(changes.len(), 3, "the third never turns");
            for (number, turn) in [(0, turn), (1, candidates - 1), (3, 1)] {
                let change = changes[&format!("episode {number}")];
                assert_eq!((change.first_bad, change.is_settled()), (turn, true));
                assert_eq!((change.good, change.bad), (1.0, 0.0));
            }
            let mean = bisection.mean_change().unwrap();
            assert!(mean.is_settled(), "{mean:?}");
            let steps = candidates.ilog2() as usize + 1;
            assert!(measured <= 2 + 4 * steps, "{measured} of {candidates}");
        }
    }
}

#[test]
fn one_change_takes_a_logarithm_of_measurements() {
    let (bisection, measured) = run(1000, |at| Some(values(&[617], at)));
    assert_eq!(bisection.changes()["episode 0"].first_bad, 617);
    assert!(measured <= 12, "{measured}");
}

#[test]
fn candidates_that_cannot_be_measured_are_passed_over() {
    let (bisection, _) = run(9, |at| (at != 4).then(|| values(&[7], at)));
    assert_eq!(bisection.changes()["episode 0"].first_bad, 7);
    let (bisection, _) = run(9, |at| (![4, 5].contains(&at)).then(|| values(&[5], at)));
    let change = bisection.changes()["episode 0"];
    assert_eq!((change.last_good, change.first_bad), (3, 6));
    assert!(!change.is_settled());
}

#[test]
fn an_end_that_cannot_be_measured_ends_the_search() {
    let (bisection, measured) = run(9, |at| (at != 0).then(|| values(&[7], at)));
    assert_eq!((measured, bisection.changes().len()), (2, 0));
    assert_eq!((bisection.mean_change(), bisection.paired()), (None, 0));
}

#[test]
fn what_changes_back_and_forth_gives_neighbours_that_were_measured() {
    let flickers =
        |at: usize| Values::from([("e".to_owned(), f64::from(u8::from(at.is_multiple_of(2))))]);
    let (bisection, _) = run(10, |at| Some(flickers(at)));
    let change = bisection.changes()["e"];
    assert!(change.is_settled());
    let value = |candidate| bisection.values(candidate).unwrap()["e"];
    assert_eq!(
        (value(change.last_good), value(change.first_bad)),
        (1.0, 0.0)
    );
}

#[test]
fn an_episode_that_one_candidate_lacks_is_searched_beside_it() {
    let (bisection, _) = run(5, |at| {
        let mut values = values(&[3, 3], at);
        if at == 2 {
            values.remove("episode 1");
        }
        Some(values)
    });
    let changes = bisection.changes();
    assert_eq!(changes["episode 0"].last_good, 2);
    assert_eq!(changes["episode 1"].last_good, 1);
    // A mean over other episodes is none of this row.
    let mean = bisection.mean_change().unwrap();
    assert_eq!((mean.last_good, mean.first_bad), (1, 3));
    assert!(!mean.is_settled());
    assert_eq!(bisection.mean(2), None);
}
