//! Traces in a shard: packed to their inputs, and every byte of them again.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use reel_trace::{Shard, ShardWriter, Trace};
use reel_vectors::{golden_traces, traces_in};
use serde_json::Value;

use crate::{complaint, expect, gate::forged_corpus};

/// The bytes of the traces in a folder and in those below it, by path.
fn bytes_in(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let below = fs::read_dir(folder).unwrap().map(|it| it.unwrap().path());
    let below: Vec<PathBuf> = below.filter(|path| path.is_dir()).collect();
    let folders = [folder.to_owned()].into_iter().chain(below);
    let files = folders.flat_map(|folder| traces_in(&folder));
    files
        .map(|path| {
            let name = path.strip_prefix(folder).unwrap().to_owned();
            (name, fs::read(path).unwrap())
        })
        .collect()
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_shard_gives_every_byte_of_its_traces_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 37 --out tasks");
    reel!(
        folder,
        "run --tasks tasks --policy explorer --out traces/explorer"
    );
    reel!(
        folder,
        "run --tasks tasks --policy no-ask --no-images --out traces/lean"
    );
    reel!(
        folder,
        "run --tasks tasks --record depth,masks --out traces/layers"
    );
    let packed = json(&reel!(folder, "pack traces --out all.mcap --json"));
    assert_eq!(
        (packed["episodes"].as_u64(), packed["tasks"].as_u64()),
        (Some(6), Some(2))
    );
    reel!(folder, "unpack all.mcap --out again");
    let (before, again) = (
        bytes_in(&folder.join("traces")),
        bytes_in(&folder.join("again")),
    );
    assert!(before.len() == 6 && before == again);

    // Named as a trace, or as a folder of them, it is read as traces are.
    let listed = reel!(folder, "unpack all.mcap --list --json");
    let listed: Vec<Value> = listed.lines().map(json).collect();
    let name = |index: usize| listed[index]["trace"].as_str().unwrap().to_owned();
    let id = listed[3]["episode_id"].as_str().unwrap();
    let first = format!("traces/{}", name(3));
    assert_eq!(
        reel!(folder, "show all.mcap#{id} --json").replace("all.mcap", ""),
        reel!(folder, "show all.mcap#3 --json").replace("all.mcap", "")
    );
    let shown = |path: &str| {
        let mut trace = json(&reel!(folder, "show {path} --json"));
        trace.as_object_mut().unwrap().remove("path");
        trace
    };
    assert_eq!(
        shown(&format!("all.mcap#{id}"))["steps"],
        shown(&first)["steps"]
    );
    let verdicts = reel!(folder, "replay all.mcap --json");
    assert_eq!(verdicts.matches(r#""exact""#).count(), 6, "{verdicts}");
    let rows = |of: &str, store: &str| {
        reel!(folder, "ingest {of} --store {store}");
        let sql = "SELECT episode_id, trace_digest, trace_bytes, success, total_reward FROM episodes ORDER BY 1, 2";
        expect(folder, 0, &["query", "--store", store, "--json", sql])
    };
    assert_eq!(rows("all.mcap", "packed"), rows("traces", "plain"));
    reel!(folder, "trace frames all.mcap#0 --out frames");
    let refused = |arguments: &str, told: &str| {
        let found = complaint(folder, 2, arguments);
        assert!(found.contains(told), "{arguments}: {found}");
    };
    refused("pack all.mcap --out twice.mcap", "is packed already");
    refused("pack traces --out all.mcap", "is there already");
    refused("pack traces --out all.reel", "ends with .mcap");
    // What is made of its episodes has a name for each.
    reel!(folder, "trace compact all.mcap --out compact");
    assert_eq!(traces_in(&folder.join("compact")).len(), 6);
    reel!(folder, "blame all.mcap --branches better");
    assert!(traces_in(&folder.join("better")).len() > 1);
    reel!(folder, "export rl --store packed --out rl");

    // What is asked for and not there, and a program that cannot execute.
    let missing = complaint(folder, 2, "show all.mcap#6");
    assert!(
        missing.contains("no episode '6' is among the 6 of the shard"),
        "{missing}"
    );
    let bare = Trace::read(&folder.join("all.mcap#0"))
        .unwrap_err()
        .to_string();
    assert!(bare.contains("reel unpack"), "{bare}");
    let whole = complaint(folder, 2, "show all.mcap");
    assert!(whole.contains("name one of them"), "{whole}");
    complaint(folder, 2, &format!("unpack {first} --list"));
    // A file in the way is not replaced, the same file is no reason to fail.
    reel!(folder, "unpack all.mcap --out again");
    fs::write(folder.join("again").join(name(0)), "another file").unwrap();
    let told = complaint(folder, 1, "unpack all.mcap --out again --episode 0");
    assert!(told.contains("exists"), "{told}");
}

/// The golden traces have links over records, and were written by builds of before.
#[test]
fn old_traces_come_back_with_their_links() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let some: Vec<PathBuf> = golden_traces().into_iter().step_by(6).collect();
    fs::create_dir(folder.join("old")).unwrap();
    for path in &some {
        fs::copy(path, folder.join("old").join(path.file_name().unwrap())).unwrap();
    }
    reel!(folder, "pack old --out old-ones.mcap");
    reel!(folder, "unpack old-ones.mcap --out again");
    assert!(bytes_in(&folder.join("old")) == bytes_in(&folder.join("again")));
}

#[test]
fn what_does_not_come_back_is_named_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    forged_corpus(&folder.join("corpus"), 3);
    let whole = fs::read(&golden_traces()[0]).unwrap();
    fs::write(folder.join("corpus/torn.mcap"), &whole[..whole.len() / 2]).unwrap();
    let told = complaint(folder, 1, "pack corpus --out some.mcap");
    assert!(
        told.contains("torn.mcap is not packed") && told.contains("executed again"),
        "{told}"
    );
    assert_eq!(Shard::open(&folder.join("some.mcap")).unwrap().len(), 1);
    fs::remove_dir_all(folder.join("corpus")).unwrap();
    forged_corpus(&folder.join("corpus"), 3);
    fs::remove_file(folder.join("corpus").join(crate::gate::NAMES[1])).unwrap();
    complaint(folder, 2, "pack corpus --out none.mcap");
    assert!(!folder.join("none.mcap").exists() && !folder.join("none.mcap.tmp").exists());
}

