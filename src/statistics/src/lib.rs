//! Statistics of episodes: intervals of proportions and tests of paired runs. Knows
//! neither tables nor traces.

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng as _},
};

/// Standard normal quantile of 0.975: two-sided 95 %.
const Z_95: f64 = 1.959_963_984_540_054;

/// Wilson's score interval of a proportion (Wilson 1927) at 95 %, from 0 to 1; none for no trials
/// or more successes than trials.
pub fn wilson(successes: f64, trials: f64) -> Option<(f64, f64)> {
    if !(trials > 0.0 && (0.0..=trials).contains(&successes)) {
        return None;
    }
    let (share, square) = (successes / trials, Z_95 * Z_95);
    let centre = share + square / (2.0 * trials);
    let spread = Z_95 * (share * (1.0 - share) / trials + square / (4.0 * trials * trials)).sqrt();
    let scale = 1.0 + square / trials;
    Some((
        ((centre - spread) / scale).max(0.0),
        ((centre + spread) / scale).min(1.0),
    ))
}

/// The two-sided p-value of McNemar's exact test: how likely it is that of paired runs so many
/// succeed only in one and so many only in the other, if both are equally good. Twice the smaller
/// tail of Binomial(n, 1/2), at most 1; none for what are no numbers of runs.
pub fn mcnemar(only_a: f64, only_b: f64) -> Option<f64> {
    let whole =
        |value: f64| (value >= 0.0 && value.fract() == 0.0 && value < 1e7).then_some(value as u64);
    let (a, b) = (whole(only_a)?, whole(only_b)?);
    let (n, few) = (a + b, a.min(b));
    if n == 0 {
        return Some(1.0);
    }
    // log of C(n, k) / 2^n, term by term
    let mut log_term = -(n as f64) * std::f64::consts::LN_2;
    let mut tail = log_term.exp();
    for k in 1..=few {
        log_term += ((n - k + 1) as f64 / k as f64).ln();
        tail += log_term.exp();
    }
    Some((2.0 * tail).min(1.0))
}

/// Mean, and the 2.5 and 97.5 % percentiles of the means of resampled lists. Equal
/// seeds give equal intervals.
pub fn bootstrap(differences: &[f64], samples: usize, seed: u64) -> Option<[f64; 3]> {
    if differences.is_empty() {
        return None;
    }
    let n = differences.len();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut mean = || {
        (0..n)
            .map(|_| differences[((u128::from(random.next_u64()) * n as u128) >> 64) as usize])
            .sum::<f64>()
            / n as f64
    };
    let mut means: Vec<f64> = (0..samples).map(|_| mean()).collect();
    means.sort_by(f64::total_cmp);
    let percentile = |share: f64| means[((samples - 1) as f64 * share).round() as usize];
    Some([
        differences.iter().sum::<f64>() / n as f64,
        percentile(0.025),
        percentile(0.975),
    ])
}

/// Whole numbers below a bound, each as likely as the others. Equal seeds give equal numbers.
pub fn uniform(seed: u64) -> impl FnMut(u32) -> u32 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    move |bound| ((u128::from(random.next_u64()) * u128::from(bound)) >> 64) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_agrees_with_the_textbook() {
        // Newcombe 1998, table I: 81 of 263 and 0 of 20
        let (low, high) = wilson(81.0, 263.0).unwrap();
        assert!(
            (low - 0.2553).abs() < 5e-5 && (high - 0.3662).abs() < 5e-5,
            "{low} {high}"
        );
        let (low, high) = wilson(0.0, 20.0).unwrap();
        assert!(
            low.abs() < 1e-12 && (high - 0.1611).abs() < 5e-5,
            "{low} {high}"
        );
        assert_eq!((wilson(1.0, 0.0), wilson(3.0, 2.0)), (None, None));
    }

    #[test]
    fn mcnemar_is_the_binomial_tail() {
        assert!((mcnemar(9.0, 1.0).unwrap() - 2.0 * 11.0 / 1024.0).abs() < 1e-12);
        assert_eq!(mcnemar(0.0, 0.0), Some(1.0));
        assert_eq!(mcnemar(5.0, 5.0), Some(1.0));
        assert!(mcnemar(3000.0, 2000.0).unwrap() < 1e-40);
        assert_eq!(mcnemar(-1.0, 1.0), None);
    }

    #[test]
    fn the_bootstrap_is_a_function_of_its_seed() {
        let differences: Vec<f64> = (0..100)
            .map(|index| f64::from(u8::from(index % 4 == 0)))
            .collect();
        let [mean, low, high] = bootstrap(&differences, 2000, 7).unwrap();
        assert_eq!(bootstrap(&differences, 2000, 7), Some([mean, low, high]));
        assert!(
            (mean - 0.25).abs() < 1e-12
                && (0.13..0.20).contains(&low)
                && (0.30..0.37).contains(&high),
            "{low} {high}"
        );
        assert_eq!(bootstrap(&[], 10, 1), None);
    }
}
