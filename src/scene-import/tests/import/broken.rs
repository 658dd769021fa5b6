//! Broken files: each error says where and what; no bytes make an import panic.

use std::{fs, path::Path};

use proptest::prelude::*;
use reel_scene_import::{ImportOptions, SceneFormat, import};

use crate::data;

/// The error of importing a text.
fn error(name: &str, text: &str) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join(name), text).expect("writes");
    match import(&folder.path().join(name), &ImportOptions::default()) {
        Ok(imported) => panic!("{name} is imported: {:?}", imported.report),
        Err(error) => error.to_string(),
    }
}

#[test]
fn errors_say_where_and_what() {
    let house = fs::read_to_string(data("procthor_house.json")).expect("reads");
    let urdf = fs::read_to_string(data("cabinet.urdf")).expect("reads");
    let stage = fs::read_to_string(data("living_room.usda")).expect("reads");
    let body = |inner: &str| {
        format!("<mujoco>\n<worldbody><body name=\"table\">{inner}</body></worldbody></mujoco>")
    };
    let deep = "<body>".repeat(5000) + &"</body>".repeat(5000);
    let cases = [
        ("torn.json", house[..house.len() / 2].to_owned(), "torn.json:"),
        ("wall.json", house.replace("\"wall0\": \"wall|2", "\"wall0\": \"wall|9"), "doors[0] (door|2|3): its wall0 is no wall"),
        ("far.json", house.replace("\"x\": 7.0, \"y\": 0.43", "\"x\": 1e30, \"y\": 0.43"), "objects[4] (Sofa|3|0): its position"),
        ("rooms.json", "{\"rooms\": [], \"floorPolygon\": 1}".to_owned(), "rooms: none"),
        ("room.json", "{\"rooms\": [{\"id\": \"a\", \"floorPolygon\": [{\"x\": 1}]}]}".to_owned(), "rooms[0] (a).floorPolygon: has 1 corners"),
        ("torn.urdf", urdf[..urdf.len() / 2].to_owned(), "torn.urdf:"),
        ("limit.urdf", urdf.replace("upper=\"0.28\"", "upper=\"NaN\""), "limit.urdf:34: <limit>: upper=\"NaN\" is not 1 finite"),
        ("size.urdf", urdf.replace("size=\"0.42 0.92 0.02\"", "size=\"0.42 0.92 -1\""), "size.urdf:7: <box>: every side"),
        ("link.urdf", urdf.replace("<child link=\"drawer\"/>", "<child link=\"shelf\"/>"), "its child \"shelf\" is no link"),
        ("cycle.urdf", urdf.replace("<child link=\"drawer\"/>", "<child link=\"carcass\"/>"), "its joints form a circle"),
        ("escape.urdf", urdf.replace("<box size=\"0.42 0.92 0.02\"/>", "<mesh filename=\"../../etc/body.obj\"/>"), "which is not in its folder"),
        ("other.xml", "<html/>".to_owned(), "no format that is read"),
        ("size.xml", body("<geom type=\"box\" size=\"0.1 inf 1\"/>"), "size.xml:2: <geom>: size=\"0.1 inf 1\" is no list of finite"),
        ("sizes.xml", body("<geom type=\"box\" size=\"0.1\"/>"), "a box needs sizes above 0"),
        ("two.xml", body("<geom type=\"box\" size=\"0.1 0.2\"/>"), "a box needs sizes above 0"),
        ("turn.xml", body("<geom quat=\"0 0 0 0\" size=\"1\"/>"), "quat has no direction: it is zero"),
        ("class.xml", body("<geom class=\"nope\" size=\"1\"/>"), "no class \"nope\" among the defaults"),
        ("limits.xml", body("<joint range=\"0 90\"/><geom size=\"1\"/>").replace("<mujoco>", "<mujoco><compiler autolimits=\"false\"/>"), "has a range, but does not say `limited`"),
        ("mesh.xml", body("<geom type=\"mesh\" mesh=\"a\"/>"), "no mesh \"a\" among the assets"),
        ("self.xml", "<mujoco>\n<include file=\"self.xml\"/></mujoco>".to_owned(), "self.xml:2: <include>: self.xml includes itself"),
        ("escape.xml", "<mujoco><include file=\"/etc/passwd\"/></mujoco>".to_owned(), "which is not in its folder"),
        ("gone.xml", "<mujoco><include file=\"gone2.xml\"/></mujoco>".to_owned(), "gone2.xml cannot be read"),
        ("deep.xml", format!("<mujoco><worldbody>{deep}</worldbody></mujoco>"), "deep.xml:1: nested deeper than 100"),
        ("entity.xml", "<!DOCTYPE a [<!ENTITY b \"c\">]><mujoco>&b;</mujoco>".to_owned(), "entity.xml:1: "),
        ("nothing.xml", "<mujoco><worldbody/></mujoco>".to_owned(), "no furniture to put objects on"),
        ("robot.xml", "<mujoco><worldbody><body name=\"lamp\"><geom size=\"1\"/></body><body name=\"cup\"><geom size=\"1\"/></body></worldbody></mujoco>".to_owned(), "not furniture to put objects on: lamp"),
        ("torn.usda", stage[..stage.len() / 2].to_owned(), "torn.usda: "),
        ("deep.usda", format!("#usda 1.0\n{}", "def \"a\" {\n".repeat(5000)), "brackets nest deeper"),
        ("size.usda", stage.replace("double radius = 0.05", "double radius = -1"), "/World/living_room_0/coffee_table_01/leg: radius must be above 0"),
        ("units.usda", stage.replace("metersPerUnit = 1", "metersPerUnit = 0"), "metersPerUnit: must be above 0"),
        ("text.usdc", "no crate".to_owned(), "text.usdc: "),
    ];
    for (name, text, wanted) in cases {
        let found = error(name, &text);
        assert!(found.contains(wanted), "{name}: {found}");
    }
}

