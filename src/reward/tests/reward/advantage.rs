//! Advantages and returns: numbers worked by hand, errors, and the published code's own results
//! where its vector files are.

use reel_reward::{
    Estimator, Returns, RewardError, Scale, group_relative,
    gspo::{
        ClipRange, KlEstimator, clip_side, clipped_term, kl, objective, sequence_ratio, token_kl,
    },
};
use reel_vectors::{Report, items, load, text};
use serde_json::{Value, json};

use crate::close;

fn of_one_group(estimator: Estimator, returns: &[f64]) -> Vec<f64> {
    estimator.advantages(&[returns.to_vec()]).unwrap().remove(0)
}

#[test]
fn a_virtual_rollout_joins_the_group() {
    let found = of_one_group(Estimator::Ngrpo { virtual_max: None }, &[1.0, 3.0]);
    // 3 + 0.5 joins: mean 2.5, variance (2.25 + 0.25 + 1) / 3
    let deviation = (3.5f64 / 3.0 + 1e-8).sqrt();
    close(found[0], -1.5 / deviation);
    close(found[1], 0.5 / deviation);
    // of large rewards a tenth joins: 100 + 10
    close(
        of_one_group(Estimator::Ngrpo { virtual_max: None }, &[100.0])[0],
        -5.0 / (25.0f64 + 1e-8).sqrt(),
    );
    let failed = of_one_group(Estimator::Ngrpo { virtual_max: None }, &[-4.0; 3]);
    assert!(
        failed.iter().all(|advantage| *advantage < -0.5),
        "a group that failed alike is told so: {failed:?}"
    );
    close(
        of_one_group(
            Estimator::Ngrpo {
                virtual_max: Some(3.0),
            },
            &[1.0],
        )[0],
        -1.0 / (1.0f64 + 1e-8).sqrt(),
    );
}

#[test]
fn estimators_scale_by_the_deviation_they_name() {
    let groups = [vec![1.0, -1.0], vec![4.0, 4.0]];
    let of = |estimator: Estimator| estimator.advantages(&groups).unwrap();
    let two = 2f64.sqrt() + 1e-4;
    close(
        of(Estimator::Grpo {
            scale: Scale::Group,
        })[0][0],
        1.0 / two,
    );
    close(
        of(Estimator::Rloo {
            scale: Scale::Group,
        })[0][0],
        2.0 / two,
    );
    close(
        of(Estimator::ReinforcePlusPlus {
            scale: Scale::Group,
        })[0][0],
        1.0 / two,
    );
    // returns 1, -1, 4, 4: mean 2, squares 1 + 9 + 4 + 4; differences 1, -1, 0, 0: squares 2
    close(
        of(Estimator::Grpo {
            scale: Scale::Batch,
        })[0][0],
        1.0 / (6f64.sqrt() + 1e-4),
    );
    close(
        of(Estimator::ReinforcePlusPlus {
            scale: Scale::Batch,
        })[0][0],
        1.0 / ((2f64 / 3.0).sqrt() + 1e-4),
    );
    close(of(Estimator::Rloo { scale: Scale::None })[0][1], -2.0);
    assert_eq!(
        of(Estimator::Grpo {
            scale: Scale::Batch
        })[1],
        [0.0, 0.0]
    );
    assert_eq!(
        of(Estimator::Paper { eps: 0.0 })[0],
        group_relative(&groups[0], 0.0)
    );
    for name in Estimator::NAMES {
        let estimator = Estimator::named(name, Scale::None).unwrap();
        assert_eq!(estimator.as_str(), name);
        assert_eq!(
            serde_json::to_value(estimator).unwrap()["estimator"],
            name,
            "the manifest names it so"
        );
    }
    assert!(
        Scale::ALL
            .iter()
            .all(|scale| Scale::parse(scale.as_str()) == Some(*scale))
    );
}

#[test]
fn groups_that_cannot_be_compared_are_refused() {
    let grpo = Estimator::Grpo {
        scale: Scale::Group,
    };
    assert_eq!(
        grpo.advantages(&[vec![1.0, 2.0], vec![]]),
        Err(RewardError::Empty)
    );
    assert_eq!(
        grpo.advantages(&[vec![1.0, 2.0], vec![1.0]]),
        Err(RewardError::GroupOfOne { group: 1 })
    );
    let infinite = RewardError::Return {
        group: 0,
        found: f64::INFINITY,
    };
    assert_eq!(grpo.advantages(&[vec![1.0, f64::INFINITY]]), Err(infinite));
    assert!(
        Estimator::Ngrpo {
            virtual_max: Some(f64::NAN)
        }
        .advantages(&[vec![1.0]])
        .is_err()
    );
    assert!(
        Estimator::Paper { eps: -1.0 }
            .advantages(&[vec![1.0]])
            .is_err()
    );
}

