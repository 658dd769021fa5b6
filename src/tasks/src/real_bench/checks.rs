//! What the published loaders accept: one task file at a time. Knows no folder and no manifest.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::{error::Problem, field::Field};

/// Paths that a task file names, and where the published layout has them below a scene's id.
const PATHS: [(&str, &str, &str); 3] = [
    ("scene_usd", "assets/scenes/", "_usd/scene.usd"),
    ("occ_map_dir", "assets/metadata/", ""),
    (
        "furniture_lib",
        "assets/metadata/",
        "/scene_furniture_library.json",
    ),
];
/// Prefix of the mesh paths of objects.
const USD_ROOT: &str = "${MESATASK_USD_ROOT}/";

/// What the bundle's own checks need to know of a task file that passed.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Facts {
    pub benchmark_task_id: String,
    pub family: String,
    pub task_id: String,
    pub scene_id: String,
    pub global_index: i64,
    /// File names of the meshes that the metadata names.
    pub meshes: BTreeSet<String>,
}

/// What the published server demands of a task file before it plays it.
pub(super) fn runtime(root: &Field<'_>) -> Result<(), Problem> {
    root.get("scene_id")?.text()?;
    let paths = root.get("paths")?;
    for (key, ..) in PATHS {
        paths.get(key)?.text()?;
    }
    let objects = root.get("objects")?;
    for (_, object) in filled(&objects)? {
        for key in ["original_id", "category", "usd_path"] {
            object.get(key)?.text()?;
        }
        for key in ["usd_scale", "position"] {
            object.get(key)?.vector()?;
        }
    }
    let episodes = root.get("episodes")?;
    let items = episodes.items()?;
    if items.is_empty() {
        return Err(episodes.problem("holds no episode"));
    }
    for episode in items {
        for key in [
            "task_id",
            "task_description",
            "src",
            "dest",
            "target_object_id",
        ] {
            episode.get(key)?.text()?;
        }
        let (target, src) = (
            episode.get("target_object_id")?,
            episode.get("src")?.text()?,
        );
        let mut target_is_placed = false;
        for (key, placement) in filled(&episode.get("placements")?)? {
            let Some(object) = objects.find(key)? else {
                return Err(placement.problem("is not among the objects"));
            };
            let (asset, furniture) = (
                placement.get("original_id")?,
                placement.get("furniture")?.text()?,
            );
            same_text(&asset, &object.get("original_id")?)?;
            target_is_placed |= asset.text()? == target.text()? && furniture == src;
        }
        if !target_is_placed {
            return Err(target.problem(format!("is not placed on the source, {src}")));
        }
    }
    Ok(())
}

/// What the published benchmark loader demands beyond [`runtime`]
/// of the file `tasks/<family>/<task>.yaml`.
pub(super) fn benchmark(
    root: &Field<'_>,
    (family, task): (&str, &str),
    families: Option<&[String]>,
) -> Result<Facts, Problem> {
    let episodes = root.get("episodes")?;
    let items = episodes.items()?;
    let [episode] = items.as_slice() else {
        return Err(episodes.problem(format!("expected 1 episode, found {}", items.len())));
    };
    let facts = identity(root, episode, (family, task), families)?;
    let metadata = metadata(episode)?;
    let placements = episode.get("placements")?;
    let objects = root.get("objects")?;
    same_keys(&objects, &placements)?;
    for (key, placement) in filled(&placements)? {
        placement.get("position")?.vector()?;
        placement.get("furniture")?.text()?;
        let asset = placement.get("original_id")?;
        let Some(meta) = metadata.get(asset.text()?) else {
            return Err(asset.problem(format!(
                "obj_meta and obj_distractor_meta have no entry for {}",
                asset.text()?
            )));
        };
        object_view(&objects.get(key)?, &placement, meta)?;
    }
    if let Some(rests) = episode.find("final_positions")? {
        same_keys(&rests, &placements)?;
        for (key, rest) in rests.entries()? {
            same_text(
                &rest.get("original_id")?,
                &placements.get(key)?.get("original_id")?,
            )?;
        }
    }
    graphs(episode, &placements)?;
    let plan = episode.get("execution_plan")?;
    if plan.items()?.is_empty() {
        return Err(plan.problem("holds no step"));
    }
    for step in plan.items()? {
        step.get("action")?.any_text()?;
        step.get("args")?.entries()?;
    }
    let meshes = metadata
        .values()
        .filter_map(|meta| meta.find("usd_path").ok().flatten())
        .filter_map(|path| path.text().ok());
    Ok(Facts {
        meshes: meshes.map(str::to_owned).collect(),
        ..facts
    })
}

