//! From attributed episodes to success rates with intervals: exact binomial intervals with the
//! effective sample size of tasks that were played several times, and of branches that are not
//! always what the agent would have done. Never draws anything at random.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Attributed, Capability};

/// A share with its 95 % interval, from 0 to 1.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Interval {
    /// The estimated share, from 0 to 1.
    pub value: f64,
    /// Lower bound at 95 %.
    pub low: f64,
    /// Upper bound at 95 %.
    pub high: f64,
}

/// What perfecting one capability does to the success rate of a group of episodes.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Estimate {
    /// The group, e.g. a run, policy or family.
    pub group: String,
    /// The capability that was made perfect.
    pub capability: Capability,
    /// Episodes of the group that ended.
    pub episodes: usize,
    /// Distinct tasks among them.
    pub tasks: usize,
    /// Success rate as observed.
    pub observed: f64,
    /// Success rate with the capability perfect.
    pub perfect: Interval,
    /// The difference of the two.
    pub difference: Interval,
    /// Branches that were played.
    pub branches: usize,
    /// Failed episodes of which no branch could be played; they count as failed.
    pub no_future: usize,
}

/// The estimates of every group, in the order of groups and of [`Capability::ALL`]. Episodes that
/// were broken off are left out.
pub fn estimates(episodes: &[Attributed], group: impl Fn(&Attributed) -> String) -> Vec<Estimate> {
    let mut groups: BTreeMap<String, Vec<&Attributed>> = BTreeMap::new();
    for episode in episodes.iter().filter(|one| one.success.is_some()) {
        groups.entry(group(episode)).or_default().push(episode);
    }
    let mut all = Vec::new();
    for (name, members) in groups {
        for capability in Capability::ALL {
            all.extend(estimate(&name, &members, capability));
        }
    }
    all
}

fn estimate(group: &str, members: &[&Attributed], capability: Capability) -> Option<Estimate> {
    let clustered = |flag: &dyn Fn(&Attributed) -> bool| {
        let mut tasks: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        for one in members {
            let (hits, count) = tasks.entry(&one.task_id).or_default();
            *hits += usize::from(flag(one));
            *count += 1;
        }
        tasks.into_values().collect::<Vec<_>>()
    };
    let observed = |one: &Attributed| one.success == Some(true);
    let perfect = |one: &Attributed| one.success_with(capability) == Some(true);
    let rescued = clustered(&|one| perfect(one) && !observed(one));
    let branches = || {
        let all = members.iter().flat_map(|one| &one.capabilities);
        all.filter(move |one| one.capability == capability)
    };
    let successes = members.iter().filter(|one| observed(one)).count();
    let failures = members.len() - successes;
    let mistaken = mistaken_share(capability) * failures as f64 / members.len() as f64;
    Some(Estimate {
        group: group.to_owned(),
        capability,
        episodes: members.len(),
        tasks: rescued.len(),
        observed: successes as f64 / members.len() as f64,
        perfect: clustered_interval(&clustered(&perfect), mistaken)?,
        difference: clustered_interval(&rescued, mistaken)?,
        branches: branches().filter(|one| one.played).count(),
        no_future: branches()
            .filter(|one| !one.played && one.reason.is_some())
            .count(),
    })
}

/// Share of failed episodes whose branch ended otherwise than the agent without the faults of this
/// capability: of the 532 failed ones of `SEEDS=developing make eval-attribution`, 6, 6, 93 and 0.
const fn mistaken_share(capability: Capability) -> f64 {
    match capability {
        Capability::Perception | Capability::Communication => 6.0 / 532.0,
        Capability::Memory => 93.0 / 532.0,
        Capability::Primitives => 0.0,
    }
}

/// The share of hits over clusters of `(hits, trials)` with the interval of Clopper and Pearson
/// (1934) on the effective sample size (Korn and Graubard 1998): trials over the design effect of
/// the clusters, lessened where there are few of them to estimate it from, at most as many as there
/// are trials. `mistaken` is the share of trials whose hit
/// or miss may be wrong either way; its variance lessens the sample size. `None` without trials.
pub fn clustered_interval(clusters: &[(usize, usize)], mistaken: f64) -> Option<Interval> {
    let clusters: Vec<(f64, f64)> = clusters
        .iter()
        .filter(|(_, trials)| *trials > 0)
        .map(|(hits, trials)| (*hits as f64, *trials as f64))
        .collect();
    let trials: f64 = clusters.iter().map(|(_, trials)| trials).sum();
    let count = clusters.len() as f64;
    if clusters.is_empty() {
        return None;
    }
    let value = clusters.iter().map(|(hits, _)| hits).sum::<f64>() / trials;
    let binomial = value * (1.0 - value) / (trials - 1.0).max(1.0);
    // Where no cluster differs from another nothing tells how alike the trials of one are.
    let mut effective = if clusters.len() == 1 { 1.0 } else { count };
    if clusters.len() > 1 && binomial > 0.0 {
        let deviation = |(hits, trials): &(f64, f64)| (hits - value * trials).powi(2);
        let between: f64 = clusters.iter().map(deviation).sum();
        let variance = count / (count - 1.0) * between / (trials * trials);
        let few = student_square(trials - 1.0) / student_square(count - 1.0);
        effective = (trials * binomial / variance.max(binomial) * few).clamp(1.0, trials);
    }
    let sampled = (value * (1.0 - value)).max(1.0 / trials);
    effective = (effective * sampled / (sampled + mistaken)).clamp(1.0, trials);
    let (low, high) = exact(value * effective, effective);
    Some(Interval { value, low, high })
}

