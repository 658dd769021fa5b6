//! Sentences true and false beside real episodes. The sentences stand in text files, one a line;
//! never made to fit the code.

mod episodes;

use proptest::prelude::*;
use reel_history::{Claim, ClaimVerdict, repair_history};

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
            let [.., episode, steps, text] = parts[..] else {
                panic!("a line has {fields} fields: {line}")
            };
            let kind = if fields > 3 { parts[0] } else { "" };
            Planted {
                kind: kind.to_owned(),
                episode: episode.to_owned(),
                steps: steps.parse().unwrap(),
                text: text.to_owned(),
            }
        })
        .collect()
}

fn false_claims(history: &str, claims: &[Claim]) -> Vec<String> {
    let text = |claim: &Claim| {
        format!(
            "{:?} [{}] {:?}",
            &history[claim.span.clone()],
            claim.kind,
            claim.verdict
        )
    };
    claims
        .iter()
        .filter(|claim| claim.is_false())
        .map(text)
        .collect()
}

/// Every sentence of a file of true ones is judged alone and behind the episode's own true History.
fn alarms(file: &str) -> (Vec<String>, usize, usize) {
    let (mut alarms, mut supported, mut all) = (Vec::new(), 0, 0);
    for Planted {
        episode,
        steps,
        text,
        ..
    } in planted(file, 3)
    {
        let episode = Episode::named(&episode);
        let mut checker = episode.checker(steps);
        let base = episode.base(steps);
        for history in [text.clone(), format!("{base} {text}")] {
            let claims = checker.check(&history);
            alarms.extend(
                false_claims(&history, &claims)
                    .into_iter()
                    .map(|claim| format!("{text}: {claim}")),
            );
        }
        all += 1;
        let claims = checker.check(&text);
        supported += usize::from(
            claims
                .iter()
                .any(|claim| matches!(claim.verdict, ClaimVerdict::Supported { .. })),
        );
    }
    (alarms, supported, all)
}

/// Every sentence of a file of false ones is planted behind the true History; what is not
/// found, or found elsewhere.
fn overlooked(file: &str) -> Vec<String> {
    let mut overlooked = Vec::new();
    for Planted {
        kind,
        episode,
        steps,
        text,
    } in planted(file, 4)
    {
        let episode = Episode::named(&episode);
        let mut checker = episode.checker(steps);
        let base = episode.base(steps);
        let history = format!("{base} {text}");
        let claims = checker.check(&history);
        let (here, elsewhere): (Vec<&Claim>, Vec<&Claim>) = claims
            .iter()
            .filter(|claim| claim.is_false())
            .partition(|claim| claim.span.start > base.len());
        if here.is_empty() || !elsewhere.is_empty() {
            overlooked.push(format!("{kind}: {text}: elsewhere {}", elsewhere.len()));
        }
    }
    overlooked
}

/// The files `fresh` and `last` were written when the reader was done; what they taught was mended
/// afterwards.
#[test]
fn planted_false_claims_are_found() {
    for file in [
        include_str!("false.txt"),
        include_str!("false_fresh.txt"),
        include_str!("false_last.txt"),
    ] {
        let missed = overlooked(file);
        let (count, missed_lines) = (missed.len(), missed.join("\n"));
        assert!(missed.is_empty(), "{count} overlooked:\n{missed_lines}");
    }
}

#[test]
fn true_sentences_raise_no_alarm_and_most_are_understood() {
    for (file, percent) in [
        (include_str!("true.txt"), 80),
        (include_str!("true_fresh.txt"), 65),
        (include_str!("true_last.txt"), 65),
    ] {
        let (alarms, supported, all) = alarms(file);
        let (count, alarm_lines) = (alarms.len(), alarms.join("\n"));
        assert!(
            alarms.is_empty(),
            "{count} false alarms ({supported} of {all} understood):\n{alarm_lines}"
        );
        assert!(
            supported * 100 >= all * percent,
            "only {supported} of {all} are understood"
        );
    }
}

#[test]
fn the_true_histories_stay_true_at_every_step() {
    for episode in Episode::ALL {
        let episode = Episode::named(episode);
        for steps in 0..=episode.length() {
            let base = episode.base(steps);
            let claims = episode.checker(steps).check(&base);
            assert_eq!(
                false_claims(&base, &claims),
                Vec::<String>::new(),
                "after {steps} steps"
            );
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
            assert_eq!(
                false_claims(&history, &claims),
                Vec::<String>::new(),
                "at step {step}: {history}"
            );
            told += claims.len();
        }
    }
    assert!(told > 100, "only {told} claims");
}

