//! Folders of files, most of which are no sound meshes: each loads or is refused with a
//! reason, and nothing panics.

mod samples;
mod usd;

use std::{
    fs,
    sync::{Arc, LazyLock},
};

use proptest::{prelude::*, sample::Index};
use reel_tasks::assets::{AssetFolder, MeshError, MeshFormat, MeshVerdict, NoSiblings, parse};
use reel_world::{AssetId, Assets};

#[test]
fn every_file_loads_or_is_refused_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let expected = samples::write(folder.path());
    assert!(expected.len() > 40);
    let listed = AssetFolder::open(folder.path()).unwrap().check();
    let names: Vec<&str> = listed.iter().map(|file| file.file.as_str()).collect();
    assert_eq!(names.len(), expected.len(), "{names:?}");
    for (name, refused) in expected {
        let file = listed
            .iter()
            .find(|file| file.file == name)
            .unwrap_or_else(|| panic!("{name} is not listed"));
        match (&file.verdict, refused) {
            (MeshVerdict::Loads(_), None) => {}
            (MeshVerdict::Refused { reason }, Some(part)) => {
                assert!(reason.contains(part), "{name} is refused: {reason}")
            }
            (verdict, wanted) => panic!("{name}: {verdict:?}, not {wanted:?}"),
        }
    }
}

#[test]
fn the_first_kind_of_file_hides_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let (document, binary) = samples::gltf(&samples::cube(), &[]);
    fs::write(
        folder.path().join("mug.obj"),
        samples::obj(&samples::vase(), ""),
    )
    .unwrap();
    fs::write(
        folder.path().join("mug.glb"),
        samples::glb(&document, &binary),
    )
    .unwrap();
    fs::write(folder.path().join("notes.txt"), "not an asset").unwrap();
    fs::create_dir(folder.path().join("below.obj")).unwrap();
    let folder = AssetFolder::open(folder.path()).unwrap();
    let listed = folder.check();
    assert_eq!(listed.len(), 3);
    assert!(
        matches!(&listed[0].verdict, MeshVerdict::Refused { reason } if reason.contains("no file")),
        "{listed:?}"
    );
    assert!(matches!(&listed[1].verdict, MeshVerdict::Loads(survey) if survey.triangles == 12));
    assert_eq!(
        listed[2].verdict,
        MeshVerdict::Hidden {
            by: "mug.glb".into()
        }
    );
    let mug = folder.mesh(&"mug".into()).unwrap();
    assert!(
        Arc::ptr_eq(&mug, &folder.mesh(&"mug".into()).unwrap()),
        "read once"
    );
    assert!(folder.mesh(&"Mug".into()).is_none() && folder.mesh(&"../mug".into()).is_none());
    assert_eq!(
        folder
            .meshes(&mut [&AssetId::from("mug"), &AssetId::from("plate")].into_iter())
            .len(),
        1
    );
}

#[test]
fn what_is_said_of_a_mesh_is_true() {
    let survey = |name: &str| {
        let folder = tempfile::tempdir().unwrap();
        samples::write(folder.path());
        let listed = AssetFolder::open(folder.path()).unwrap().check();
        match listed
            .into_iter()
            .find(|file| file.file == name)
            .unwrap()
            .verdict
        {
            MeshVerdict::Loads(survey) => survey,
            other => panic!("{name}: {other:?}"),
        }
    };
    let cube = survey("glb_plain.glb");
    assert_eq!(
        (cube.triangles, cube.vertices, cube.size),
        (12, 8, [1.0; 3])
    );
    assert!(cube.watertight && cube.manifold && cube.textures.is_empty());
    let vase = survey("glb_textured.glb");
    assert!(!vase.watertight && vase.manifold);
    assert_eq!(vase.textures, [[256, 256]]);
    // y up becomes z up.
    assert!(
        vase.size[2] == 1.4 && (vase.size[0] - 0.9).abs() < 1e-5,
        "{:?}",
        vase.size
    );
    assert_eq!(survey("obj_textured.obj").triangles, vase.triangles);
    assert!(!survey("not_manifold.obj").manifold);
    let sheet = survey("sheet.obj");
    assert!(sheet.manifold && !sheet.watertight && sheet.triangles == 2);
    assert!(survey("obj_colored.obj").vertex_colors && survey("obj_colored.obj").watertight);
    // Turned by about 74 degrees and twice as large: 2 * (0.28 + 0.96) wide.
    let turned = survey("glb_nodes.glb");
    assert!(
        (turned.size[0] - 2.48).abs() < 1e-5 && (turned.size[2] - 2.0).abs() < 1e-5,
        "{:?}",
        turned.size
    );
    assert_eq!(
        survey("gltf_beside.gltf").digest,
        cube.digest,
        "the same mesh in another container"
    );
    assert_eq!(survey("gltf_embedded.gltf").digest, cube.digest);
}

#[cfg(unix)]
#[test]
fn links_lead_nowhere_else() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    fs::write(
        elsewhere.path().join("cube.obj"),
        samples::obj(&samples::cube(), ""),
    )
    .unwrap();
    std::os::unix::fs::symlink(
        elsewhere.path().join("cube.obj"),
        folder.path().join("cube.obj"),
    )
    .unwrap();
    let folder = AssetFolder::open(folder.path()).unwrap();
    let refusal = folder.load(&"cube".into()).unwrap_err();
    assert!(matches!(&*refusal, MeshError::Outside { .. }), "{refusal}");
}

static SOUND: LazyLock<Vec<(MeshFormat, Vec<u8>)>> = LazyLock::new(|| {
    let (document, binary) = samples::textured(&samples::vase(), &samples::pattern());
    let (plain, bytes) = samples::gltf(&samples::cube(), &[]);
    vec![
        (MeshFormat::Glb, samples::glb(&document, &binary)),
        (MeshFormat::Glb, samples::glb(&plain, &bytes)),
        (
            MeshFormat::Obj,
            samples::obj(&samples::cube(), "").into_bytes(),
        ),
    ]
});

proptest! {
    /// Bytes changed, taken out or put in anywhere: a mesh, or a reason.
    #[test]
    fn no_bytes_make_it_panic(
        which in 0..3usize,
        edits in prop::collection::vec((any::<Index>(), any::<u8>(), 0..3u8), 1..6),
        near_the_start in any::<bool>(),
    ) {
        let (kind, mut bytes) = SOUND[which].clone();
        for (at, byte, edit) in edits {
            let range = if near_the_start { bytes.len().min(1400) } else { bytes.len() };
            let at = at.index(range.max(1)).min(bytes.len().saturating_sub(1));
            match edit {
                0 => bytes[at] = byte,
                1 => drop(bytes.remove(at)),
                _ => bytes.insert(at, byte),
            }
        }
        if let Err(refusal) = parse(kind, &bytes, &NoSiblings) {
            prop_assert!(!refusal.to_string().is_empty());
        }
    }

    /// Digits of a document changed: what refers to what, and how much of it there is.
    #[test]
    fn no_numbers_make_it_panic(edits in prop::collection::vec((any::<Index>(), any::<u8>()), 1..4)) {
        let (document, binary) = samples::textured(&samples::cube(), &samples::pattern());
        let mut text = document.to_string().into_bytes();
        let digits: Vec<usize> = (0..text.len()).filter(|at| text[*at].is_ascii_digit()).collect();
        for (at, byte) in edits {
            text[digits[at.index(digits.len())]] = b'0' + byte % 10;
        }
        if let Ok(document) = serde_json::from_slice(&text) {
            drop(parse(MeshFormat::Glb, &samples::glb(&document, &binary), &NoSiblings));
        }
    }
}