#[test]
fn sizes_of_assets_are_checked() {
    for text in [
        "[1]",
        "{\"a\": [1, 2]}",
        "{\"a\": [1, 2, -3]}",
        "{\"Sofa\": [{\"boundingBox\": {}}]}",
        "{",
    ] {
        let options = ImportOptions {
            asset_sizes: Some((text.to_owned(), "sizes.json".to_owned())),
            ..ImportOptions::default()
        };
        let error =
            import(&data("procthor_house.json"), &options).expect_err("the sizes are wrong");
        assert!(error.to_string().starts_with("sizes.json"), "{error}");
    }
}

/// Imports bytes as a format; whatever comes is fine but a panic.
fn survives(folder: &Path, name: &str, bytes: &[u8], format: SceneFormat) {
    let file = folder.join(name);
    fs::write(&file, bytes).expect("writes");
    let options = ImportOptions {
        format: Some(format),
        ..ImportOptions::default()
    };
    drop(import(&file, &options));
}

const SAMPLES: [(&str, SceneFormat); 4] = [
    ("procthor_house.json", SceneFormat::Procthor),
    ("living_room.usda", SceneFormat::Usd),
    ("dresser_whole.xml", SceneFormat::Mjcf),
    ("cabinet.urdf", SceneFormat::Urdf),
];

/// A sample file; the dresser with what it includes in place, so that all of it is changed.
fn sample(name: &str) -> Vec<u8> {
    if name != "dresser_whole.xml" {
        return fs::read(data(name)).expect("reads");
    }
    let read = |name: &str| fs::read_to_string(data(name)).expect("reads");
    let drawers = read("dresser_drawers.xml").replace("mujocoinclude>", "frame>");
    let inner = drawers
        .replace("<worldbody>", "")
        .replace("</worldbody>", "");
    read("dresser.xml")
        .replace("<include file=\"dresser_drawers.xml\"/>", "")
        .replace("<worldbody>", &format!("<worldbody>{inner}"))
        .into_bytes()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn changed_files_never_panic(
        which in 0..SAMPLES.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4_u8, 0..40_usize), 1..6),
    ) {
        let (name, format) = SAMPLES[which];
        let mut bytes = sample(name);
        for (at, byte, kind, length) in changes {
            let at = at.index(bytes.len());
            let end = (at + length).min(bytes.len());
            match kind {
                0 => bytes[at] = byte,
                1 => drop(bytes.drain(at..end)),
                2 => {
                    let copy = bytes[at..end].to_vec();
                    drop(bytes.splice(at..at, copy));
                }
                // Another digit changes sizes and places.
                _ => bytes[at..end].iter_mut().filter(|old| old.is_ascii_digit()).for_each(|old| *old = b'0' + byte % 10),
            }
        }
        let folder = tempfile::tempdir().expect("a folder");
        survives(folder.path(), name, &bytes, format);
    }
}
