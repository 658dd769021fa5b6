//! `reel.toml`, completions and man pages from outside.

use std::fs;

use crate::{complaint, expect};

#[test]
fn values_come_from_the_nearest_file() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).unwrap();
    let file = folder.path().join("reel.toml");
    fs::write(&file, "store = \"tables\"\nscenes = [\"a\", \"/b\"]\n").unwrap();
    let shown = expect(&inner, 0, "config");
    let (store, name) = (folder.path().join("tables"), file.display());
    assert!(shown.contains(&format!("{} ", store.display())), "{shown}");
    assert!(
        shown.contains(&format!("{name}:1")) && shown.contains(&format!("{name}:2")),
        "{shown}"
    );
    let scene = format!("{}, /b ", folder.path().join("a").display());
    assert!(shown.contains(&scene), "{shown}");
    #[cfg(feature = "analytics")]
    {
        assert!(complaint(&inner, 2, "store list").contains(&store.display().to_string()));
        assert!(complaint(&inner, 2, "store list --store typed").ends_with(": typed\n"));
    }

    fs::write(inner.join("reel.toml"), "\nstroe = \"x\"\n").unwrap();
    let told = complaint(&inner, 2, "config");
    assert!(
        told.contains("inner/reel.toml:2") && told.contains("allowed are store, scenes"),
        "{told}"
    );
    fs::write(inner.join("reel.toml"), "model = 7").unwrap();
    let told = complaint(&inner, 2, "config");
    assert!(told.contains("reel.toml:1: model must be a text"), "{told}");
    fs::write(inner.join("reel.toml"), "[limits]\nsessions = 3\n").unwrap();
    assert!(complaint(&inner, 0, "config").contains("a configuration of `reel serve`"));
}

#[test]
fn scenes_are_found_in_the_folders_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("far")).unwrap();
    reel!(
        folder,
        "scene generate --seed 7 --name flat --out far/flat.json"
    );
    reel!(
        folder,
        "task generate --scene far/flat.json --count 1 --out made"
    );
    fs::remove_file(folder.join("made/flat.json")).unwrap();
    let told = expect(folder, 1, "task check made");
    assert!(
        told.contains("scene flat") && told.contains("made/flat, "),
        "{told}"
    );
    reel!(folder, "task check made --scene-dir far");
    fs::write(folder.join("reel.toml"), "scenes = [\"far\"]").unwrap();
    reel!(folder, "task check made");
}

#[test]
fn completions_and_man_pages_name_all_commands() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for shell in ["bash", "zsh", "fish"] {
        let script = reel!(folder, "completions {shell}");
        assert!(
            script.contains("recover") && script.contains("real-bench"),
            "{shell}"
        );
    }
    reel!(folder, "man --out man1");
    let page = fs::read_to_string(folder.join("man1/reel-trace-recover.1")).unwrap();
    assert!(page.contains("reel trace recover"), "{page}");
}
