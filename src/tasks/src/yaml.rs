//! Tasks written in the YAML schema of REAL-Bench, so that reading them back gives the same task.

use reel_world::{DoorState, Family, ObjectInstance, Scene, Task, WorldGraph};
use serde_json::{Map, Value, json};

use crate::{attributes, real_schema::DROP_M};

/// Writes a task as the text of a YAML file.
pub fn write(task: &Task, scene: &Scene) -> String {
    let mut root =
        json!({ "scene_id": task.scene_id, "objects": {}, "episodes": [episode(task, scene)] });
    for object in &task.objects {
        root["objects"][object.instance.as_str()] = object_entry(object);
    }
    for (path, value) in &task.extra {
        insert(&mut root, path, value.clone());
    }
    text(&root)
}

/// A mapping as the text of a YAML file, keys in their order.
pub(crate) fn text(document: &Value) -> String {
    let mut text = String::new();
    write_entries(document, 0, &mut text);
    text
}

/// A world graph as the files have it: assets, and `door: false` for a closed one.
pub fn graph(task: &Task, graph: &WorldGraph, scene: &Scene) -> Value {
    let mut states = Map::new();
    for receptacle in &scene.receptacles {
        let objects = graph.objects_on(&receptacle.id);
        let assets = objects.iter().map(|instance| {
            task.object(instance)
                .map_or(instance.asset(), |object| object.asset.clone())
        });
        let mut state = json!({ "room": receptacle.room, "content": assets.collect::<Vec<_>>() });
        if let Some(door) = graph.door(&receptacle.id) {
            state["door"] = json!(door == DoorState::Open);
        }
        states.insert(receptacle.id.to_string(), state);
    }
    Value::Object(states)
}

fn object_entry(object: &ObjectInstance) -> Value {
    let mut entry = json!({
        "original_id": object.asset,
        "category": object.category,
        "position": object.position,
        "size": object.size,
    });
    if object.yaw != 0.0 {
        entry["yaw"] = json!(object.yaw);
    }
    if let Some(caption) = &object.caption {
        entry["detailed_caption"] = json!(caption);
    }
    // What the caption says of it, its reader knows.
    if object.attributes
        != object
            .caption
            .as_deref()
            .map(attributes::from_caption)
            .unwrap_or_default()
    {
        entry["attributes"] = json!(object.attributes);
    }
    entry
}

/// Where the goal wants the objects that move, where that is more than the
/// target to the destination.
fn moves(task: &Task) -> Option<Value> {
    let place = |graph: &WorldGraph, object: &ObjectInstance| {
        graph.receptacle_of(&object.instance).cloned()
    };
    let moved = task
        .objects
        .iter()
        .filter(|object| place(&task.initial, object) != place(&task.goal, object));
    let moves: Map<String, Value> = moved
        .map(|object| {
            (
                object.instance.to_string(),
                json!(place(&task.goal, object)),
            )
        })
        .collect();
    let is_usual = moves.len() == 1
        && moves
            .get(task.target.as_str())
            .is_some_and(|to| *to == json!(task.dest));
    (!is_usual).then_some(Value::Object(moves))
}

fn episode(task: &Task, scene: &Scene) -> Value {
    let target = task.target_object();
    let mut episode = json!({
        "benchmark_task_id": task.task_id,
        "family": task.family,
        "task_id": task.task_id.rsplit('/').next(),
        "benchmark_instruction": task.instruction,
        "scene_id": task.scene_id,
        "task_type": task.task_type,
        "task_description": task.precise_instruction,
        "fuzzy_task_description": task.fuzzy.then_some(&task.instruction),
        "purpose": task.purpose,
        "initial_world_graph": graph(task, &task.initial, scene),
        "goal_world_graph": task.published_goal,
        "src": task.src,
        "src_distractors": task.src_distractors,
        "dest": task.dest,
        "dest_distractors": task.dest_distractors,
        "moves": moves(task),
        "obj_meta": { target.asset.as_str(): target.asset_meta() },
        "obj_distractors": task.object_distractors,
        "obj_distractor_meta": {},
        "execution_plan": task.plan,
        "physics_task_description": task.fuzzy.then_some(&task.precise_instruction),
        "placements": {},
        "final_positions": {},
        "target_object_id": target.asset,
    });
    for object in task
        .placement_order()
        .into_iter()
        .map(|index| &task.objects[index])
    {
        let key = object.instance.as_str();
        episode["placements"][key] = json!({ "position": object.position, "furniture": object.receptacle, "original_id": object.asset });
        if task.object_distractors.contains(&object.asset) {
            episode["obj_distractor_meta"][object.asset.as_str()] = object.asset_meta();
        }
        if let Some(rest) = object.reference_rest {
            let [x, y, z] = object.position;
            episode["final_positions"][key] = json!({
                "initial_pos": [x, y, z + DROP_M],
                "final_pos": rest,
                "category": object.category,
                "original_id": object.asset,
            });
        }
    }
    let fields = episode.as_object_mut().expect("made as an object");
    let optional = |key: &str| {
        key == "final_positions" || (key == "obj_distractor_meta" && task.family == Family::FDO)
    };
    fields.retain(|key, value| !value.is_null() && (!optional(key) || *value != json!({})));
    episode
}