/// Whatever byte is changed: the traces are the same, or the shard is refused.
#[test]
fn a_damaged_shard_is_refused_or_gives_the_same_inputs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = ShardWriter::create(&path).unwrap();
    for golden in golden_traces().iter().take(4) {
        let (trace, bytes) = (Trace::read(golden).unwrap(), fs::read(golden).unwrap());
        let packed = reel_trace::PackedEpisode::of(&trace, &bytes, "a.mcap").unwrap();
        writer.add(&packed).unwrap();
    }
    writer.finish().unwrap();
    let told = |path: &Path| -> Result<String, String> {
        let shard = Shard::open(path).map_err(|error| error.to_string())?;
        let episodes =
            (0..shard.len()).map(|number| shard.episode(number).map(|it| format!("{it:?}")));
        episodes
            .collect::<Result<String, _>>()
            .map_err(|error| error.to_string())
    };
    let (bytes, sound) = (fs::read(&path).unwrap(), told(&path).unwrap());
    let changed = folder.path().join("b.mcap");
    let mut refused = 0;
    for at in (0..bytes.len()).step_by(bytes.len() / 600 + 1) {
        let mut bytes = bytes.clone();
        bytes[at] ^= 0x15;
        fs::write(&changed, &bytes).unwrap();
        match told(&changed) {
            Ok(same) => assert!(same == sound, "byte {at} is not noticed"),
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 300, "{refused}");
    for length in (0..bytes.len()).step_by(bytes.len() / 60 + 1) {
        fs::write(&changed, &bytes[..length]).unwrap();
        assert!(told(&changed).is_err(), "cut at {length}");
    }
}
