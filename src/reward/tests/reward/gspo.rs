//! The quantities of GSPO: fixed numbers, errors, and NumPy beside us where it is installed.

use std::{
    io::Write,
    process::{Command, Stdio},
};

use proptest::{prelude::*, strategy::ValueTree, test_runner::TestRunner};
use reel_reward::{
    Estimator, RewardError, Scale, discounted_return, group_relative,
    gspo::{
        ClipRange, KlEstimator, clip_share, clipped_term, kl, objective, sequence_ratio,
        token_ratios,
    },
};
use serde_json::{Value, json};

/// Largest distance from a reference, relative above 1.
const TOLERANCE: f64 = 1e-12;

#[track_caller]
fn equal(found: f64, expected: f64) {
    assert!(
        (found - expected).abs() <= TOLERANCE * expected.abs().max(1.0),
        "found {found:e}, expected {expected:e}"
    );
}

#[test]
fn advantages_are_relative_to_the_group() {
    let found = group_relative(&[1.0, 2.0, 3.0, 6.0], 0.0);
    let deviation = 3.5_f64.sqrt();
    found
        .iter()
        .zip([-2.0, -1.0, 0.0, 3.0])
        .for_each(|(found, above)| equal(*found, above / deviation));
    equal(group_relative(&[1.0, 3.0], 1.0)[1], 0.5);
    assert_eq!(group_relative(&[4.0; 3], 0.0), [0.0; 3]);
    assert!(group_relative(&[], 0.1).is_empty());
    equal(
        discounted_return(&[1.0, 1.0, 1.0], 0.99),
        1.0 + 0.99 + 0.9801,
    );
}

/// Worked by hand: log-ratios ln 2, ln 2, -ln 4 and 0 have the mean 0; without the last two
/// it is ln 2.
#[test]
fn ratios_and_estimates_of_known_numbers() {
    let ln2 = std::f64::consts::LN_2;
    let (new, old) = (
        [-1.0 + ln2, -2.0 + ln2, -3.0 - 2.0 * ln2, -0.5],
        [-1.0, -2.0, -3.0, -0.5],
    );
    equal(sequence_ratio(&new, &old).unwrap(), 1.0);
    equal(sequence_ratio(&new[..2], &old[..2]).unwrap(), 2.0);
    token_ratios(&new, &old)
        .unwrap()
        .iter()
        .zip([2.0, 2.0, 0.25, 1.0])
        .for_each(|(found, expected)| equal(*found, expected));
    // policy = new, reference = old: d is -ln 2, -ln 2, 2 ln 2, 0
    equal(kl(KlEstimator::K1, &new, &old).unwrap(), 0.0);
    equal(
        kl(KlEstimator::K2, &new, &old).unwrap(),
        6.0 * ln2 * ln2 / 8.0,
    );
    equal(
        kl(KlEstimator::K3, &new, &old).unwrap(),
        (0.5 - 1.0 + 0.5 - 1.0 + 4.0 - 1.0) / 4.0,
    );
    assert!(
        KlEstimator::ALL
            .iter()
            .all(|estimator| KlEstimator::parse(estimator.as_str()) == Some(*estimator))
    );
}

#[test]
fn the_objective_of_a_group_of_four() {
    let (ratios, advantages, kl) = (
        [1.5, 0.5, 1.5, 0.5],
        [1.0, 1.0, -2.0, -2.0],
        [0.1, 0.2, 0.3, 0.4],
    );
    let range = ClipRange::new(0.2, 0.4).unwrap();
    // 1.4 (clipped above), 0.5, -3.0, -1.6 (clipped below)
    let terms: Vec<f64> = ratios
        .iter()
        .zip(advantages)
        .map(|(ratio, advantage)| clipped_term(*ratio, advantage, range))
        .collect();
    terms
        .iter()
        .zip([1.4, 0.5, -3.0, -1.6])
        .for_each(|(found, expected)| equal(*found, expected));
    let found = objective(&ratios, &advantages, &kl, range, 0.04).unwrap();
    equal(found.surrogate, -2.7 / 4.0);
    equal(found.kl, 0.25);
    equal(found.loss, 2.7 / 4.0 + 0.01);
    assert_eq!((found.clipped.low, found.clipped.high), (0.25, 0.25));
    let wide = clip_share(&ratios, &advantages, ClipRange::symmetric(0.5).unwrap()).unwrap();
    assert_eq!(
        (wide.low, wide.high),
        (0.0, 0.0),
        "on the border is not outside"
    );
}

#[test]
fn what_does_not_fit_together_is_refused() {
    assert_eq!(sequence_ratio(&[], &[]), Err(RewardError::Empty));
    assert_eq!(
        sequence_ratio(&[-1.0], &[]),
        Err(RewardError::Lengths {
            expected: 1,
            found: 0
        })
    );
    let error = sequence_ratio(&[-1.0, f64::NEG_INFINITY], &[-1.0, -1.0]).unwrap_err();
    assert_eq!(
        error,
        RewardError::LogProbability {
            token: 1,
            new: f64::NEG_INFINITY,
            old: -1.0
        }
    );
    assert_eq!(
        ClipRange::new(0.1, -0.1),
        Err(RewardError::ClipRadius { found: -0.1 })
    );
    assert!(ClipRange::symmetric(f64::NAN).is_err());
    assert_eq!(
        sequence_ratio(&[0.0], &[-9999.0]),
        Err(RewardError::Overflow { log_ratio: 9999.0 })
    );
    assert!(kl(KlEstimator::K3, &[-9999.0], &[0.0]).is_err());
    let range = ClipRange::symmetric(0.2).unwrap();
    assert_eq!(
        objective(&[], &[], &[], range, 0.0),
        Err(RewardError::Empty)
    );
    assert_eq!(
        objective(&[1.0], &[1.0, 1.0], &[0.0], range, 0.0),
        Err(RewardError::Lengths {
            expected: 1,
            found: 2
        })
    );
    assert_eq!(
        objective(&[1.0], &[1.0], &[], range, 0.0),
        Err(RewardError::Lengths {
            expected: 1,
            found: 0
        })
    );
}

