//! Furniture without a house: drawers and doors of MJCF and URDF, meshes by their bounds.

use std::fs;

use reel_scene_import::{ImportOptions, Imported, import};
use reel_world::{Door, FurnitureJoint, Receptacle};

use crate::imported;

fn receptacle<'a>(of: &'a Imported, id: &str) -> &'a Receptacle {
    let found = of.scene.receptacle(&id.into());
    found.unwrap_or_else(|| panic!("no {id}: {:?}", of.report.receptacles))
}

fn import_text(name: &str, text: &str) -> Imported {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join(name);
    fs::write(&file, text).expect("writes");
    import(&file, &ImportOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn a_dresser_of_mjcf_has_two_drawers() {
    let scene = imported("dresser.xml");
    assert_eq!(scene.report.reached(), 4, "{:?}", scene.report.findings);
    assert_eq!(scene.report.findings, [""; 0]);
    let dresser = receptacle(&scene, "chestofdrawers_1");
    assert_eq!(
        (dresser.surface_min, dresser.surface_max),
        ([-0.25, -0.45, 0.77], [0.25, 0.45, 0.8])
    );
    assert_eq!(dresser.facing_deg, Some(0.0));
    for (id, floor) in [("drawer_1", 0.478), ("drawer_2", 0.078)] {
        let drawer = receptacle(&scene, id);
        assert_eq!(
            (drawer.door, &drawer.part_of),
            (Door::Drawer, &Some(dresser.id.clone()))
        );
        assert_eq!(drawer.surface_max[2], floor, "{id}");
        let geometry = drawer.geometry.as_ref().expect("it is given");
        assert_eq!(
            geometry.joint,
            Some(FurnitureJoint::Slide {
                open_by: [0.3, 0.0]
            })
        );
        assert_eq!(geometry.moving.len(), 5);
    }
    assert_eq!(
        receptacle(&scene, "drawer_1").main_caption(),
        Some("the top drawer of the chest of drawers")
    );
    // Two metres around all of it.
    let room = &scene.scene.rooms[0];
    assert_eq!(
        (room.name.as_str(), room.min, room.max),
        ("bedroom/0", [-2.25, -2.45], [2.48, 4.48])
    );
}

#[test]
fn a_cabinet_of_urdf_has_a_drawer_and_a_door() {
    let scene = imported("cabinet.urdf");
    assert_eq!(scene.report.reached(), 3, "{:?}", scene.report.findings);
    let behind = receptacle(&scene, "compartment_1");
    // The hinge is at the left of who stands before it.
    assert_eq!((behind.door, behind.facing_deg), (Door::Left, Some(0.0)));
    assert_eq!(behind.surface_max[2], 0.02);
    let joint = behind.geometry.as_ref().and_then(|geometry| geometry.joint);
    let Some(FurnitureJoint::Hinge {
        position,
        axis,
        open_deg,
    }) = joint
    else {
        panic!("{joint:?}");
    };
    assert_eq!((position, axis), ([0.2, -0.43, 0.3], [0.0, 0.0, 1.0]));
    assert!((open_deg + 91.67).abs() < 0.01, "{open_deg}");
    assert_eq!(receptacle(&scene, "drawer_1").surface_max[2], 0.6475);
}

/// Corners of a box as an OBJ file, in millimetres.
fn obj(low: [f64; 3], high: [f64; 3]) -> String {
    let corner = |bits: usize, axis: usize| {
        if bits >> axis & 1 == 0 {
            low[axis]
        } else {
            high[axis]
        }
    };
    (0..8)
        .map(|bits| {
            format!(
                "v {} {} {}\n",
                corner(bits, 0),
                corner(bits, 1),
                corner(bits, 2)
            )
        })
        .collect()
}

#[test]
fn meshes_stand_for_their_bounds_and_are_hollow_where_something_opens() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("meshes")).expect("a folder");
    let write =
        |name: &str, text: String| fs::write(folder.path().join(name), text).expect("writes");
    write(
        "meshes/body.obj",
        obj([-250.0, -400.0, 0.0], [250.0, 400.0, 700.0]),
    );
    write(
        "meshes/drawer.obj",
        obj([-230.0, -380.0, 0.0], [240.0, 380.0, 200.0]),
    );
    write(
        "nightstand.urdf",
        r#"<robot name="unit_12">
  <link name="base"><visual><geometry><mesh filename="package://unit/meshes/body.obj" scale="0.001 0.001 0.001"/></geometry></visual></link>
  <link name="slider"><visual><geometry><mesh filename="meshes/drawer.obj" scale="0.001 0.001 0.001"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><origin xyz="0 0 0.4"/><parent link="base"/><child link="slider"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3"/></joint>
</robot>"#
            .to_owned(),
    );
    let scene = import(
        &folder.path().join("nightstand.urdf"),
        &ImportOptions::default(),
    )
    .expect("it is sound");
    assert_eq!(
        receptacle(&scene, "nightstand_1")
            .geometry
            .as_ref()
            .map(|own| own.fixed.len()),
        Some(5)
    );
    let drawer = receptacle(&scene, "drawer_1");
    assert_eq!(
        drawer.geometry.as_ref().map(|own| own.moving.len()),
        Some(5)
    );
    assert_eq!(drawer.surface_max[2], 0.415);
    let approximated = &scene.report.approximated;
    assert_eq!(
        approximated["carcass given as a mesh: five boards, open at the front"].count,
        1
    );
    assert_eq!(
        approximated["drawer given as a mesh or one block: a box of boards"].count,
        1
    );
    assert_eq!(scene.report.reached(), 2, "{:?}", scene.report.findings);
}

