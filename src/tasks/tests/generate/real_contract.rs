//! Texts, files and places of REAL's task generator: ours against `datagen.json`.

use std::collections::BTreeMap;

use reel_tasks::generate::task::grid::{GridPlacement, OccupancyMap};
use reel_tasks::{
    real_proc::{ProcEpisode, ProcKind, ProcObject, Source, group},
    wording,
};
use reel_vectors::{Report, items, load, text};
use reel_world::{PlanStep, ask_context_of_episode};
use serde_json::{Value, json};

const FILE: &str = "datagen.json";

fn step(value: &Value) -> PlanStep {
    serde_json::from_value(value.clone()).unwrap()
}

#[test]
fn plan_texts() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "plan");
    for case in items(&document["plan"]) {
        let (step, expected) = (step(&case["step"]), &case["text"]);
        report.compare(text(expected), expected, &json!(step.to_text("u1")));
        assert_eq!(
            PlanStep::from_text(text(expected)),
            Some(step),
            "{expected}"
        );
    }
    report.finish();
}

#[test]
fn the_context_of_the_simulated_user() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "user_context");
    for (index, case) in items(&document["user_context"]).iter().enumerate() {
        let context = ask_context_of_episode(
            case["episode"].as_object().unwrap(),
            case["fallback"].as_str(),
        );
        let told = context.map_or(json!({}), |context| {
            let mut told = json!(context);
            told["source"] = json!("task_metadata");
            told
        });
        report.compare_ordered(&index.to_string(), &case["context"], &told);
    }
    report.finish();
}

#[test]
fn wordings() {
    let Some(document) = load(FILE) else { return };
    let texts = &document["text"];
    let mut report = Report::new(FILE, "text");
    for case in items(&texts["description"]) {
        report.compare(
            "description",
            &case["text"],
            &json!(wording::definite(text(&case["caption"]))),
        );
    }
    for case in items(&texts["article"]) {
        report.compare(
            "article",
            &case["article"],
            &json!(wording::article(text(&case["word"]))),
        );
    }
    for case in items(&texts["category"]) {
        let named = wording::naming_category(text(&case["caption"]), text(&case["category"]));
        report.compare("category", &case["text"], &json!(named));
    }
    for case in items(&texts["furniture"]) {
        let (kind, index) = wording::furniture(text(&case["name"]));
        let ours = json!({ "name": case["name"], "type": kind, "index": index, "shown": wording::furniture_name(kind) });
        report.compare("furniture", case, &ours);
    }
    for case in items(&texts["strip"]) {
        report.compare(
            "strip",
            &case["stripped"],
            &json!(reel_tasks::real_proc::strip_underscore(text(&case["id"]))),
        );
    }
    report.finish();
}

/// Of equal cells the published choice is arbitrary, so a published place is right if it is among
/// our best, given the published places before it.
#[test]
fn places_on_the_grid() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "placement");
    for (index, case) in items(&document["placement"]).iter().enumerate() {
        let numbers = |value: &Value| {
            items(value)
                .iter()
                .map(|number| number.as_f64().unwrap())
                .collect::<Vec<f64>>()
        };
        let (min, max) = (
            numbers(&case["surface"]["min"]),
            numbers(&case["surface"]["max"]),
        );
        let map = case["occupancy"].as_object().map(|map| {
            let number = |key: &str| map[key].as_f64().unwrap();
            let (rows, columns) = (number("rows") as usize, number("columns") as usize);
            assert_eq!(map["free"], "columns 18..29 are 2, the others 0");
            let cells = (0..rows * columns).map(|index| {
                if (18..30).contains(&(index % columns)) {
                    2
                } else {
                    0
                }
            });
            OccupancyMap {
                origin: [number("x_origin"), number("y_origin")],
                resolution_m: number("resolution"),
                columns,
                cells: cells.collect(),
            }
        });
        let reach = |at: [f64; 2]| map.as_ref().map_or(0, |map| map.free_cells_near(at));
        let mut surface = GridPlacement::new([min[0], min[1]], [max[0], max[1]]);
        let mut ours = Some(serde_json::Map::new());
        for (name, object) in case["objects"].as_object().unwrap() {
            let [width, depth, height] =
                ["width", "depth", "height"].map(|key| object[key].as_f64().unwrap());
            let best = surface.best([width, depth], reach);
            let published = case["placements"].get(name).map(numbers);
            let is_published = |at: &&[f64; 2]| {
                published.as_ref().is_some_and(|published| {
                    (0..2).all(|axis| (at[axis] - published[axis]).abs() < 1e-6)
                })
            };
            let Some(at) = best.iter().find(is_published).or(best.first()) else {
                ours = None;
                break;
            };
            surface.put(*at, [width, depth]);
            let z = min[2].max(max[2]) + height / 2.0 + 0.02;
            ours.as_mut()
                .unwrap()
                .insert(name.clone(), json!([at[0], at[1], z]));
        }
        report.compare(&index.to_string(), &case["placements"], &json!(ours));
    }
    report.finish();
}

