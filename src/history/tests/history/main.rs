//! Sentences true and false beside real episodes. The sentences stand in text files, one a line; never made to fit the code.

mod episodes;

use reel_history::{Claim, Verdict, mend};

use episodes::{Episode, lines};

/// A sentence to judge after so many steps of an episode.
struct Planted {
    kind: String,
    episode: String,
    steps: usize,
    text: String,
}

fn planted(file: &str, fields: usize) -> Vec<Planted> {
    lines(file)
        .map(|line| {
            let parts: Vec<&str> = line.splitn(fields, " | ").collect();
            let [.., episode, steps, text] = parts[..] else { panic!("a line has {fields} fields: {line}") };
            let kind = if fields > 3 { parts[0] } else { "" };
            Planted { kind: kind.to_owned(), episode: episode.to_owned(), steps: steps.parse().unwrap(), text: text.to_owned() }
        })
        .collect()
}

fn false_claims(history: &str, claims: &[Claim]) -> Vec<String> {
    let text = |claim: &Claim| format!("{:?} [{}] {:?}", &history[claim.span.clone()], claim.kind, claim.verdict);
    claims.iter().filter(|claim| claim.is_false()).map(text).collect()
}

/// Every sentence of a file of true ones is judged alone and behind the episode's own true History.
fn alarms(file: &str) -> (Vec<String>, usize, usize) {
    let (mut alarms, mut supported, mut all) = (Vec::new(), 0, 0);
    for Planted { episode, steps, text, .. } in planted(file, 3) {
        let episode = Episode::named(&episode);
        let mut checker = episode.checker(steps);
        let base = episode.base(steps);
        for history in [text.clone(), format!("{base} {text}")] {
            let claims = checker.check(&history);
            alarms.extend(false_claims(&history, &claims).into_iter().map(|claim| format!("{text}: {claim}")));
        }
        all += 1;
        let claims = checker.check(&text);
        supported += usize::from(claims.iter().any(|claim| matches!(claim.verdict, Verdict::Supported { .. })));
    }
    (alarms, supported, all)
}

/// Every sentence of a file of false ones is planted behind the true History; what is not found, or found elsewhere.
fn overlooked(file: &str) -> Vec<String> {
    let mut overlooked = Vec::new();
    for Planted { kind, episode, steps, text } in planted(file, 4) {
        let episode = Episode::named(&episode);
        let mut checker = episode.checker(steps);
        let base = episode.base(steps);
        let history = format!("{base} {text}");
        let claims = checker.check(&history);
        let (here, elsewhere): (Vec<&Claim>, Vec<&Claim>) =
            claims.iter().filter(|claim| claim.is_false()).partition(|claim| claim.span.start > base.len());
        if here.is_empty() || !elsewhere.is_empty() {
            overlooked.push(format!("{kind}: {text}: {claims:?}"));
        }
    }
    overlooked
}

#[test]
fn planted_false_claims_are_found() {
    let missed = overlooked(include_str!("false.txt"));
    assert!(missed.is_empty(), "{} overlooked:\n{}", missed.len(), missed.join("\n"));
}

#[test]
fn true_sentences_raise_no_alarm_and_most_are_understood() {
    let (alarms, supported, all) = alarms(include_str!("true.txt"));
    assert!(alarms.is_empty(), "{} false alarms:\n{}", alarms.len(), alarms.join("\n"));
    assert!(supported * 100 >= all * 80, "only {supported} of {all} are understood");
}

#[test]
fn the_true_histories_stay_true_at_every_step() {
    for episode in Episode::ALL {
        let episode = Episode::named(episode);
        for steps in 0..=episode.length() {
            let base = episode.base(steps);
            let claims = episode.checker(steps).check(&base);
            assert_eq!(false_claims(&base, &claims), Vec::<String>::new(), "after {steps} steps");
        }
    }
}

#[test]
fn what_the_built_in_policies_tell_is_true() {
    let mut told = 0;
    for episode in Episode::ALL {
        let episode = Episode::named(episode);
        for (step, history) in episode.narration() {
            let claims = episode.checker(step).check(&history);
            assert_eq!(false_claims(&history, &claims), Vec::<String>::new(), "at step {step}: {history}");
            told += claims.len();
        }
    }
    assert!(told > 100, "only {told} claims");
}

#[test]
fn a_mended_history_is_true_and_keeps_what_was() {
    for Planted { episode, steps, text, .. } in planted(include_str!("false.txt"), 4) {
        let episode = Episode::named(&episode);
        let mut checker = episode.checker(steps);
        let base = episode.base(steps);
        let mended = mend(&mut checker, &format!("{base} {text}"));
        let claims = checker.check(&mended.text);
        assert_eq!(false_claims(&mended.text, &claims), Vec::<String>::new(), "{text}");
        assert!(mended.text.starts_with(&base), "{text}: {}", mended.text);
        assert_eq!(mended.mended + mended.dropped, 1, "{text}: {}", mended.text);
    }
}