#[test]
fn numpy_finds_the_same() {
    let cases = cases(50);
    let Some(expected) = numpy(&cases) else {
        return;
    };
    let numbers = |value: &Value| -> Vec<f64> {
        value
            .as_array()
            .unwrap()
            .iter()
            .map(|number| number.as_f64().unwrap())
            .collect()
    };
    let lists = |value: &Value| -> Vec<Vec<f64>> {
        value.as_array().unwrap().iter().map(numbers).collect()
    };
    let all = |found: &[f64], expected: &Value| {
        found
            .iter()
            .zip(numbers(expected))
            .for_each(|(found, expected)| equal(*found, expected))
    };
    assert_eq!(expected.as_array().unwrap().len(), cases.len());
    for (case, expected) in cases.iter().zip(expected.as_array().unwrap()) {
        let number = |name: &str| case[name].as_f64().unwrap();
        let [new, old, reference] = ["new", "old", "ref"].map(|name| lists(&case[name]));
        let range = ClipRange::new(number("low"), number("high")).unwrap();
        let returns: Vec<f64> = lists(&case["rewards"])
            .iter()
            .map(|rewards| discounted_return(rewards, number("gamma")))
            .collect();
        all(&returns, &expected["returns"]);
        let advantages = group_relative(&returns, number("eps"));
        for name in Estimator::NAMES {
            let estimator = match Estimator::named(name, Scale::Group).unwrap() {
                Estimator::Paper { .. } => Estimator::Paper { eps: number("eps") },
                other => other,
            };
            all(
                &estimator
                    .advantages(std::slice::from_ref(&returns))
                    .unwrap()[0],
                &expected["advantages"][name],
            );
        }
        let ratios: Vec<f64> = new
            .iter()
            .zip(&old)
            .map(|(new, old)| sequence_ratio(new, old).unwrap())
            .collect();
        all(&ratios, &expected["ratios"]);
        let mut of_k3 = Vec::new();
        for estimator in KlEstimator::ALL {
            let found: Vec<f64> = new
                .iter()
                .zip(&reference)
                .map(|(new, reference)| kl(estimator, new, reference).unwrap())
                .collect();
            all(&found, &expected["kl"][estimator.as_str()]);
            of_k3 = found;
        }
        let found = objective(&ratios, &advantages, &of_k3, range, number("beta")).unwrap();
        equal(found.surrogate, expected["surrogate"].as_f64().unwrap());
        equal(found.loss, expected["loss"].as_f64().unwrap());
        all(
            &[found.clipped.low, found.clipped.high],
            &expected["clipped"],
        );
        let tokens: Vec<Vec<f64>> = new
            .iter()
            .zip(&old)
            .map(|(new, old)| token_ratios(new, old).unwrap())
            .collect();
        let of_tokens: Vec<f64> = tokens
            .iter()
            .zip(&advantages)
            .flat_map(|(tokens, advantage)| tokens.iter().map(|_| *advantage))
            .collect();
        let clipped = clip_share(&tokens.concat(), &of_tokens, range).unwrap();
        all(&[clipped.low, clipped.high], &expected["clipped_tokens"]);
    }
}

/// Groups of eight rollouts of up to 40 tokens, always the same.
fn cases(count: usize) -> Vec<Value> {
    let mut runner = TestRunner::deterministic();
    let mut draw = |strategy: BoxedStrategy<Vec<f64>>| {
        strategy
            .new_tree(&mut runner)
            .expect("numbers can be drawn")
            .current()
    };
    let mut cases = Vec::new();
    for _ in 0..count {
        let mut rollouts: [Vec<Vec<f64>>; 3] = Default::default();
        for _ in 0..8 {
            let old = draw(prop::collection::vec(-8.0..0.0f64, 1..40).boxed());
            for (list, spread) in rollouts.iter_mut().zip([0.4, 0.0, 0.8]) {
                let moves = draw(prop::collection::vec(-spread..=spread, old.len()).boxed());
                list.push(old.iter().zip(moves).map(|(old, by)| old + by).collect());
            }
        }
        let rewards: Vec<Vec<f64>> = (0..8)
            .map(|_| draw(prop::collection::vec(-3.0..4.0f64, 12).boxed()))
            .collect();
        let [new, old, reference] = rollouts;
        cases
            .push(json!({ "new": new, "old": old, "ref": reference, "rewards": rewards, "steps": 12, "gamma": 0.99, "eps": 1e-4,
                           "low": 0.03, "high": 0.05, "beta": 0.04 }));
    }
    cases
}

/// What NumPy makes of the cases; none where it is not installed.
fn numpy(cases: &[Value]) -> Option<Value> {
    let python = reel_vectors::python("numpy")?;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/gspo.py");
    let mut child = Command::new(&python)
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python started before");
    child
        .stdin
        .take()
        .expect("it is piped")
        .write_all(Value::from(cases).to_string().as_bytes())
        .expect("the script reads it");
    let output = child.wait_with_output().expect("the script ends");
    assert!(output.status.success(), "{script} failed");
    Some(serde_json::from_slice(&output.stdout).expect("the script writes JSON"))
}
