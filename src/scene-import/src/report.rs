//! What an import says of itself: receptacles and whether the robot reaches them, what was
//! approximated, what was left out, what the check of the scene finds.

use std::collections::BTreeMap;

use reel_tasks::{
    generate::scene::{Finding, SceneFault},
    scene::LoadedScene,
};
use serde::Serialize;

use crate::{Note, SceneFormat, notes::Notes};

/// The report of one file.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ImportReport {
    /// Name of the file that was imported.
    pub file: String,
    /// Format that it was read as.
    pub format: String,
    /// Name of the scene that was made.
    pub scene_id: String,
    /// How many rooms the scene has.
    pub rooms: usize,
    /// The receptacles, in the order of the scene.
    pub receptacles: Vec<ReceptacleReport>,
    /// What is not exactly as in the file, by kind.
    pub approximated: BTreeMap<String, Note>,
    /// What is in the file but not in the scene, by kind.
    pub left_out: BTreeMap<String, Note>,
    /// What is doubtful in the scene.
    pub warnings: Vec<String>,
    /// What `reel scene check` finds, one sentence each.
    pub findings: Vec<String>,
}

/// A receptacle and where it comes from.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ReceptacleReport {
    /// Id of the receptacle in the scene.
    pub id: String,
    /// Object, body, link or prim of the file that it comes from.
    pub source: String,
    /// Name of its room in the scene.
    pub room: String,
    /// How instructions name it.
    pub caption: String,
    /// Whether there is a viewpoint from which the robot sees its surface.
    pub reached: bool,
}

impl ImportReport {
    pub(crate) fn new(
        file: &str,
        format: SceneFormat,
        loaded: &LoadedScene,
        findings: &[Finding],
        sources: Vec<String>,
        notes: Notes,
    ) -> Self {
        let is_reached = |id: &str| {
            let hinders = |fault| matches!(fault, SceneFault::Unreachable | SceneFault::NoSight);
            !findings
                .iter()
                .any(|finding| finding.at == id && hinders(finding.fault))
        };
        let scene = &loaded.scene;
        let receptacles = scene
            .receptacles
            .iter()
            .zip(sources)
            .map(|(receptacle, source)| ReceptacleReport {
                id: receptacle.id.to_string(),
                source,
                room: receptacle.room.clone(),
                caption: receptacle.main_caption().unwrap_or_default().to_owned(),
                reached: is_reached(receptacle.id.as_str()),
            });
        let sentence = |finding: &Finding| {
            let [x, y] = finding.place;
            format!("{} at ({x:.2}, {y:.2}): {}", finding.at, finding.message)
        };
        Self {
            file: file.to_owned(),
            format: format.as_str().to_owned(),
            scene_id: scene.scene_id.clone(),
            rooms: scene.rooms.len(),
            receptacles: receptacles.collect(),
            approximated: notes.approximated,
            left_out: notes.left_out,
            warnings: loaded.warnings.clone(),
            findings: findings.iter().map(sentence).collect(),
        }
    }

    /// How many receptacles the robot reaches.
    pub fn reached(&self) -> usize {
        self.receptacles
            .iter()
            .filter(|receptacle| receptacle.reached)
            .count()
    }
}
