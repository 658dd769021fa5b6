//! Houses: rooms, walls and furniture of ProcTHOR JSON and of USD stages.

use std::fs;

use reel_scene_import::{ImportOptions, Imported, import};
use reel_world::{Door, FurnitureJoint, Receptacle};

use crate::{data, imported};

fn receptacle<'a>(of: &'a Imported, id: &str) -> &'a Receptacle {
    let found = of.scene.receptacle(&id.into());
    found.unwrap_or_else(|| panic!("no {id}: {:?}", of.report.receptacles))
}

/// Lower and upper corner of the surface.
fn surface(of: &Imported, id: &str) -> [[f64; 3]; 2] {
    let piece = receptacle(of, id);
    [piece.surface_min, piece.surface_max]
}

fn sources(of: &Imported) -> Vec<(&str, &str)> {
    let receptacles = of.report.receptacles.iter();
    receptacles
        .map(|own| (own.id.as_str(), own.source.as_str()))
        .collect()
}

#[test]
fn a_procthor_house_keeps_rooms_furniture_and_start() {
    let house = imported("procthor_house.json");
    let rooms: Vec<(&str, usize)> = house
        .scene
        .rooms
        .iter()
        .map(|room| (room.name.as_str(), room.footprint().len()))
        .collect();
    assert_eq!(
        rooms,
        [("kitchen/0", 1), ("living room/0", 2), ("bedroom/0", 1)]
    );
    assert_eq!(
        sources(&house),
        [
            ("refrigerator_1", "Fridge|2|0"),
            ("counter_1", "CounterTop|2|1"),
            ("table_1", "DiningTable|2|2"),
            ("couch_1", "Sofa|3|0"),
            ("table_2", "CoffeeTable|3|1"),
            ("tvstand_1", "TVStand|3|2"),
            ("shelf_1", "ShelvingUnit|3|3"),
            ("bed_1", "Bed|4|0"),
            ("chestofdrawers_1", "Dresser|4|1"),
            ("table_3", "SideTable|4|2"),
            ("desk_1", "Desk|4|3"),
        ]
    );
    assert_eq!(house.report.reached(), 11, "{:?}", house.report.findings);
    assert_eq!(house.report.findings, [""; 0]);
    assert_eq!(receptacle(&house, "refrigerator_1").door, Door::Left);
    // A turn of 90 degrees to the right from z is a look along x.
    assert_eq!(receptacle(&house, "bed_1").facing_deg, Some(0.0));
    assert_eq!(receptacle(&house, "couch_1").facing_deg, Some(90.0));
    // The agent's start: x and z of Unity, looking along x.
    assert_eq!(house.scene.robot_start, Some([5.0, 3.0, 0.0]));
    let captions: Vec<&str> = house
        .scene
        .receptacles
        .iter()
        .filter_map(Receptacle::main_caption)
        .collect();
    let mut different = captions.clone();
    different.sort_unstable();
    different.dedup();
    assert_eq!(different.len(), captions.len(), "{captions:?}");
    let left_out = &house.report.left_out;
    let mugs = &left_out["object on furniture (scenes hold none): mug"];
    assert_eq!(mugs.count, 2);
    assert_eq!(
        mugs.of,
        ["CounterTop|2|1"],
        "the furniture that they stand on"
    );
    assert_eq!(
        left_out["not furniture to put objects on: floor lamp"].count,
        1
    );
}

/// Whether a wall stands on a point.
fn walled(of: &Imported, [x, y]: [f64; 2]) -> bool {
    let walls = of.scene.walls.as_deref().unwrap_or_default();
    walls.iter().any(|wall| {
        let within = |axis: usize, value: f64| {
            let (low, high) = (
                wall.from[axis].min(wall.to[axis]),
                wall.from[axis].max(wall.to[axis]),
            );
            (low - 1e-6..=high + 1e-6).contains(&value)
        };
        within(0, x) && within(1, y)
    })
}

#[test]
fn walls_are_open_where_doors_inside_are() {
    let house = imported("procthor_house.json");
    // Between kitchen and living room, and between bedroom and living room.
    assert!(walled(&house, [4.0, 1.4]) && walled(&house, [4.0, 2.8]));
    assert!(!walled(&house, [4.0, 2.1]));
    assert!(walled(&house, [4.9, 5.0]) && walled(&house, [6.3, 5.0]));
    assert!(!walled(&house, [5.6, 5.0]));
    // The front door stays closed.
    assert!((0..=90).all(|tenth| walled(&house, [10.0, f64::from(tenth) / 10.0])));
    let walls = house.scene.walls.expect("it has walls");
    assert!(walls.iter().all(|wall| wall.height == 2.8), "{walls:?}");
    assert_eq!(walls.len(), 9, "each wall once: {walls:?}");
}

