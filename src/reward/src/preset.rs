//! Presets: rules by name with the weights and limits they are played with. A preset's version is
//! the digest of what it computes. Files of presets belong to [`crate::preset_file`].

use reel_world::{
    Digest, GAMMA, Scene, Task, WorldGraph,
    record::{Graphs, RewardTerm, StartRecord, StepRecord},
};
use serde_json::{Map, Value, json};

use crate::{
    Rewarder,
    records::RecordRewarder,
    terms::{Base, Term},
};

/// Counts up when the rules of a base change in the code, so that equal weights of other
/// rules get another version.
fn revision(base: Base) -> u32 {
    match base {
        Base::Paper | Base::RealTrainer => 1,
        Base::RealRepo => 2,
    }
}

/// Largest weight, to either side: sums of such weights stay finite and exact enough,
/// whatever an episode does.
pub(crate) const WEIGHT_MAX: f64 = 1e9;

/// A set of reward rules: a base, its weights and its limits.
#[derive(Clone, PartialEq, Debug)]
pub struct Preset {
    pub(crate) name: String,
    pub(crate) base: Base,
    pub(crate) weights: Weights,
    pub(crate) rules: Rules,
}

/// A weight for each term.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Weights([f64; Term::ALL.len()]);

/// What the rules of a base leave open besides weights. A base reads what it knows.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Rules {
    pub(crate) gamma: f64,
    pub(crate) free_steps: u32,
    pub(crate) ask_limit: u32,
    pub(crate) ambiguous_ask_limit: u32,
    pub(crate) nav_window: u32,
    pub(crate) max_steps: u32,
    pub(crate) max_turns: u32,
    pub(crate) anti_exploit: bool,
    pub(crate) pick_clears_first: bool,
}

/// The value of a rule.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum RuleValue {
    /// From 0 to 1.
    Share(f64),
    Count(u32),
    Switch(bool),
}

/// A rule that a preset file may set.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RuleSpec {
    pub(crate) name: &'static str,
    pub(crate) bases: &'static [Base],
    pub(crate) doc: &'static str,
}

impl Preset {
    /// The paper's Detailed Reward Configuration.
    pub fn paper() -> Self {
        Self::published(Base::Paper)
    }

    /// The reward class of the published code, without its anti-exploit terms.
    pub fn real_repo() -> Self {
        Self::published(Base::RealRepo)
    }

    /// What the published trainer pays, as configured by default.
    pub fn real_trainer() -> Self {
        Self::published(Base::RealTrainer)
    }

    /// The presets that need no file.
    pub fn built_in() -> [Preset; 3] {
        Base::ALL.map(Self::published)
    }

    /// A built-in preset by its name.
    pub fn parse(name: &str) -> Option<Self> {
        Base::parse(name).map(Self::published)
    }

    /// A base with its published weights and limits, under the base's name.
    pub(crate) fn published(base: Base) -> Self {
        Self {
            name: base.as_str().to_owned(),
            base,
            weights: Weights::published(),
            rules: Rules::published(base),
        }
    }

    /// As it stands on the command line and in traces.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The rules it is made of.
    pub fn base(&self) -> Base {
        self.base
    }

    /// Discount of its returns.
    pub fn gamma(&self) -> f64 {
        self.rules.gamma
    }

    /// The weight of a term.
    pub fn weight(&self, term: Term) -> f64 {
        self.weights.of(term)
    }

    /// The same preset with another weight: another version.
    ///
    /// # Panics
    /// When the term is of another base or the weight is beyond a thousand million: a programmer's
    /// error. Files are checked with errors.
    #[must_use]
    pub fn with_weight(mut self, term: Term, weight: f64) -> Self {
        assert!(
            term.belongs_to(self.base) && weight.abs() <= WEIGHT_MAX,
            "{} has no weight {weight} of {term:?}",
            self.base
        );
        self.weights.set(term, weight);
        self
    }

    /// What it computes, without its name: base, revision of the rules, every weight and limit
    /// that the base reads.
    pub fn content(&self) -> Value {
        let weights: Map<String, Value> = self
            .base
            .terms()
            .map(|term| (term.name().to_owned(), json!(self.weight(term))))
            .collect();
        let rules: Map<String, Value> = self
            .rule_values()
            .map(|(rule, value)| (rule.name.to_owned(), value.json()))
            .collect();
        json!({ "base": self.base.as_str(), "revision": revision(self.base), "weights": weights, "rules": rules })
    }

    /// Digest of [`Preset::content`]: equal versions compute equal rewards,
    /// whatever they are called.
    pub fn version(&self) -> Digest {
        Digest::of_json(&self.content())
    }

    /// The rules for the records of one episode.
    pub fn rewarder(&self, task: &Task, scene: &Scene) -> Box<dyn Rewarder> {
        Box::new(RecordRewarder::new(self, task, scene))
    }

    /// The graph that scores under this preset (docs/spec.md#authority).
    pub fn authority<'a>(&self, graphs: &'a Graphs) -> &'a WorldGraph {
        match self.base {
            Base::Paper => &graphs.physics,
            Base::RealRepo | Base::RealTrainer => &graphs.registry,
        }
    }

    /// The rules of its base with their values.
    pub(crate) fn rule_values(&self) -> impl Iterator<Item = (&'static RuleSpec, RuleValue)> {
        RuleSpec::of(self.base).map(|rule| (rule, self.rules.get(rule.name)))
    }
}