/// Bounds of a binomial share at 95 %, also for numbers of trials that are not whole.
fn exact(hits: f64, trials: f64) -> (f64, f64) {
    let misses = trials - hits;
    let low = if hits <= 1e-9 {
        0.0
    } else {
        beta_quantile(0.025, hits, misses + 1.0)
    };
    let high = if misses <= 1e-9 {
        1.0
    } else {
        beta_quantile(0.975, hits + 1.0, misses)
    };
    (low, high)
}

/// The square of Student's t at 0.975, two-sided 95 %.
fn student_square(freedom: f64) -> f64 {
    freedom * (1.0 / beta_quantile(0.05, freedom / 2.0, 0.5) - 1.0)
}

/// The quantile of a beta distribution, by bisection.
fn beta_quantile(probability: f64, a: f64, b: f64) -> f64 {
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    for _ in 0..80 {
        let middle = (low + high) / 2.0;
        if beta_cdf(middle, a, b) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    (low + high) / 2.0
}

/// The regularized incomplete beta function, by its continued fraction (Numerical Recipes 6.4).
fn beta_cdf(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_cdf(1.0 - x, b, a);
    }
    let scale = a * x.ln() + b * (1.0 - x).ln() + ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b);
    let tiny = |value: f64| if value.abs() < 1e-300 { 1e-300 } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / tiny(1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = d;
    for step in 1..500 {
        let m = f64::from(step);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        for term in [even, odd] {
            d = 1.0 / tiny(1.0 + term * d);
            c = tiny(1.0 + term / c);
            fraction *= c * d;
        }
        if (c * d - 1.0).abs() < 1e-14 {
            break;
        }
    }
    (scale.exp() * fraction / a).clamp(0.0, 1.0)
}

/// The logarithm of the gamma function for positive numbers (Lanczos, g = 7).
fn ln_gamma(x: f64) -> f64 {
    const COEFFICIENTS: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    if x < 0.5 {
        let pi = std::f64::consts::PI;
        return (pi / (pi * x).sin()).ln() - ln_gamma(1.0 - x);
    }
    let x = x - 1.0;
    let t = x + 7.5;
    let terms = COEFFICIENTS.iter().enumerate().skip(1);
    let sum = COEFFICIENTS[0] + terms.map(|(i, c)| c / (x + i as f64)).sum::<f64>();
    0.5 * (2.0 * std::f64::consts::PI).ln() + (x + 0.5) * t.ln() - t + sum.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: f64, wanted: f64) {
        assert!((found - wanted).abs() < 5e-5, "{found} is not {wanted}");
    }

    #[test]
    fn one_trial_a_task_gives_the_interval_of_clopper_and_pearson() {
        // Newcombe 1998, table I, method 5: 81 of 263 and 0 of 20.
        let mut clusters = vec![(1, 1); 81];
        clusters.extend(vec![(0, 1); 182]);
        let found = clustered_interval(&clusters, 0.0).unwrap();
        assert!((found.low - 0.2527).abs() < 5e-4, "{}", found.low);
        assert!((found.high - 0.3676).abs() < 5e-4, "{}", found.high);
        let none = clustered_interval(&[(0, 1); 20], 0.0).unwrap();
        near(none.low, 0.0);
        near(none.high, 0.1684);
        let all = clustered_interval(&[(1, 1); 20], 0.0).unwrap();
        near(all.low, 1.0 - 0.1684);
        assert_eq!(clustered_interval(&[], 0.0), None);
    }

    #[test]
    fn trials_that_repeat_their_task_count_once() {
        let alone: Vec<(usize, usize)> = (0..40).map(|task| (task % 2, 1)).collect();
        let repeated: Vec<(usize, usize)> = (0..40).map(|task| (5 * (task % 2), 5)).collect();
        let (alone, repeated) = (
            clustered_interval(&alone, 0.0).unwrap(),
            clustered_interval(&repeated, 0.0).unwrap(),
        );
        assert!(
            (alone.low - repeated.low).abs() < 0.01,
            "{alone:?} {repeated:?}"
        );
        let independent = vec![(2, 5), (3, 5), (2, 5), (3, 5), (2, 5), (3, 5)];
        let narrow = clustered_interval(&independent, 0.0).unwrap();
        // 30 trials, whose design effect comes from six clusters: 30 * (2.0452 / 2.5706)^2.
        near(narrow.low, exact(18.99 / 2.0, 18.99).0);
    }

    #[test]
    fn few_tasks_tell_little_however_often_they_were_played() {
        near(student_square(1.0).sqrt(), 12.7062);
        near(student_square(5.0).sqrt(), 2.57058);
        near(student_square(1e5).sqrt(), 1.95999);
        let two = clustered_interval(&[(14, 20), (6, 20)], 0.0).unwrap();
        assert!(two.low < 0.05 && two.high > 0.95, "{two:?}");
    }

    #[test]
    fn branches_that_may_be_mistaken_widen_the_interval() {
        let clusters: Vec<(usize, usize)> = (0..200)
            .map(|task| (usize::from(task % 4 == 0), 1))
            .collect();
        let [sure, unsure] = [0.0, 0.1].map(|share| clustered_interval(&clusters, share).unwrap());
        let width = |one: Interval| one.high - one.low;
        // The variances add: 0.25 * 0.75 of sampling and 0.1 of mistakes.
        let wanted = (1.0_f64 + 0.1 / 0.1875).sqrt();
        let found = width(unsure) / width(sure);
        assert!((found - wanted).abs() < 0.03, "{found} is not {wanted}");
    }
}
