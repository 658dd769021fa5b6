//! Between two sets of episodes: which classes of failure grew, and whether more than
//! chance explains. Fisher's exact test, two-sided, with Holm's correction for the number
//! of classes (Holm 1979).

use serde::Serialize;

/// A class in two sets of episodes.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Drift {
    /// Class, or class and sub-class.
    pub name: String,
    /// Episodes of the class before.
    pub before: u64,
    /// Episodes of the class in the later set.
    pub after: u64,
    /// Change of its share of all episodes, successes included.
    pub difference: f64,
    /// Probability of a table at least as uneven where nothing changed.
    pub p: f64,
    /// That, corrected for the number of classes.
    pub p_corrected: f64,
    /// Whether the corrected probability is below 0.05.
    pub significant: bool,
}

/// Compares counts of classes (name, before, after) in `before` and `after` episodes, successes
/// included. The strongest evidence first.
pub fn drift(counts: &[(String, u64, u64)], before: u64, after: u64) -> Vec<Drift> {
    let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
    let mut found: Vec<Drift> = counts
        .iter()
        .map(|(name, one, other)| Drift {
            name: name.clone(),
            before: *one,
            after: *other,
            difference: share(*other, after) - share(*one, before),
            p: fisher_exact(*one, before - one, *other, after - other),
            p_corrected: 1.0,
            significant: false,
        })
        .collect();
    found.sort_by(|one, other| {
        one.p
            .total_cmp(&other.p)
            .then_with(|| one.name.cmp(&other.name))
    });
    let (count, mut least) = (found.len(), 0.0_f64);
    for (index, class) in found.iter_mut().enumerate() {
        least = least.max((class.p * (count - index) as f64).min(1.0));
        class.p_corrected = least;
        class.significant = least < 0.05;
    }
    found
}

/// Two-sided: the probability of all tables with these margins that are no likelier
/// than the one given.
fn fisher_exact(a: u64, b: u64, c: u64, d: u64) -> f64 {
    let (row, other_row, column) = (a + b, c + d, a + c);
    let log_choose = |n: u64, k: u64| log_factorial(n) - log_factorial(k) - log_factorial(n - k);
    let whole = log_choose(row + other_row, column);
    let log_p = |a: u64| log_choose(row, a) + log_choose(other_row, column - a) - whole;
    let observed = log_p(a);
    let range = column.saturating_sub(other_row)..=row.min(column);
    // tables that are equally likely differ by rounding
    let likely = range.map(log_p).filter(|p| *p <= observed + 1e-7);
    likely.map(f64::exp).sum::<f64>().min(1.0)
}

fn log_factorial(n: u64) -> f64 {
    libm::lgamma(n as f64 + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of R's `fisher.test` and of the tea-tasting table of Fisher (1935).
    #[test]
    fn the_exact_test_gives_the_known_values() {
        for (table, p) in [
            ([3, 1, 1, 3], 0.485_714_285_7),
            ([8, 2, 1, 5], 0.034_965_035_0),
            ([0, 10, 0, 10], 1.0),
            ([10, 0, 0, 10], 1.082_509e-5),
        ] {
            let found = fisher_exact(table[0], table[1], table[2], table[3]);
            assert!((found - p).abs() < 1e-9, "{table:?}: {found}");
        }
        assert!((fisher_exact(5_000, 995_000, 5_400, 994_600) - 8.2e-5).abs() < 1e-5);
    }

    #[test]
    fn many_classes_need_stronger_evidence() {
        let counts: Vec<_> = [("grew", 2, 30), ("same", 10, 11), ("a bit", 4, 13)]
            .map(|(name, one, other)| (name.to_owned(), one, other))
            .into();
        let found = drift(&counts, 100, 100);
        assert_eq!(found[0].name, "grew");
        assert!(found[0].significant && (found[0].difference - 0.28).abs() < 1e-12);
        let bit = found.iter().find(|class| class.name == "a bit").unwrap();
        assert!(bit.p < 0.05 && !bit.significant, "{bit:?}");
        assert!(found.iter().all(|class| class.p_corrected >= class.p));
        assert_eq!(drift(&[("none".into(), 0, 0)], 0, 0)[0].p, 1.0);
    }
}
