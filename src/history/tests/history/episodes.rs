//! Real episodes, as plain data: a scene, a task, the graph at the start, and step
//! records without motion states.

use std::{
    collections::BTreeMap,
    sync::{Arc, LazyLock},
};

use reel_history::{Checker, EpisodeFacts, ReceptacleFacts, StepFacts};
use reel_world::{Scene, Task, WorldGraph, record::StepRecord};
use serde::Deserialize;

#[derive(Deserialize)]
struct File {
    task: Task,
    graph: WorldGraph,
    steps: Vec<StepRecord>,
}

/// An episode, what it says of itself, and a true History of it.
pub struct Episode {
    setting: EpisodeFacts,
    deeds: Vec<StepFacts>,
    /// The same from calls and texts alone.
    bare: Vec<StepFacts>,
    narration: Vec<(usize, String)>,
    /// After which step each piece of the true History holds.
    base: Vec<(usize, String)>,
}

static EPISODES: LazyLock<BTreeMap<&'static str, Arc<Episode>>> = LazyLock::new(|| {
    #[rustfmt::skip]
    let files = [
        ("vase", include_str!("episodes/oracle_fdo_home_0001.json")),
        ("deco", include_str!("episodes/oracle_sul_home_0001.json")),
        ("book", include_str!("episodes/explorer_fdp_home_0005.json")),
        ("bear", include_str!("episodes/explorer_fodp_home_0001.json")),
        ("note", include_str!("episodes/explorer_fodp_home_0002.json")),
        ("clock", include_str!("episodes/explorer_sul_home_0004.json")),
        ("timer", include_str!("episodes/planner_sul_home_0004.json")),
    ];
    let scene: Scene = serde_json::from_str(include_str!("episodes/home.json")).unwrap();
    files
        .into_iter()
        .map(|(name, text)| (name, Arc::new(Episode::read(name, &scene, text))))
        .collect()
});

impl Episode {
    pub const ALL: [&str; 7] = ["vase", "deco", "book", "bear", "note", "clock", "timer"];

    pub fn named(name: &str) -> Arc<Episode> {
        Arc::clone(&EPISODES[name])
    }

    fn read(name: &str, scene: &Scene, text: &str) -> Self {
        let File { task, graph, steps } = serde_json::from_str(text).unwrap();
        let narration = steps
            .iter()
            .enumerate()
            .filter_map(|(at, step)| Some((at, step.input.policy.as_ref()?.history.clone())));
        let base = lines(include_str!("base.txt")).filter_map(|line| {
            let (episode, rest) = line.split_once(" | ")?;
            let (step, sentence) = rest.split_once(" | ")?;
            (episode == name).then(|| (step.parse().unwrap(), sentence.to_owned()))
        });
        Self {
            setting: EpisodeFacts::of(&task, scene, &graph),
            deeds: steps.iter().map(StepFacts::of).collect(),
            bare: steps
                .iter()
                .map(|step| StepFacts::from_call(step.step, &step.input.call, &step.outcome.text))
                .collect(),
            narration: narration
                .filter(|(_, history)| !history.is_empty())
                .collect(),
            base: base.collect(),
        }
    }

    pub fn length(&self) -> usize {
        self.deeds.len()
    }

    /// A checker that was told the first so many deeds.
    pub fn checker(&self, steps: usize) -> Checker {
        let mut checker = Checker::new(self.setting.clone());
        self.deeds
            .iter()
            .take(steps)
            .cloned()
            .for_each(|deed| checker.push_step(deed));
        checker
    }

    /// A checker that knows receptacles, calls and texts only.
    pub fn bare(&self, steps: usize) -> Checker {
        let places = self
            .setting
            .places
            .iter()
            .cloned()
            .map(|place| ReceptacleFacts {
                door: None,
                captions: Vec::new(),
                ..place
            });
        let mut checker = Checker::new(EpisodeFacts {
            places: places.collect(),
            ..EpisodeFacts::default()
        });
        self.bare
            .iter()
            .take(steps)
            .cloned()
            .for_each(|deed| checker.push_step(deed));
        checker
    }

    /// The true History after so many steps.
    pub fn base(&self, steps: usize) -> String {
        let mut text = String::new();
        for (_, sentence) in self.base.iter().filter(|(step, _)| *step < steps) {
            if !text.is_empty() && !sentence.starts_with(';') {
                text.push(' ');
            }
            text.push_str(sentence);
        }
        // the terse style ends without a mark
        if !text.is_empty() && !text.ends_with('.') {
            text + "."
        } else {
            text
        }
    }

    /// What the policy said at which step.
    pub fn narration(&self) -> impl Iterator<Item = (usize, String)> {
        self.narration.iter().cloned()
    }
}

/// The lines of a text file that say something.
pub fn lines(file: &str) -> impl Iterator<Item = &str> {
    file.lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
}
