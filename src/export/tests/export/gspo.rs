//! The objective over a store: what it is computed from, and what is left out or refused.

use std::{fs, path::Path};

use reel_export::{ExportError, GspoOptions, RolloutOptions, SequenceUnit, gspo};
use reel_reward::{
    Estimator, Returns,
    gspo::{ClipRange, KlEstimator, clipped_term, kl, sequence_ratio},
};
use reel_tables::Store;
use reel_trace::{Images, ScoredTokens, Trace};
use reel_world::{TokenLogprobs, record::PolicyOutput};
use tempfile::TempDir;

use crate::episodes::{record_seeded, tasks, write};

/// Log-probabilities of so many tokens under a policy, other ones for every decision.
fn drawn(policy: &str, step: u32, count: usize) -> Vec<f64> {
    let draw = |token: usize| {
        let digest = reel_world::Digest::of(format!("{step}/{token}").as_bytes()).0[0];
        let moved = reel_world::Digest::of(format!("{policy}/{step}/{token}").as_bytes()).0[0];
        -f64::from(digest) / 128.0 - f64::from(moved) / 2560.0
    };
    (0..count).map(draw).collect()
}

/// An episode whose decisions have two and three tokens in turn, under `old` and these policies.
fn recorded(path: &Path, seed: u64, policies: &[&str]) -> Trace {
    record_seeded(path, &tasks()[0], "explorer", seed, Images::None);
    let mut trace = Trace::read(path).unwrap();
    for step in &mut trace.steps {
        let tokens: Vec<String> = (0..2 + step.step as usize % 2)
            .map(|token| format!("t{token}"))
            .collect();
        let mut of =
            TokenLogprobs::sampled(tokens.clone(), drawn("old", step.step, tokens.len())).unwrap();
        for policy in policies {
            of.add(
                policy,
                drawn(policy, step.step, tokens.len()),
                Some(&tokens),
            )
            .unwrap();
        }
        step.input
            .policy
            .get_or_insert_with(PolicyOutput::default)
            .logprobs = Some(of);
    }
    fs::remove_file(path).unwrap();
    write(path, &trace);
    Trace::read(path).unwrap()
}

fn sequence(trace: &Trace, policy: &str) -> Vec<f64> {
    trace
        .logprobs()
        .flat_map(|(_, of)| of.of(policy).unwrap().to_vec())
        .collect()
}

#[test]
fn the_objective_of_a_group_and_what_is_left_out() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(format!("{name}.mcap"));
    let traces = [
        recorded(&path("a"), 1, &["new", "ref"]),
        recorded(&path("b"), 2, &["new", "ref"]),
    ];
    recorded(&path("unscored"), 3, &[]);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store
        .ingest(&[path("a"), path("b"), path("unscored")], &|_, _| ())
        .unwrap();

    let clip = ClipRange::symmetric(1e-3).unwrap();
    let rollouts = RolloutOptions {
        returns: Returns::PUBLISHED,
        advantage: Estimator::Ngrpo { virtual_max: None },
        ..RolloutOptions::default()
    };
    let options = GspoOptions {
        reference: Some("ref".into()),
        clip,
        beta: 0.5,
        rollouts,
        ..GspoOptions::default()
    };
    let report = gspo(&store, &options).unwrap();
    assert_eq!((report.sequences.len(), report.groups.len()), (2, 1));
    assert_eq!(
        report.excluded["episodes without log-probabilities of these policies"],
        1
    );
    assert_eq!(
        report.tokens,
        traces
            .iter()
            .map(|trace| sequence(trace, "old").len())
            .sum::<usize>()
    );
    let mut loss = 0.0;
    for found in &report.sequences {
        let trace = traces
            .iter()
            .find(|trace| trace.header.episode_id == found.episode_id)
            .unwrap();
        let [old, new, reference] = ["old", "new", "ref"].map(|policy| sequence(trace, policy));
        let returned: f64 = trace.steps.iter().map(|step| step.reward_total()).sum();
        assert!((found.episode_return - returned).abs() < 1e-12 && found.step.is_none());
        assert_eq!(found.ratio, sequence_ratio(&new, &old).unwrap());
        assert_eq!(
            found.kl["k3"],
            kl(KlEstimator::K3, &new, &reference).unwrap()
        );
        loss += (0.5 * found.kl["k3"] - clipped_term(found.ratio, found.advantage, clip)) / 2.0;
    }
    assert!(
        (report.objective.loss - loss).abs() < 1e-12,
        "{} is not {loss}",
        report.objective.loss
    );
    assert_eq!(report.groups[0].objective, report.objective);

    let by_decision = gspo(
        &store,
        &GspoOptions {
            unit: SequenceUnit::Decision,
            ..options.clone()
        },
    )
    .unwrap();
    let decisions = || by_decision.sequences.iter();
    assert_eq!(
        decisions().map(|it| it.tokens).sum::<usize>(),
        report.tokens
    );
    assert!(decisions().all(|it| it.step.is_some()) && by_decision.sequences.len() > 2);

    // without a reference there is no KL; of a policy that nobody recorded there is nothing
    let alone = gspo(
        &store,
        &GspoOptions {
            reference: None,
            beta: 0.0,
            ..options.clone()
        },
    )
    .unwrap();
    assert!(alone.kl_means.is_empty() && alone.objective.loss == -alone.objective.surrogate);
    let nobody = gspo(
        &store,
        &GspoOptions {
            new: "newer".into(),
            ..options
        },
    )
    .unwrap_err();
    assert!(
        matches!(nobody, ExportError::NoSequences { .. }) && nobody.to_string().contains("'newer'"),
        "{nobody}"
    );
}

#[test]
fn an_episode_that_was_scored_in_part_is_refused() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(format!("{name}.mcap"));
    let (mut trace, _) = (
        recorded(&path("a"), 1, &[]),
        recorded(&path("b"), 2, &["new"]),
    );
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&[path("a"), path("b")], &|_, _| ()).unwrap();
    let (before, line) = (trace.chain(), trace.scored_tokens().next().unwrap());
    trace
        .add_scored(&ScoredTokens {
            policy: "new".into(),
            ..line
        })
        .unwrap();
    trace.save().unwrap();
    // the file holds more than before, so its row is read again; the episode is the same one
    let report = store.ingest(&[path("a"), path("b")], &|_, _| ()).unwrap();
    assert_eq!(
        (
            report.added,
            report.superseded,
            report.unchanged,
            trace.chain()
        ),
        (0, 1, 1, before)
    );
    let error = gspo(&store, &GspoOptions::default())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains(&trace.header.episode_id)
            && error.contains("step 1")
            && error.contains("'new'"),
        "{error}"
    );
}