#[test]
fn sizes_of_assets_come_from_a_file_of_either_form() {
    let plain = r#"{"Dining_Table_16_1": [1.8, 0.76, 0.9]}"#;
    let database = r#"{"DiningTable": [{"assetId": "Dining_Table_16_1", "objectType": "DiningTable",
        "boundingBox": {"x": 1.8, "y": 0.76, "z": 0.9}}]}"#;
    let of = |text: &str| {
        let options = ImportOptions {
            asset_sizes: Some((text.to_owned(), "sizes.json".to_owned())),
            ..ImportOptions::default()
        };
        import(&data("procthor_house.json"), &options).expect("the house is sound")
    };
    let (plain, database) = (of(plain), of(database));
    assert_eq!(plain.scene, database.scene);
    let [low, high] = surface(&plain, "table_1");
    let size = [0, 1].map(|axis| ((high[axis] - low[axis]) * 100.0).round());
    assert_eq!((size, high[2]), ([178.0, 88.0], 0.76));
    assert_eq!(
        surface(&imported("procthor_house.json"), "table_1")[1][2],
        0.76,
        "twice its middle"
    );
}

#[test]
fn a_stage_keeps_its_room_its_furniture_and_the_drawer() {
    let stage = imported("living_room.usda");
    assert_eq!(
        sources(&stage),
        [
            ("table_1", "/World/living_room_0/coffee_table_01"),
            ("cabinet_1", "/World/living_room_0/storage_7"),
            ("drawer_1", "/World/living_room_0/storage_7/drawer_slide"),
        ]
    );
    assert_eq!(stage.report.reached(), 3, "{:?}", stage.report.findings);
    let room = &stage.scene.rooms[0];
    assert_eq!(
        (room.name.as_str(), room.min, room.max),
        ("living room/0", [0.0, 0.0], [5.0, 4.0])
    );
    // Turned by 90 degrees: 1.1 m along x, 0.6 m along y.
    assert_eq!(
        surface(&stage, "table_1"),
        [[2.05, 0.9, 0.42], [3.15, 1.5, 0.45]]
    );
    let drawer = receptacle(&stage, "drawer_1");
    assert_eq!((drawer.door, drawer.facing_deg), (Door::Drawer, Some(0.0)));
    assert_eq!(drawer.part_of, Some("cabinet_1".into()));
    assert_eq!(drawer.surface_max[2], 0.4375);
    let geometry = drawer.geometry.as_ref().expect("it is given");
    assert_eq!(
        geometry.joint,
        Some(FurnitureJoint::Slide {
            open_by: [0.32, 0.0]
        })
    );
    assert_eq!((geometry.fixed.len(), geometry.moving.len()), (0, 5));
    assert_eq!(
        receptacle(&stage, "cabinet_1").attributes["colour"],
        ["white"]
    );
    assert_eq!(
        stage.report.left_out["not furniture to put objects on: statue"].count,
        1
    );
}

#[test]
fn text_binary_and_archive_give_one_scene() {
    let of = |name: &str| {
        let options = ImportOptions {
            scene_id: Some("stage".to_owned()),
            ..ImportOptions::default()
        };
        import(&data(name), &options)
            .unwrap_or_else(|error| panic!("{name}: {error}"))
            .scene
    };
    let text = of("living_room.usda");
    assert_eq!(of("living_room_binary.usdc"), text);
    assert_eq!(of("living_room_archive.usdz"), text);
}

#[test]
fn a_stage_by_category_in_centimetres_with_y_up() {
    let stage = imported("by_category.usda");
    assert_eq!(
        sources(&stage),
        [
            ("table_1", "/Root/Meshes/Furnitures/table/model_a1_0"),
            ("table_2", "/Root/Meshes/Furnitures/table/model_a1_1"),
        ]
    );
    let room = &stage.scene.rooms[0];
    assert_eq!((room.min, room.max), ([0.0, 0.0], [5.0, 4.0]));
    assert_eq!(surface(&stage, "table_1")[1], [1.8, 1.6, 0.72]);
    assert_eq!(surface(&stage, "table_2")[1], [4.0, 3.4, 0.72]);
    assert_eq!(
        stage.report.approximated["mesh: the box of its bounds"].count,
        3
    );
}

#[test]
fn layers_outside_of_the_folder_are_not_opened() {
    let folder = tempfile::tempdir().expect("a folder");
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).expect("a folder");
    fs::copy(
        data("by_category_table.usda"),
        folder.path().join("secret.usda"),
    )
    .expect("copies");
    let stage = |reference: &str| {
        format!(
            "#usda 1.0\n(\n metersPerUnit = 0.01\n upAxis = \"Y\"\n)\n\
             def Xform \"table\" (\n prepend references = @{reference}@\n)\n{{\n}}\n"
        )
    };
    for reference in [
        "../secret.usda".to_owned(),
        folder.path().join("secret.usda").display().to_string(),
    ] {
        fs::write(inner.join("stage.usda"), stage(&reference)).expect("writes");
        let refused = import(&inner.join("stage.usda"), &ImportOptions::default());
        assert!(refused.is_err(), "{reference}: {refused:?}");
    }
    fs::copy(data("by_category_table.usda"), inner.join("own.usda")).expect("copies");
    fs::write(inner.join("stage.usda"), stage("own.usda")).expect("writes");
    import(&inner.join("stage.usda"), &ImportOptions::default())
        .expect("its own folder is open to it");
}