/// Puts a value where its path says (see [`Task::extra`]). Keys may hold dots: the longest key
/// that is there wins.
fn insert(at: &mut Value, path: &str, value: Value) {
    match at {
        Value::Object(entries) => {
            let below = |key: &&String| {
                path.strip_prefix(key.as_str())
                    .is_some_and(|rest| rest.starts_with(['.', '[']))
            };
            match entries
                .keys()
                .filter(below)
                .max_by_key(|key| key.len())
                .cloned()
            {
                Some(key) => insert(
                    &mut entries[&key],
                    path[key.len()..].trim_start_matches('.'),
                    value,
                ),
                // A mapping that would hold nothing else is not written (see `episode`).
                None => match path.split_once('.') {
                    Some((key @ "final_positions", rest)) => {
                        entries.insert(key.to_owned(), json!({ rest: value }));
                    }
                    _ => {
                        entries.insert(path.to_owned(), value);
                    }
                },
            }
        }
        Value::Array(items) => {
            let index = path.strip_prefix('[').and_then(|rest| rest.split_once(']'));
            if let Some((index, rest)) = index
                && let Some(item) = index
                    .parse()
                    .ok()
                    .and_then(|index: usize| items.get_mut(index))
            {
                insert(item, rest.trim_start_matches('.'), value);
            }
        }
        _ => {}
    }
}

/// Writes the entries of a mapping or list, each on lines of its own.
fn write_entries(value: &Value, indent: usize, text: &mut String) {
    let pad = " ".repeat(indent);
    match value {
        Value::Object(entries) => {
            for (key, value) in entries {
                text.push_str(&format!("{pad}{}:", scalar(&json!(key))));
                write_value(value, indent, text);
            }
        }
        Value::Array(items) => {
            for item in items {
                let start = text.len();
                // An empty mapping or list has no line of its own yet.
                if matches!(item, Value::Object(entries) if entries.is_empty())
                    || matches!(item, Value::Array(items) if items.is_empty())
                {
                    text.push_str(&format!("{pad}- {item}\n"));
                    continue;
                }
                write_entries(item, indent + 2, text);
                text.replace_range(start..start + indent + 2, &format!("{pad}- "));
            }
        }
        _ => text.push_str(&format!("{pad}{}\n", scalar(value))),
    }
}

fn write_value(value: &Value, indent: usize, text: &mut String) {
    let nested = |value: &Value| matches!(value, Value::Object(_) | Value::Array(_));
    match value {
        Value::Object(entries) if entries.is_empty() => text.push_str(" {}\n"),
        Value::Array(items) if !items.iter().any(nested) => {
            let items: Vec<String> = items.iter().map(scalar).collect();
            text.push_str(&format!(" [{}]\n", items.join(", ")));
        }
        Value::Object(_) | Value::Array(_) => {
            text.push('\n');
            write_entries(value, indent + 2, text);
        }
        _ => text.push_str(&format!(" {}\n", scalar(value))),
    }
}

/// Plain where YAML cannot mistake it, else as JSON, which is YAML too.
fn scalar(value: &Value) -> String {
    let is_plain = |text: &&str| {
        let reserved = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
        text.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_')
            && text
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || "_-/ ".contains(c))
            && !text.ends_with(' ')
            && !reserved.contains(&text.to_lowercase().as_str())
    };
    value
        .as_str()
        .filter(is_plain)
        .map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_every_kind_survive() {
        let value = json!({
            "plain": "table_1", "quoted": "a: b, \"c\"", "word": "yes", "number": "12", "empty": "", "lines": "a\nb",
            "list": [1.5, "x y", -3, null, true], "nested": [[1, 2], {"a": [], "b": {}}, {}, [], [[{"c": 1e-7}]]],
            "odd: key": {"- x": 1}, "large": 4_000_000_000_u32,
        });
        let mut text = String::new();
        write_entries(&value, 0, &mut text);
        let node = crate::document::parse(&text).unwrap();
        assert_eq!(crate::field::Field::root(&node).json(), value, "{text}");
    }

    #[test]
    fn a_value_goes_where_its_path_says() {
        let mut root = json!({ "a.b": { "c": [{ "d": 1 }] }, "a": {} });
        insert(&mut root, "a.b.c[0].e", json!(2));
        insert(&mut root, "a.x", json!(3));
        insert(&mut root, "new", json!(4));
        assert_eq!(
            root,
            json!({ "a.b": { "c": [{ "d": 1, "e": 2 }] }, "a": { "x": 3 }, "new": 4 })
        );
    }
}
