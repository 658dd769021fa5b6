//! Parsers of the crates around DataFusion, which takes long to build: questions in SQL, patterns
//! over steps, labels, rules, opinions of judges.

use std::{collections::BTreeSet, path::Path, time::Duration};

use reel_query::{Limits, QuerySession, pattern::Pattern};
use reel_tables::Store;
use reel_taxonomy::{Defaults, RuleSet, judge};

use super::parsers::{Parser, file, folder, text};

/// The parsers by name, as in `mod.rs` beside this.
pub const PARSERS: &[(&str, Parser)] = &[
    ("judge", opinion),
    ("labels", labels),
    ("pattern", pattern),
    ("rule", rule),
    ("sql", sql),
];

/// What a question may cost.
const LIMITS: Limits = Limits {
    memory_bytes: 256 << 20,
    time: Duration::from_secs(5),
    rows: 1_000,
};

/// The opinion of a model that judges failures.
fn opinion(bytes: &[u8]) {
    let case = judge::Case {
        transcript: vec![judge::CaseStep::default(); 3],
        ..judge::Case::default()
    };
    text(bytes, |text| drop(judge::parse_answer(text, &case)));
}

/// Labels of people and of injected faults.
fn labels(bytes: &[u8]) {
    text(bytes, |text| {
        let own_classes = BTreeSet::new();
        let defaults = || Defaults {
            author: "fuzz",
            at_ms: 0,
            own_classes: &own_classes,
        };
        let _ = reel_taxonomy::from_csv(text, "labels.csv", defaults());
        let _ = reel_taxonomy::from_json(text, "labels.json", defaults());
        let _ = reel_taxonomy::injected(text, "trace.label.json", 0);
    });
}

/// A pattern over steps.
fn pattern(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = Pattern::parse(text);
    });
}

/// A rule of the taxonomy.
fn rule(bytes: &[u8]) {
    file(bytes, "rule.sql", |path| {
        let _ = RuleSet::with_folder(path.parent().unwrap_or(Path::new(".")));
    });
}

/// A question over an empty store: checked, planned, optimised, and not executed.
fn sql(bytes: &[u8]) {
    thread_local! {
        static ASKED: (tempfile::TempDir, QuerySession) = {
            let folder = folder();
            let store = Store::open_or_create(folder.path()).expect("a new store");
            let session = QuerySession::with_limits(store, LIMITS);
            (folder, session.expect("a session"))
        };
    }
    text(bytes, |text| {
        ASKED.with(|(_, session)| drop(session.run(&format!("EXPLAIN {text}"))));
    });
}
