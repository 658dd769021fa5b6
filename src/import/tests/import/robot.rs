//! Recordings of robots hold the same in every encoding, in parts, out of order and broken; and no
//! recording makes the importer panic.

mod boundaries;
mod episode;
mod faults;
mod fields;
mod known_tasks;
mod sensors;

use std::{
    fs,
    path::{Path, PathBuf},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use mcap::Compression;
use reel_import::{
    ImportError, ImportOptions,
    robot::{Mapping, Recording, import, recordings},
};
use reel_trace::{Trace, examine};
use reel_world::{ErrorCode, record::EndReason};
use serde_json::json;

use crate::{
    PLAIN,
    bags::{self, BEGIN_NS, Encoding, MAPPING, Said, jpeg, odometry, said},
};
use episode::{APPLE, call, episode, graph, result, without_images};

struct Place {
    folder: tempfile::TempDir,
    out: PathBuf,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("traces");
        fs::create_dir_all(&out).unwrap();
        Self { folder, out }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Imports a recording with one mapping; its traces are whole and healthy.
    fn import_by(
        &self,
        mapping: &str,
        path: &Path,
        options: &ImportOptions<'_>,
    ) -> (Recording, Vec<Trace>) {
        let mapping = Mapping::parse(mapping).unwrap();
        let recording =
            import(path, &mapping, &self.out, options).unwrap_or_else(|error| panic!("{error}"));
        let traces = recording
            .episodes
            .iter()
            .map(|imported| healthy(&imported.trace))
            .collect();
        (recording, traces)
    }

    fn import(&self, path: &Path) -> (Recording, Trace) {
        let (recording, mut traces) = self.import_by(MAPPING, path, &PLAIN);
        assert_eq!(traces.len(), 1);
        (recording, traces.remove(0))
    }

    /// Writes messages in JSON and imports them.
    fn said(&self, messages: &[Said]) -> (Recording, Trace) {
        let path = self.path("said.mcap");
        bags::write(&path, messages, Encoding::Json);
        self.import(&path)
    }
}

fn healthy(path: &Path) -> Trace {
    let trace = Trace::read(path).unwrap_or_else(|error| panic!("{error}"));
    let examination = examine(path).unwrap();
    assert_eq!(examination.findings, []);
    assert_eq!(
        examination.notes,
        ["recorded on a robot: nothing to re-execute"]
    );
    trace
}

fn bytes(recording: &Recording) -> Vec<u8> {
    fs::read(&recording.episodes[0].trace).unwrap()
}

#[test]
fn equal_in_every_encoding_and_compression() {
    let place = Place::new();
    let mut traces = Vec::new();
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Cdr] {
        for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
            let path = place.path(&format!("{encoding:?}-{compression:?}.mcap"));
            bags::write_with(&path, &episode(), encoding, compression);
            let (recording, _) = place.import(&path);
            assert_eq!(recording.losses, [], "{encoding:?} {compression:?}");
            traces.push(bytes(&recording));
        }
    }
    assert!(traces.iter().all(|trace| *trace == traces[0]));
}

#[test]
fn parts_of_a_recording_in_their_order() {
    let place = Place::new();
    let (whole, _) = place.said(&episode());
    let whole = bytes(&whole);
    let folder = place.path("bags/drive");
    fs::create_dir_all(&folder).unwrap();
    let messages = episode();
    for (number, part) in messages.chunks(10).enumerate() {
        bags::write(
            &folder.join(format!("drive_{number}.mcap")),
            part,
            Encoding::Cdr,
        );
    }
    // Without metadata the numbers say the order: ten stands behind two.
    let (recording, _) = place.import(&folder);
    assert!(bytes(&recording) == whole);
    assert!(
        recording.notes[0].starts_with("there is no metadata.yaml"),
        "{:?}",
        recording.notes
    );

    let names: String = (0..4)
        .map(|number| format!("    - drive_{number}.mcap\n"))
        .collect();
    let metadata = |names: &str| {
        format!("rosbag2_bagfile_information:\n  version: 8\n  relative_file_paths:\n{names}")
    };
    fs::write(folder.join("metadata.yaml"), metadata(&names)).unwrap();
    fs::copy(place.path("said.mcap"), place.path("bags/one.mcap")).unwrap();
    assert_eq!(
        recordings(&place.path("bags")).unwrap(),
        [folder.clone(), place.path("bags/one.mcap")]
    );
    let (recording, _) = place.import(&folder);
    assert!(bytes(&recording) == whole);
    assert_eq!((recording.losses.len(), recording.notes.len()), (0, 1));

    // A part that is missing is said, and the others are imported.
    fs::remove_file(folder.join("drive_3.mcap")).unwrap();
    let (recording, trace) = place.import(&folder);
    assert_eq!(
        recording.losses[0].message,
        "metadata.yaml names it, and it is not there"
    );
    assert_eq!(trace.steps.len(), 5);

    fs::write(
        folder.join("metadata.yaml"),
        metadata("    - drive_0.db3\n"),
    )
    .unwrap();
    let error = import(
        &folder,
        &Mapping::parse(MAPPING).unwrap(),
        &place.out,
        &PLAIN,
    )
    .unwrap_err();
    assert!(
        matches!(&error, ImportError::Storage { reason, .. } if reason.contains("ros2 bag convert")),
        "{error}"
    );
}

#[test]
fn the_example_of_a_mapping_is_one() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../schemas/robot_mapping.example.toml");
    let text = fs::read_to_string(path).unwrap();
    Mapping::parse(&text).unwrap_or_else(|error| panic!("{error}"));
    // It names every kind of topic.
    for kind in [
        "call",
        "result",
        "primitive",
        "vla",
        "odometry",
        "alignment",
        "camera",
        "graph",
        "held",
        "landmark",
        "map",
        "markers",
        "reply",
        "policy",
        "episode",
    ] {
        assert!(text.contains(&format!("is = \"{kind}\"")), "{kind}");
    }
}