#[test]
fn returns_by_name() {
    let rewards = vec![1.0; 60];
    assert_eq!(Returns::PUBLISHED.of(&rewards), 50.0);
    close(
        Returns::PAPER.of(&rewards),
        (1.0 - libm::pow(0.99, 30.0)) / 0.01,
    );
    assert_eq!(Returns::PAPER.of(&rewards[..1]), 1.0);
    assert_eq!(Returns::parse("published"), Some(Returns::PUBLISHED));
    assert_eq!(Returns::parse("both"), None);
}

/// Where two lists of numbers differ by more than the tolerance first.
fn apart(expected: &Value, found: &[f64], tolerance: f64) -> Option<String> {
    let expected: Vec<f64> = items(expected)
        .iter()
        .map(|number| number.as_f64().unwrap())
        .collect();
    let near = |(expected, found): (&f64, &f64)| (expected - found).abs() <= tolerance;
    let same = expected.len() == found.len() && expected.iter().zip(found).all(near);
    (!same).then(|| format!("expected {expected:?}, found {found:?}"))
}

fn numbers(value: &Value) -> Vec<f64> {
    items(value)
        .iter()
        .map(|number| number.as_f64().unwrap())
        .collect()
}

#[test]
fn real_contract_advantages() {
    let Some(document) = load("advantages.json") else {
        return;
    };
    let mut report = Report::new("advantages.json", "rows");
    for row in items(&document["rows"]) {
        let scale = row["scale_rewards"]
            .as_str()
            .map_or(Scale::Group, |scale| Scale::parse(scale).unwrap());
        let estimator = match text(&row["estimator"]) {
            "ngrpo" => Estimator::Ngrpo {
                virtual_max: row["virtual_max_reward"].as_f64(),
            },
            "reinforce_plus_plus" => Estimator::ReinforcePlusPlus { scale },
            name => Estimator::named(name, scale).unwrap(),
        };
        let one = [row["rewards"].clone()];
        let (groups, expected, tolerance) = match row.get("groups") {
            Some(groups) => (items(groups), items(&row["advantages"]), 1e-4),
            None => (&one[..], std::slice::from_ref(&row["advantages"]), 1e-6),
        };
        let found = estimator
            .advantages(&groups.iter().map(numbers).collect::<Vec<_>>())
            .unwrap();
        assert_eq!(found.len(), expected.len());
        let difference = found
            .iter()
            .zip(expected)
            .find_map(|(found, expected)| apart(expected, found, tolerance));
        report.count(text(&row["id"]), difference);
    }
    report.finish();

    let mut report = Report::new("advantages.json", "errors");
    for (index, case) in items(&document["errors"]).iter().enumerate() {
        // what is no list of lists, or no one virtual reward, is refused by the types
        let groups: Result<Vec<Vec<f64>>, _> = serde_json::from_value(case["input"].clone());
        let virtual_max: Result<Option<f64>, _> = serde_json::from_value(case["virtual"].clone());
        let refused = match (groups, virtual_max) {
            (Ok(groups), Ok(virtual_max)) => Estimator::Ngrpo { virtual_max }
                .advantages(&groups)
                .is_err(),
            _ => true,
        };
        report.compare(
            &format!("error {index}"),
            &Value::from(case["error"].is_string()),
            &refused.into(),
        );
    }
    report.finish();
}

#[test]
fn real_contract_sequences() {
    let Some(document) = load("advantages.json") else {
        return;
    };
    let mut report = Report::new("advantages.json", "sequences");
    for case in items(&document["sequences"]) {
        let number = |name: &str| case[name].as_f64().unwrap();
        let [new, old, reference, mask] =
            ["logp_new", "logp_old", "logp_ref", "mask"].map(|name| numbers(&case[name]));
        let all_kl = token_kl(KlEstimator::K3, &new, &reference).unwrap();
        let unmasked = |values: &[f64]| -> Vec<f64> {
            values
                .iter()
                .zip(&mask)
                .filter(|(_, mask)| **mask > 0.0)
                .map(|(it, _)| *it)
                .collect()
        };
        let [new, old, reference] = [new, old, reference].map(|values| unmasked(&values));
        let range = ClipRange::symmetric(number("epsilon")).unwrap();
        let advantage = number("advantage");
        let ratio = sequence_ratio(&new, &old).unwrap();
        let kl = kl(KlEstimator::K3, &new, &reference).unwrap();
        let of_all = objective(&[ratio], &[advantage], &[kl], range, number("beta")).unwrap();
        let found = [
            libm::log(ratio),
            ratio,
            -clipped_term(ratio, advantage, range),
            of_all.loss,
        ];
        let expected = json!([
            case["log_ratio"],
            case["ratio"],
            case["policy_term"],
            case["loss"]
        ]);
        let clipped = clip_side(ratio, advantage, range).is_some();
        let side = (case["clipped"] != json!(clipped)).then(|| format!("clipped is {clipped}"));
        report.count(
            text(&case["id"]),
            apart(&expected, &found, 1e-6)
                .or(apart(&case["kl"], &all_kl, 1e-6))
                .or(side),
        );
    }
    report.finish();
}