#[test]
fn exported_files() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "export");
    for case in items(&document["export"]) {
        let files = group(vec![episode(&case["task"])]);
        let ours: Vec<Value> = files
            .iter()
            .map(|file| json!({ "file": file.path, "document": floats(&file.document) }))
            .collect();
        let expected = json!([{ "file": case["file"], "document": floats(&case["document"]) }]);
        report.compare_ordered(text(&case["file"]), &expected, &json!(ours));
    }
    report.finish();
}

/// The generator's own form of a task as ours. Its asset library is that of the vectors.
fn episode(task: &Value) -> ProcEpisode {
    let string = |key: &str| text(&task[key]).to_owned();
    let strings = |value: &Value| {
        items(value)
            .iter()
            .map(|item| text(item).to_owned())
            .collect::<Vec<_>>()
    };
    let library = BTreeMap::from([("_u1", json!([1, 2, 3])), ("_u2", json!([4, 5, 6]))]);
    let purpose = || (string("purpose"), string("purpose_group"));
    let kind = match text(&task["task_type"]) {
        "basic" => ProcKind::Basic,
        "articulation" => ProcKind::Articulation {
            subtype: string("articulation_subtype"),
        },
        "interactive" => {
            let (purpose, purpose_group) = purpose();
            ProcKind::Interactive {
                detailed: string("detailed_task_description"),
                purpose,
                purpose_group,
            }
        }
        "gather" => {
            let (purpose, purpose_group) = purpose();
            let source = |source: &Value| Source {
                name: text(&source["name"]).to_owned(),
                room: text(&source["room"]).to_owned(),
                reference: text(&source["ref"]).to_owned(),
                object: text(&source["object_uid"]).to_owned(),
            };
            ProcKind::Gather {
                mode: string("mode"),
                fuzzy: string("fuzzy_task_description"),
                purpose,
                purpose_group,
                sources: items(&task["sources"]).iter().map(source).collect(),
                dest_room: string("dest_room"),
                dest_caption: string("dest_caption"),
                src_distractors: task["src_furniture_distractors"]
                    .as_object()
                    .unwrap()
                    .clone(),
            }
        }
        other => panic!("no vector has the type {other}"),
    };
    // Objects that no metadata describes are not exported; Reel has none.
    let meta = |asset: &str| {
        [&task["obj_meta"], &task["obj_distractor_meta"]]
            .into_iter()
            .find_map(|metas| metas.get(asset))
    };
    let numbers = |value: &Value| -> [f64; 3] { serde_json::from_value(value.clone()).unwrap() };
    let objects = task["computed_placements"]
        .as_object()
        .unwrap()
        .values()
        .filter_map(|placed| {
            let asset = text(&placed["original_id"]);
            let meta = meta(asset)?;
            Some(ProcObject {
                asset: asset.to_owned(),
                category: text(&meta["category"]).to_owned(),
                usd_path: text(&meta["usd_path"]).to_owned(),
                usd_scale: library[asset].clone(),
                position: numbers(&placed["position"]),
                size: numbers(&meta["size"]),
                furniture: text(&placed["furniture"]).to_owned(),
            })
        });
    let distractors = match &task["obj_distractors"] {
        Value::Array(assets) => assets
            .iter()
            .map(|asset| {
                let category = text(&task["obj_distractor_meta"][text(asset)]["category"]);
                (text(asset).to_owned(), category.to_owned())
            })
            .collect(),
        _ => Vec::new(),
    };
    let gathers = matches!(kind, ProcKind::Gather { .. });
    ProcEpisode {
        scene_id: string("scene_id"),
        instruction: string("task_description"),
        src: string("src"),
        src_distractors: strings(&task["src_distractors"]),
        dest: string("dest"),
        dest_distractors: strings(
            &task[if gathers {
                "dest_furniture_distractors"
            } else {
                "dest_distractors"
            }],
        ),
        targets: task["obj_meta"]
            .as_object()
            .unwrap()
            .keys()
            .cloned()
            .collect(),
        distractors,
        plan: items(&task["execution_plan"])
            .iter()
            .map(|value| (step(value), "_u1".to_owned()))
            .collect(),
        objects: objects.collect(),
        kind,
    }
}

/// The vectors hold some lengths as integers, which the generator never has.
fn floats(value: &Value) -> Value {
    match value {
        Value::Number(number) => json!(number.as_f64()),
        Value::Array(items) => items.iter().map(floats).collect(),
        Value::Object(entries) => Value::Object(
            entries
                .iter()
                .map(|(key, value)| (key.clone(), floats(value)))
                .collect(),
        ),
        other => other.clone(),
    }
}
