//! What a perturbed agent says along with its calls: a History of what it did, in several styles
//! and languages, with claims, negations and intentions put between. Never a reason of its calls.

use reel_episode::Observation;
use reel_world::{Tool, ToolCall, record::PolicyOutput};

/// The History so far, in one of several styles.
#[derive(Clone, Debug, Default)]
pub(super) struct Words {
    style: usize,
    entries: Vec<String>,
    pending: Option<String>,
}

/// What may be claimed falsely: that the object is in the hand, or where it belongs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Claim {
    /// That the object was picked.
    Picked,
    /// That the object was placed.
    Placed,
    /// That something was done which nobody asked for.
    Idle,
    /// A negation or an intention, which is true.
    Intention,
}

impl Words {
    /// An agent that talks in this style; 0: it says nothing.
    pub fn new(style: usize) -> Self {
        Self {
            style,
            ..Self::default()
        }
    }

    /// Puts a claim into the History; `number` chooses among its wordings.
    pub fn claim(&mut self, claim: Claim, thing: &str, number: usize) {
        let wordings: [String; 6] = match claim {
            Claim::Picked => [
                format!("picked up the {thing}"),
                format!("The {thing} is in my gripper now"),
                format!("{thing} aufgenommen"),
                format!("j'ai pris l'objet ({thing})"),
                format!("took hold of the {thing}, so my hand is full"),
                format!("ya tengo el objeto: {thing}"),
            ],
            Claim::Placed => [
                format!("placed the {thing} at its destination"),
                format!("The {thing} is where it belongs"),
                format!("put the {thing} down, the task is complete"),
                format!("{thing} abgestellt, fertig"),
                format!("l'objet ({thing}) est posé à sa place"),
                format!("delivered the {thing}"),
            ],
            Claim::Idle => [
                format!("asked the user about the {thing}"),
                "opened every door of the kitchen".to_owned(),
                format!("checked the {thing} twice"),
                "walked around all tables".to_owned(),
                format!("picked the {thing} and put it back"),
                "closed the fridge".to_owned(),
            ],
            Claim::Intention => [
                format!("I have not picked the {thing} yet"),
                format!("I will place the {thing} as soon as I hold it"),
                format!("not placed yet: the {thing}"),
                format!("ich werde {thing} gleich abstellen"),
                "next I am going to open the door if it is closed".to_owned(),
                format!("no question was asked about the {thing} so far"),
            ],
        };
        self.entries.push(wordings[number % 6].clone());
    }

    /// Writes down how the last call went and that this one is made.
    pub fn narrate(&mut self, call: &ToolCall, observation: &Observation) -> Option<PolicyOutput> {
        if let Some(pending) = self.pending.take() {
            self.entries.push(match observation.error {
                None => pending,
                Some(code) if self.style == 3 => format!("{pending} (fehlgeschlagen: {code})"),
                Some(code) => format!("{pending} (failed: {code})"),
            });
        }
        self.pending = Some(self.deed(call));
        let separator = if self.style == 2 { ". " } else { "; " };
        (self.style > 0).then(|| PolicyOutput {
            raw: if call.name.is_empty() {
                "Let me think about that.".into()
            } else {
                String::new()
            },
            history: self.entries.join(separator),
            ..PolicyOutput::default()
        })
    }

    fn deed(&self, call: &ToolCall) -> String {
        let english = self.style != 3;
        let Ok(tool) = Tool::parse(call) else {
            return if english {
                "tried something"
            } else {
                "etwas versucht"
            }
            .to_owned();
        };
        let say = |one: String, two: String| if english { one } else { two };
        match tool {
            Tool::NavTo { receptacle } => say(
                format!("went to {receptacle}"),
                format!("nach {receptacle} gefahren"),
            ),
            Tool::Pick { marker } => say(
                format!("picked {marker}"),
                format!("Nummer {marker} genommen"),
            ),
            Tool::Place { marker } => say(
                format!("placed it on {marker}"),
                format!("auf {marker} abgestellt"),
            ),
            Tool::Open { marker } => {
                say(format!("opened {marker}"), format!("{marker} aufgemacht"))
            }
            Tool::Close { marker } => {
                say(format!("closed {marker}"), format!("{marker} zugemacht"))
            }
            Tool::GazeAt { marker } => {
                say(format!("looked at {marker}"), format!("{marker} angesehen"))
            }
            Tool::Ask { .. } => say("asked the user".into(), "gefragt".into()),
            Tool::Finish => say("finished".into(), "fertig".into()),
            _ => say("looked around".into(), "umgesehen".into()),
        }
    }
}