/// Who the task is: the same in its path, its ids and its scene.
fn identity(
    root: &Field<'_>,
    episode: &Field<'_>,
    (family, task): (&str, &str),
    families: Option<&[String]>,
) -> Result<Facts, Problem> {
    let expect = |key: &str, expected: &str| -> Result<String, Problem> {
        let field = episode.get(key)?;
        let found = field.text()?;
        if found != expected {
            return Err(field.problem(format!("expected {expected}, found {found}")));
        }
        Ok(found.to_owned())
    };
    let family_field = episode.get("family")?;
    if let Some(known) = families
        && !known
            .iter()
            .any(|name| Ok(name.as_str()) == family_field.text())
    {
        return Err(family_field.problem(format!(
            "expected a family of the manifest: {}",
            known.join(", ")
        )));
    }
    let scene_id = root.get("scene_id")?.text()?;
    let paths = root.get("paths")?;
    for (key, before, after) in PATHS {
        let (field, expected) = (paths.get(key)?, format!("{before}{scene_id}{after}"));
        if field.text()? != expected {
            return Err(field.problem(format!("expected {expected}, found {}", field.text()?)));
        }
    }
    episode.get("benchmark_instruction")?.text()?;
    Ok(Facts {
        family: expect("family", family)?,
        task_id: expect("task_id", task)?,
        benchmark_task_id: expect("benchmark_task_id", &format!("{family}/{task}"))?,
        scene_id: expect("scene_id", scene_id)?,
        global_index: episode.get("global_index")?.integer()?,
        meshes: BTreeSet::new(),
    })
}

/// What the episode says of its assets: of the one target and of those that distract from it.
fn metadata<'a>(episode: &Field<'a>) -> Result<BTreeMap<&'a str, Field<'a>>, Problem> {
    let targets = episode.get("obj_meta")?;
    let mut metadata: BTreeMap<&str, Field<'_>> = targets.entries()?.into_iter().collect();
    let Some((target, 1)) = metadata
        .keys()
        .next()
        .map(|target| (*target, metadata.len()))
    else {
        return Err(targets.problem(format!("expected 1 target, found {}", metadata.len())));
    };
    let named = episode.get("target_object_id")?;
    if named.text()? != target {
        return Err(named.problem(format!(
            "expected the asset of obj_meta, {target}, found {}",
            named.text()?
        )));
    }
    metadata.extend(
        episode
            .find_or_null("obj_distractor_meta")?
            .map_or(Ok(Vec::new()), |metas| metas.entries())?,
    );
    for meta in metadata.values() {
        if let Some(path) = meta.find("usd_path")?
            && (path.text()?.contains('/') || !path.text()?.ends_with(".usd"))
        {
            return Err(path.problem(format!(
                "expected the file name of a mesh, like mug.usd, found {}",
                path.text()?
            )));
        }
    }
    Ok(metadata)
}

/// An object must say of itself what its placement and its metadata say.
fn object_view(object: &Field<'_>, placement: &Field<'_>, meta: &Field<'_>) -> Result<(), Problem> {
    same_value(&object.get("position")?, &placement.get("position")?)?;
    same_value(&object.get("category")?, &meta.get("category")?)?;
    let (path, mesh) = (object.get("usd_path")?, meta.get("usd_path")?);
    if path.text()?.strip_prefix(USD_ROOT) != Some(mesh.text()?) {
        return Err(path.problem(format!(
            "expected {USD_ROOT}{}, found {}",
            mesh.text()?,
            path.text()?
        )));
    }
    for key in ["size", "detailed_caption"] {
        if let Some(said) = meta.find(key)? {
            same_value(&object.get(key)?, &said)?;
        }
    }
    Ok(())
}