impl Default for Preset {
    fn default() -> Self {
        Self::paper()
    }
}

/// The terms of all steps at once: the same as streaming them.
pub fn rewards(
    preset: &Preset,
    task: &Task,
    scene: &Scene,
    start: &StartRecord,
    steps: &[StepRecord],
) -> Vec<Vec<RewardTerm>> {
    let mut rewarder = preset.rewarder(task, scene);
    rewarder.start(start);
    steps.iter().map(|step| rewarder.step(step)).collect()
}

impl Weights {
    fn published() -> Self {
        let mut weights = [0.0; Term::ALL.len()];
        for term in Term::ALL {
            weights[*term as usize] = term.published_weight();
        }
        Self(weights)
    }

    pub(crate) fn of(&self, term: Term) -> f64 {
        self.0[term as usize]
    }

    pub(crate) fn set(&mut self, term: Term, weight: f64) {
        self.0[term as usize] = weight;
    }
}

impl Rules {
    /// The paper discounts; the published trainer adds up.
    fn published(base: Base) -> Self {
        Rules {
            gamma: if base == Base::RealTrainer {
                1.0
            } else {
                GAMMA
            },
            free_steps: 3,
            ask_limit: 3,
            ambiguous_ask_limit: 3,
            nav_window: 6,
            max_steps: 50,
            max_turns: 50,
            anti_exploit: false,
            pick_clears_first: false,
        }
    }

    /// The value of a rule of [`RuleSpec::ALL`].
    fn get(&self, name: &str) -> RuleValue {
        match name {
            "gamma" => RuleValue::Share(self.gamma),
            "free_steps" => RuleValue::Count(self.free_steps),
            "ask_limit" => RuleValue::Count(self.ask_limit),
            "ambiguous_ask_limit" => RuleValue::Count(self.ambiguous_ask_limit),
            "nav_window" => RuleValue::Count(self.nav_window),
            "max_steps" => RuleValue::Count(self.max_steps),
            "max_turns" => RuleValue::Count(self.max_turns),
            "anti_exploit" => RuleValue::Switch(self.anti_exploit),
            "pick_clears_first" => RuleValue::Switch(self.pick_clears_first),
            other => unreachable!("rule {other} stands in RuleSpec::ALL but not here"),
        }
    }

    /// Sets a rule to a value of its own kind.
    pub(crate) fn set(&mut self, name: &str, value: RuleValue) {
        match (name, value) {
            ("gamma", RuleValue::Share(value)) => self.gamma = value,
            ("free_steps", RuleValue::Count(value)) => self.free_steps = value,
            ("ask_limit", RuleValue::Count(value)) => self.ask_limit = value,
            ("ambiguous_ask_limit", RuleValue::Count(value)) => self.ambiguous_ask_limit = value,
            ("nav_window", RuleValue::Count(value)) => self.nav_window = value,
            ("max_steps", RuleValue::Count(value)) => self.max_steps = value,
            ("max_turns", RuleValue::Count(value)) => self.max_turns = value,
            ("anti_exploit", RuleValue::Switch(value)) => self.anti_exploit = value,
            ("pick_clears_first", RuleValue::Switch(value)) => self.pick_clears_first = value,
            (name, value) => unreachable!("rule {name} cannot be {value:?}"),
        }
    }
}

impl RuleValue {
    pub(crate) fn json(self) -> Value {
        match self {
            RuleValue::Share(value) => json!(value),
            RuleValue::Count(value) => json!(value),
            RuleValue::Switch(value) => json!(value),
        }
    }
}

/// Bases with the published reward class.
const CLASS: [Base; 2] = [Base::RealRepo, Base::RealTrainer];

impl RuleSpec {
    const ALL: [RuleSpec; 9] = [
        RuleSpec {
            name: "gamma",
            bases: &Base::ALL,
            doc: "Discount of returns, from 0 to 1.",
        },
        RuleSpec {
            name: "free_steps",
            bases: &Base::ALL,
            doc: "So many steps cost no time.",
        },
        RuleSpec {
            name: "ask_limit",
            bases: &Base::ALL,
            doc: "At most so many questions earn `ask`.",
        },
        RuleSpec {
            name: "ambiguous_ask_limit",
            bases: &CLASS,
            doc: "At most so many questions earn `ask_when_ambiguous`.",
        },
        RuleSpec {
            name: "nav_window",
            bases: &CLASS,
            doc: "`nav_revisit_window` looks back so many drives.",
        },
        RuleSpec {
            name: "anti_exploit",
            bases: &CLASS,
            doc: "Whether the anti-exploit terms pay.",
        },
        RuleSpec {
            name: "pick_clears_first",
            bases: &[Base::RealRepo],
            doc: "Whether a successful pick forgets seen candidates and named markers before its own terms are computed, and \
                  only an answer that names a marker counts as an answer, as in the published environment.",
        },
        RuleSpec {
            name: "max_steps",
            bases: &[Base::RealTrainer],
            doc: "The environment's step limit: the first call from this step on ends the episode.",
        },
        RuleSpec {
            name: "max_turns",
            bases: &[Base::RealTrainer],
            doc: "The scheduler's turn limit: an episode that goes on after so many steps ends.",
        },
    ];

    /// The rules of a base.
    pub(crate) fn of(base: Base) -> impl Iterator<Item = &'static RuleSpec> {
        Self::ALL
            .iter()
            .filter(move |rule| rule.bases.contains(&base))
    }
}
