//! An episode whose objects are from USD: recorded and replayed exactly.

use std::{fs, path::Path};

use crate::expect;

/// A tetrahedron of one metre, in the units of the layer that refers to it.
const BODY: &str = "#usda 1.0\n(\n    defaultPrim = \"Body\"\n)\ndef Mesh \"Body\"\n{\n    point3f[] points = [(0, 0, 0), (100, 0, 0), (0, 100, 0), (0, 0, 100)]\n    int[] faceVertexCounts = [3, 3, 3, 3]\n    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]\n}\n";
/// An object in centimetres with y up, its faces in a layer of their own.
const USD: &str = "#usda 1.0\n(\n    metersPerUnit = 0.01\n    upAxis = \"Y\"\n)\ndef \"Object\" (prepend references = @parts/body.usda@)\n{\n}\n";

/// The assets of the objects of the tasks, from the task files.
pub fn assets(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.join("tasks")];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "yaml") {
                let text = fs::read_to_string(path).unwrap();
                let assets = text.lines().filter_map(|line| {
                    line.trim()
                        .trim_start_matches("- ")
                        .strip_prefix("original_id:")
                });
                found.extend(assets.map(|asset| asset.trim().trim_matches(['"', '\'']).to_owned()));
            }
        }
    }
    assert!(!found.is_empty(), "no assets in the tasks");
    found
}

/// Objects from USD: listed, recorded, replayed exactly, and refused where the layer is another.
#[test]
fn episodes_with_objects_of_usd_replay_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task draw --count 1 --families FDP --seed 4 --out tasks"
    );
    fs::create_dir_all(folder.join("meshes/parts")).unwrap();
    fs::write(folder.join("meshes/parts/body.usda"), BODY).unwrap();
    let names = assets(folder);
    for asset in &names {
        fs::write(folder.join(format!("meshes/{asset}.usda")), USD).unwrap();
    }
    let listed = reel!(folder, "scene check-assets meshes");
    assert!(
        listed.contains("4 triangles, 4 vertices, 1.000 x 1.000 x 1.000, watertight"),
        "{listed}"
    );
    assert!(!listed.contains("note:"), "{listed}");
    fs::write(folder.join("meshes/mugg_01.usda"), USD).unwrap();
    let misspelt = reel!(folder, "scene check-assets meshes");
    let note = "note: no object of the library has the asset mugg_01; only";
    assert!(misspelt.contains(note), "{misspelt}");
    fs::remove_file(folder.join("meshes/mugg_01.usda")).unwrap();
    reel!(
        folder,
        "run --tasks tasks --assets meshes --out traces --no-images"
    );
    assert!(expect(folder, 1, "replay traces").contains("REFUSED"));
    assert!(reel!(folder, "replay traces --assets meshes").contains(": exact: "));
    let wider = BODY.replace("(100, 0, 0)", "(150, 0, 0)");
    fs::write(folder.join("meshes/parts/body.usda"), wider).unwrap();
    let other = expect(folder, 1, "replay traces --assets meshes");
    assert!(other.contains("REFUSED"), "{other}");
    fs::remove_file(folder.join("meshes/parts/body.usda")).unwrap();
    let refused = expect(folder, 1, "scene check-assets meshes");
    assert!(
        refused.contains("/Object: @parts/body.usda@ is missing"),
        "{refused}"
    );
}