/// The graphs hold what is placed, and the goal brings the target from the
/// source to the destination.
fn graphs(episode: &Field<'_>, placements: &Field<'_>) -> Result<(), Problem> {
    let (initial, goal) = (
        episode.get("initial_world_graph")?,
        episode.get("goal_world_graph")?,
    );
    let (before, after) = (contents(&initial)?, contents(&goal)?);
    let mut placed: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (_, placement) in placements.entries()? {
        placed
            .entry(placement.get("furniture")?.text()?)
            .or_default()
            .push(placement.get("original_id")?.text()?);
    }
    for (receptacle, content) in &before {
        let sorted = |list: &[&str]| {
            let mut list: Vec<String> = list.iter().map(|asset| (*asset).to_owned()).collect();
            list.sort();
            list
        };
        let here = placed.remove(receptacle).unwrap_or_default();
        if sorted(content) != sorted(&here) {
            let (said, here) = (content.join(", "), here.join(", "));
            return Err(initial
                .get(receptacle)?
                .problem(format!("holds [{said}], but placed there are [{here}]")));
        }
    }
    if let Some((receptacle, _)) = placed.first_key_value() {
        return Err(initial.problem(format!("lacks {receptacle}, on which objects are placed")));
    }
    let target = episode.get("target_object_id")?.text()?;
    let holds = |graph: &BTreeMap<&str, Vec<&str>>, key: &str| -> Result<bool, Problem> {
        let field = episode.get(key)?;
        let content = graph.get(field.text()?);
        Ok(content
            .ok_or_else(|| {
                field.problem(format!(
                    "{} is missing in a world graph",
                    field.text().unwrap_or_default()
                ))
            })?
            .contains(&target))
    };
    holds(&before, "dest")?;
    match (
        holds(&before, "src")?,
        holds(&after, "src")?,
        holds(&after, "dest")?,
    ) {
        (false, ..) => {
            Err(initial.problem(format!("the source does not hold the target, {target}")))
        }
        (_, true, _) => Err(goal.problem(format!("the source still holds the target, {target}"))),
        (.., false) => Err(goal.problem(format!(
            "the destination does not hold the target, {target}"
        ))),
        (true, false, true) => Ok(()),
    }
}

fn contents<'a>(graph: &Field<'a>) -> Result<BTreeMap<&'a str, Vec<&'a str>>, Problem> {
    let content = |(receptacle, state): (&'a str, Field<'a>)| {
        state.entries()?;
        let list = state
            .find_or_null("content")?
            .map_or(Ok(Vec::new()), |list| list.items())?;
        Ok((
            receptacle,
            list.iter()
                .map(Field::any_text)
                .collect::<Result<_, Problem>>()?,
        ))
    };
    graph.entries()?.into_iter().map(content).collect()
}

/// The entries of a mapping that must have some.
fn filled<'a>(field: &Field<'a>) -> Result<Vec<(&'a str, Field<'a>)>, Problem> {
    let entries = field.entries()?;
    if entries.is_empty() {
        Err(field.problem("empty"))
    } else {
        Ok(entries)
    }
}

fn same_keys(one: &Field<'_>, other: &Field<'_>) -> Result<(), Problem> {
    for (a, b) in [(one, other), (other, one)] {
        let known: BTreeSet<&str> = b.entries()?.into_iter().map(|(key, _)| key).collect();
        if let Some((_, field)) = a
            .entries()?
            .into_iter()
            .find(|(key, _)| !known.contains(key))
        {
            return Err(field.problem(format!("is not in {}", b.path())));
        }
    }
    Ok(())
}

fn same_text(one: &Field<'_>, other: &Field<'_>) -> Result<(), Problem> {
    one.text()?;
    same_value(one, other)
}

/// Values are equal if their numbers are, whether written as `1` or as `1.0`.
fn same_value(one: &Field<'_>, other: &Field<'_>) -> Result<(), Problem> {
    if equal(&one.json(), &other.json()) {
        return Ok(());
    }
    Err(one.problem(format!(
        "expected {} as in {}, found {}",
        other.json(),
        other.path(),
        one.json()
    )))
}

fn equal(one: &Value, other: &Value) -> bool {
    match (one, other) {
        (Value::Number(a), Value::Number(b)) => a.as_f64() == b.as_f64(),
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| equal(a, b))
        }
        _ => one == other,
    }
}