#[test]
fn classes_angles_and_frames_of_mjcf_place_geoms() {
    let table = |compiler: &str, turn: &str| {
        import_text(
            "table.xml",
            &format!(
                r#"<mujoco><compiler {compiler}/><default><default class="wood"><geom type="box" size="0.5 0.3 0.02"/></default></default>
<worldbody><body name="table" pos="1 2 0.5"><frame pos="0 0 0.2"><geom class="wood" {turn}/></frame></body></worldbody></mujoco>"#
            ),
        )
    };
    let wide = |scene: &Imported| {
        let piece = &scene.scene.receptacles[0];
        [0, 1].map(|axis| ((piece.surface_max[axis] - piece.surface_min[axis]) * 1000.0).round())
    };
    assert_eq!(wide(&table("", "")), [1000.0, 600.0]);
    assert_eq!(
        wide(&table(r#"angle="degree""#, r#"euler="0 0 90""#)),
        [600.0, 1000.0]
    );
    assert_eq!(
        wide(&table(r#"angle="radian""#, r#"euler="0 0 1.5707963""#)),
        [600.0, 1000.0]
    );
    assert_eq!(wide(&table("", r#"quat="1 0 0 1""#)), [600.0, 1000.0]);
    assert_eq!(
        wide(&table("", r#"xyaxes="0 1 0 -1 0 0""#)),
        [600.0, 1000.0]
    );
    assert_eq!(
        wide(&table("", r#"axisangle="0 0 1 -90""#)),
        [600.0, 1000.0]
    );
    let extrinsic = table(r#"eulerseq="ZYX""#, r#"euler="90 0 0""#);
    assert_eq!(wide(&extrinsic), [600.0, 1000.0]);
}

#[test]
fn joints_that_cannot_be_used_stay_closed_and_are_counted() {
    let scene = import_text(
        "oven.xml",
        r#"<mujoco><worldbody><body name="cabinet">
  <geom type="box" size="0.3 0.3 0.4" pos="0 0 0.4"/>
  <body name="flap" pos="0.31 0 0.1"><joint name="flap" type="hinge" axis="0 1 0" range="0 90"/>
    <geom type="box" size="0.01 0.3 0.3" pos="0 0 0.3"/></body>
</body></worldbody></mujoco>"#,
    );
    let kinds: Vec<&String> = scene.report.left_out.keys().collect();
    assert_eq!(
        kinds,
        ["joint: a hinge that is not upright or opens under 10 degrees, kept closed"]
    );
    let note = scene.report.left_out.values().next().expect("one kind");
    assert_eq!(
        (note.count, note.of.as_slice()),
        (1, &["cabinet".to_owned()][..])
    );
    assert_eq!(scene.report.receptacles.len(), 1);
}

/// A URDF of one link with what is seen of it and what collides.
fn link(seen: &str, collides: &str) -> String {
    format!(
        r#"<robot name="dresser"><link name="dresser"><visual>{seen}</visual>
        <collision>{collides}</collision></link></robot>"#
    )
}

#[test]
fn what_collides_stands_for_a_mesh_only_where_it_fills_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let corner = |half: f64, z: f64| format!("v {half} {half} {z}\nv -{half} -{half} {z}\n");
    let mesh = format!("{}{}", corner(0.4, 0.0), corner(0.4, 0.8));
    fs::write(folder.path().join("seen.obj"), mesh).expect("writes");
    let seen = r#"<geometry><mesh filename="package://other/seen.obj"/></geometry>"#;
    let solids = |half: &str| {
        let box_shape = format!(
            r#"<origin xyz="0 0 0.4"/><geometry><box size="{half} {half} 0.8"/></geometry>"#
        );
        let file = folder.path().join("dresser.urdf");
        fs::write(&file, link(seen, &box_shape)).expect("writes");
        let scene = import(&file, &ImportOptions::default()).expect("imports");
        let top = receptacle(&scene, "chestofdrawers_1");
        let width = top.surface_max[0] - top.surface_min[0];
        ((width * 100.0).round(), scene.report.approximated)
    };
    let (width, post) = solids("0.1");
    assert_eq!(width, 80.0, "a post does not stand for the furniture");
    assert_eq!(post["mesh: the box of its bounds"].of, ["dresser"]);
    assert!(post.contains_key("mesh of the package other: looked for beside the file"));
    let (width, exact) = solids("0.7");
    assert_eq!(width, 70.0);
    assert!(exact.contains_key("link that is seen as a mesh: what collides of it stands for it"));
}

#[test]
fn a_mesh_of_a_package_is_taken_from_its_own_folder_first() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("pkg")).expect("a folder");
    let mesh = |half: f64| format!("v {half} {half} 0.8\nv -{half} -{half} 0\n");
    fs::write(folder.path().join("seen.obj"), mesh(0.3)).expect("writes");
    fs::write(folder.path().join("pkg/seen.obj"), mesh(0.5)).expect("writes");
    let file = folder.path().join("dresser.urdf");
    let seen = r#"<geometry><mesh filename="package://pkg/seen.obj"/></geometry>"#;
    let text = format!(
        r#"<robot name="dresser"><link name="dresser"><visual>{seen}</visual></link></robot>"#
    );
    fs::write(&file, text).expect("writes");
    let scene = import(&file, &ImportOptions::default()).expect("imports");
    let top = receptacle(&scene, "chestofdrawers_1");
    assert_eq!((top.surface_max[0] - top.surface_min[0]).round(), 1.0);
}

#[test]
fn a_joint_that_follows_another_is_said() {
    let scene = import_text(
        "cabinet.urdf",
        r#"<robot name="cabinet"><link name="cabinet">
  <visual><origin xyz="0 0 0.4"/><geometry><box size="0.5 0.8 0.8"/></geometry></visual></link>
 <link name="drawer"><visual><geometry><box size="0.02 0.7 0.2"/></geometry></visual></link>
 <joint name="slide" type="prismatic"><parent link="cabinet"/><child link="drawer"/>
  <origin xyz="0.26 0 0.5"/><axis xyz="1 0 0"/><limit lower="0" upper="0.3"/>
  <mimic joint="other"/></joint></robot>"#,
    );
    let note =
        &scene.report.approximated["joint that follows another one (<mimic>): moves on its own"];
    assert_eq!(note.of, ["slide"]);
}

#[test]
fn furniture_of_two_rooms_of_a_kind_has_captions_of_its_own() {
    let bedroom = |x: f64| {
        format!(
            r#"{{"roomType": "Bedroom", "floorPolygon": [{{"x": {x}, "y": 0, "z": 0}},
            {{"x": {x}, "y": 0, "z": 6}}, {{"x": {0}, "y": 0, "z": 6}}, {{"x": {0}, "y": 0, "z": 0}}]}}"#,
            x + 6.0
        )
    };
    let stands = (0..24).map(|index| {
        let (x, z) = (
            f64::from(index / 12) * 6.0 + 1.0 + f64::from(index % 4) * 1.3,
            1.0 + f64::from(index % 12 / 4) * 1.8,
        );
        format!(
            r#"{{"id": "SideTable|{index}", "assetId": "Side_Table_1", "position":
            {{"x": {x}, "y": 0.3, "z": {z}}}, "rotation": {{"x": 0, "y": 0, "z": 0}}}}"#
        )
    });
    let text = format!(
        r#"{{"rooms": [{}, {}], "objects": [{}], "walls": [], "doors": []}}"#,
        bedroom(0.0),
        bedroom(6.0),
        stands.collect::<Vec<_>>().join(", ")
    );
    let scene = import_text("house.json", &text);
    let captions: Vec<&str> = scene
        .report
        .receptacles
        .iter()
        .map(|receptacle| receptacle.caption.as_str())
        .collect();
    let distinct: std::collections::BTreeSet<&str> = captions.iter().copied().collect();
    assert_eq!(captions.len(), 24);
    assert_eq!(distinct.len(), 24, "{captions:?}");
    assert!(
        captions
            .iter()
            .any(|caption| caption.ends_with("in the second bedroom")),
        "{captions:?}"
    );
}

/// A dresser of USD with two drawers, whose joints have one name; `swapped`: the drawer is the
/// first body of a joint.
fn dresser_usd(swapped: bool) -> String {
    let block = |name: &str, half: [f64; 3], at: [f64; 3]| {
        format!(
            "def Cube \"{name}\" {{ double size = 2\nfloat3 xformOp:scale = ({}, {}, {})\n\
             double3 xformOp:translate = ({}, {}, {})\n\
             uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:scale\"] }}\n",
            half[0], half[1], half[2], at[0], at[1], at[2]
        )
    };
    let carcass = [
        block("top", [0.25, 0.5, 0.01], [0.0, 0.0, 0.99]),
        block("bottom", [0.25, 0.5, 0.01], [0.0, 0.0, 0.01]),
        block("left", [0.25, 0.01, 0.49], [0.0, 0.49, 0.49]),
        block("right", [0.25, 0.01, 0.49], [0.0, -0.49, 0.49]),
        block("back", [0.01, 0.5, 0.49], [-0.24, 0.0, 0.49]),
    ]
    .concat();
    let drawer = |number: usize, z: f64| {
        let solids = [
            block("front", [0.01, 0.45, 0.1], [0.24, 0.0, 0.1]),
            block("floor", [0.22, 0.45, 0.01], [0.0, 0.0, 0.01]),
        ]
        .concat();
        let bodies = [
            "/World/dresser/body".to_owned(),
            format!("/World/dresser/drawer{number}"),
        ];
        let [first, second] = if swapped { [1, 0] } else { [0, 1] }.map(|it| &bodies[it]);
        let limits = if swapped { (-0.3, 0.0) } else { (0.0, 0.3) };
        format!(
            "def Xform \"drawer{number}\" {{\ndouble3 xformOp:translate = (0, 0, {z})\n\
             uniform token[] xformOpOrder = [\"xformOp:translate\"]\n{solids}\n\
             def PhysicsPrismaticJoint \"joint\" {{\nuniform token physics:axis = \"X\"\n\
             rel physics:body0 = <{first}>\nrel physics:body1 = <{second}>\n\
             float physics:lowerLimit = {}\nfloat physics:upperLimit = {} }} }}\n",
            limits.0, limits.1
        )
    };
    format!(
        "#usda 1.0\n(metersPerUnit = 1\nupAxis = \"Z\")\ndef Xform \"World\" {{ def Xform \"dresser\" {{\n\
         def Xform \"body\" {{\n{carcass}}}\n{}{}}} }}\n",
        drawer(0, 0.06),
        drawer(1, 0.5)
    )
}

#[test]
fn drawers_of_usd_are_told_apart_and_the_carcass_stands_still() {
    for swapped in [false, true] {
        let scene = import_text("dresser.usda", &dresser_usd(swapped));
        let drawers: Vec<&Receptacle> = scene
            .scene
            .receptacles
            .iter()
            .filter(|receptacle| receptacle.door == Door::Drawer)
            .collect();
        assert_eq!(drawers.len(), 2, "{swapped}: {:?}", scene.report);
        for drawer in drawers {
            let geometry = drawer.geometry.as_ref().expect("it is given");
            let open_by = [0.3, 0.0];
            assert_eq!(
                geometry.joint,
                Some(FurnitureJoint::Slide { open_by }),
                "{swapped}"
            );
            assert_eq!(geometry.moving.len(), 2, "{swapped}");
        }
        // The board below the drawers is behind their fronts.
        assert_eq!(scene.scene.receptacles.len(), 3, "{:?}", scene.report);
    }
}

#[test]
fn a_root_without_a_shape_leaves_the_category_to_its_only_child() {
    let scene = import_text(
        "room.urdf",
        r#"<robot name="x"><link name="world"/><link name="desk"><visual>
  <origin xyz="0 0 0.35"/><geometry><box size="0.8 1.2 0.7"/></geometry></visual></link>
 <joint name="base" type="fixed"><parent link="world"/><child link="desk"/></joint></robot>"#,
    );
    assert_eq!(receptacle(&scene, "desk_1").category, "desk");
}

#[test]
fn a_joint_of_a_whole_piece_is_said() {
    let body = |joint: &str| {
        let scene = import_text(
            "desk.xml",
            &format!(
                r#"<mujoco><worldbody><body name="desk">{joint}
  <geom type="box" size="0.4 0.6 0.35" pos="0 0 0.35"/></body></worldbody></mujoco>"#
            ),
        );
        scene.report.left_out["joint: of the whole piece, which stays where it stands"].clone()
    };
    for joint in [
        "<joint type=\"slide\" axis=\"1 0 0\" range=\"0 1\"/>",
        "<freejoint/>",
    ] {
        assert_eq!(body(joint).of, ["desk"], "{joint}");
    }
}

#[test]
fn collision_shapes_that_are_not_used_need_not_be_there() {
    let scene = import_text(
        "dresser.urdf",
        &link(
            r#"<origin xyz="0 0 0.4"/><geometry><box size="0.6 0.8 0.8"/></geometry>"#,
            r#"<geometry><mesh filename="meshes/absent.stl"/></geometry>"#,
        ),
    );
    assert_eq!(
        scene.report.left_out.len(),
        0,
        "{:?}",
        scene.report.left_out
    );
}