#[test]
fn a_mended_history_is_true_and_keeps_what_was() {
    for Planted {
        episode,
        steps,
        text,
        ..
    } in planted(include_str!("false.txt"), 4)
    {
        let episode = Episode::named(&episode);
        let mut checker = episode.checker(steps);
        let base = episode.base(steps);
        let mended = repair_history(&mut checker, &format!("{base} {text}"));
        let claims = checker.check(&mended.text);
        assert_eq!(
            false_claims(&mended.text, &claims),
            Vec::<String>::new(),
            "{text}"
        );
        assert!(mended.text.starts_with(&base), "{text}: {}", mended.text);
        assert_eq!(
            mended.repaired + mended.dropped,
            1,
            "{text}: {}",
            mended.text
        );
    }
}

/// Every deed of the episodes in every wording of a rule-based annotator, alone
/// and as whole stories.
#[test]
fn told_deeds_raise_no_alarm() {
    for file in [include_str!("wordings.txt"), include_str!("stories.txt")] {
        let (alarms, supported, all) = alarms(file);
        assert!(
            alarms.is_empty(),
            "{} false alarms ({supported} of {all} understood):\n{}",
            alarms.len(),
            alarms.join("\n")
        );
        assert!(
            supported * 100 >= all * 80,
            "only {supported} of {all} are understood"
        );
    }
}

/// Sentences of one episode that are true or false after some steps.
fn any_story() -> impl Strategy<Value = (&'static str, usize, String)> {
    let all: Vec<(String, String)> = [include_str!("true.txt"), include_str!("true_fresh.txt")]
        .into_iter()
        .flat_map(|file| planted(file, 3))
        .chain(
            [include_str!("false.txt"), include_str!("false_fresh.txt")]
                .into_iter()
                .flat_map(|file| planted(file, 4)),
        )
        .map(|planted| (planted.episode, planted.text))
        .collect();
    (
        0..Episode::ALL.len(),
        0usize..30,
        proptest::collection::vec(any::<proptest::sample::Index>(), 1..12),
    )
        .prop_map(move |(episode, steps, picks)| {
            let episode = Episode::ALL[episode];
            let own: Vec<&str> = all
                .iter()
                .filter(|(name, _)| name == episode)
                .map(|(_, text)| text.as_str())
                .collect();
            let story: Vec<&str> = picks
                .iter()
                .map(|pick| own[pick.index(own.len())])
                .collect();
            (episode, steps, story.join(" "))
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn what_is_mended_holds_no_contradiction((episode, steps, story) in any_story()) {
        let mut checker = Episode::named(episode).checker(steps);
        let mended = repair_history(&mut checker, &story);
        let claims = checker.check(&mended.text);
        prop_assert_eq!(false_claims(&mended.text, &claims), Vec::<String>::new());
        // and mending once more changes nothing
        prop_assert_eq!(repair_history(&mut checker, &mended.text).text, mended.text);
    }

    #[test]
    fn no_text_makes_it_panic(text in "\\PC{0,200}|([a-z0-9_'\"(){}.,;:! \n\u{201c}\u{e9}]|picked |the |not |to |table_1 |marker |after |was |asked |door |no ){0,60}") {
        let mut checker = Episode::named("deco").checker(8);
        for claim in checker.check(&text) {
            prop_assert!(text.get(claim.span.clone()).is_some(), "{:?} in {:?}", claim, text);
        }
        repair_history(&mut checker, &text);
    }
}

#[test]
fn hostile_texts_end() {
    let mut checker = Episode::named("note").checker(20);
    let long = [
        "(".repeat(300_000),
        "\"'(".repeat(100_000),
        "picked ".repeat(100_000),
        "not and, ".repeat(50_000),
        "I am holding the vase. ".repeat(20_000),
        "I never opened it; ".repeat(20_000),
        "\u{1f9ff}\u{301}.\n".repeat(50_000),
        "table_1 and ".repeat(50_000),
        " 'a".repeat(100_000),
    ];
    for text in long {
        checker.check(&text);
        repair_history(&mut checker, &text);
    }
}

#[test]
fn bare_calls_and_their_texts_are_enough_for_what_they_tell() {
    let mut checker = Episode::named("deco").bare(10);
    let claims = checker.check("I went to table_1 and picked up the vase. I am holding nothing. It is on table_2. I saw 4 mugs. I walked around shelf_1. I asked twice.");
    let wrong: Vec<&str> = claims
        .iter()
        .filter(|claim| claim.is_false())
        .map(|claim| claim.kind.as_str())
        .collect();
    assert_eq!(wrong, ["explore", "ask"]);
    for text in planted(include_str!("true.txt"), 3)
        .into_iter()
        .chain(planted(include_str!("true_fresh.txt"), 3))
    {
        let claims = Episode::named(&text.episode)
            .bare(text.steps)
            .check(&text.text);
        assert_eq!(
            false_claims(&text.text, &claims),
            Vec::<String>::new(),
            "{}",
            text.text
        );
    }
}
