//! Tasks from and into drawers, shelves and compartments: generated, done by the oracle, replayed.

use std::{collections::BTreeSet, fs, path::Path};

use reel_trace::Trace;
use reel_world::{Door, ReceptacleId};

/// What an episode ended in, and the parts that the robot picked from or placed into.
struct Played {
    succeeds: bool,
    used: Vec<Door>,
}

fn played(path: &Path) -> Played {
    let trace = Trace::read(path).unwrap();
    let part = |id: &ReceptacleId| {
        let receptacle = trace.scene.receptacle(id)?;
        receptacle.part_of.as_ref().map(|_| receptacle.door)
    };
    Played {
        succeeds: trace.end.as_ref().unwrap().metrics.success,
        used: [&trace.task.src, &trace.task.dest]
            .into_iter()
            .filter_map(part)
            .collect(),
    }
}

#[test]
fn the_oracle_uses_drawers_and_shelves_and_its_episodes_replay() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task generate --scene S1-parts --scene S6-parts --count 24 --seed 11 --out tasks"
    );
    for profile in ["paper", "real-repo"] {
        reel!(
            folder,
            "run --tasks tasks --policy oracle --profile {profile} --out {profile} --no-images"
        );
        reel!(folder, "replay {profile}");
        let traces = fs::read_dir(folder.join(profile)).unwrap();
        let played: Vec<Played> = traces
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "mcap"))
            .map(|path| played(&path))
            .collect();
        let failed = played.iter().filter(|episode| !episode.succeeds).count();
        assert_eq!((played.len(), failed), (24, 0), "{profile}");
        let used: BTreeSet<String> = played
            .iter()
            .flat_map(|episode| &episode.used)
            .map(|door| format!("{door:?}"))
            .collect();
        assert!(
            used.contains("Drawer") && used.contains("None"),
            "{profile}: {used:?}"
        );
    }
}
