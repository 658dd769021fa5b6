//! Rows within the rows of episodes and steps: changes of a graph, terms of a reward, what has a
//! number and what is in view.

use reel_world::{
    GraphEvent, Task,
    record::{GraphChanges, Graphs, Marker, MarkerTarget, RewardTerm, Score, VisibleObject},
};
use serde::Serialize;

#[derive(Serialize)]
pub(crate) struct Change {
    pub(crate) authority: &'static str,
    pub(crate) event: &'static str,
    pub(crate) object: Option<String>,
    pub(crate) asset: Option<String>,
    pub(crate) receptacle: String,
    pub(crate) door_from: Option<String>,
    pub(crate) door_to: Option<String>,
}

pub(super) fn changes(changes: &GraphChanges) -> Vec<Change> {
    let physics = changes.physics.iter().map(|event| change("physics", event));
    physics
        .chain(
            changes
                .registry
                .iter()
                .map(|event| change("registry", event)),
        )
        .collect()
}

/// How the graphs after settling differ from the task's.
pub(super) fn start_changes(task: &Task, graphs: &Graphs) -> Vec<Change> {
    let physics = graphs.physics.difference(&task.initial);
    changes(&GraphChanges {
        physics,
        registry: graphs.registry.difference(&task.initial),
    })
}

fn change(authority: &'static str, event: &GraphEvent) -> Change {
    let (name, doors) = match event {
        GraphEvent::Add { .. } => ("add", None),
        GraphEvent::Remove { .. } => ("remove", None),
        GraphEvent::Door { from, to, .. } => ("door", Some((from, to))),
    };
    Change {
        authority,
        event: name,
        object: event.object().map(|object| object.as_str().to_owned()),
        asset: event.object().map(|object| object.asset().into()),
        receptacle: event.receptacle().as_str().to_owned(),
        door_from: doors.map(|(from, _)| from.to_string()),
        door_to: doors.map(|(_, to)| to.to_string()),
    }
}

#[derive(Serialize)]
pub(crate) struct PolicyLogprobs<'a> {
    pub(crate) policy: &'a str,
    pub(crate) logprobs: &'a [f64],
}

#[derive(Serialize)]
pub(crate) struct Term<'a> {
    pub(crate) component: &'a str,
    pub(crate) value: f64,
    pub(crate) reason: &'a str,
}

pub(super) fn term(term: &RewardTerm) -> Term<'_> {
    Term {
        component: &term.component,
        value: term.value,
        reason: &term.reason,
    }
}

#[derive(Serialize)]
pub(crate) struct MarkerRow<'a> {
    pub(crate) marker: u32,
    pub(crate) kind: &'static str,
    pub(crate) id: &'a str,
}

pub(super) fn marker(marker: &Marker) -> MarkerRow<'_> {
    let (kind, id) = match &marker.target {
        MarkerTarget::Object(id) => ("object", id.as_str()),
        MarkerTarget::Receptacle(id) => ("receptacle", id.as_str()),
    };
    MarkerRow {
        marker: marker.id,
        kind,
        id,
    }
}

#[derive(Serialize)]
pub(crate) struct Visible<'a> {
    pub(crate) object: &'a str,
    pub(crate) pixels: u32,
    pub(crate) x_min: u16,
    pub(crate) y_min: u16,
    pub(crate) x_max: u16,
    pub(crate) y_max: u16,
}

pub(super) fn visible(visible: &VisibleObject) -> Visible<'_> {
    let VisibleObject {
        object,
        pixels,
        bbox: [x_min, y_min, x_max, y_max],
    } = visible;
    Visible {
        object: object.as_str(),
        pixels: *pixels,
        x_min: *x_min,
        y_min: *y_min,
        x_max: *x_max,
        y_max: *y_max,
    }
}

/// A score that was told with an episode.
#[derive(Serialize)]
pub(crate) struct ScoreRow<'a> {
    name: &'a str,
    value: Option<f64>,
    label: Option<&'a str>,
    explanation: Option<&'a str>,
}

pub(super) fn score_row(score: &Score) -> ScoreRow<'_> {
    ScoreRow {
        name: &score.name,
        value: score.value,
        label: score.label.as_deref(),
        explanation: score.explanation.as_deref(),
    }
}
