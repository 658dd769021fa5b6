//! A public checkout in small: the layout of the published repository around the task files that
//! are here, complete in itself.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// Writes `<root>/benchmark` with every `step`th task file of `data`, numbered anew so that none is
/// missing, and without a scene. Gives the number of tasks by family.
///
/// # Panics
/// Panics if a file cannot be read or written.
pub fn write(data: &Path, root: &Path, step: usize) -> BTreeMap<String, usize> {
    let benchmark = root.join("benchmark");
    let mut counts = BTreeMap::new();
    let mut meshes = BTreeSet::new();
    let mut index = 0;
    for family in sorted(&data.join("tasks")) {
        let name = family.file_name().unwrap().to_str().unwrap().to_owned();
        let folder = benchmark.join("tasks").join(&name);
        fs::create_dir_all(&folder).unwrap();
        for file in sorted(&family).into_iter().step_by(step) {
            let mut text = String::new();
            for line in fs::read_to_string(&file).unwrap().lines() {
                if let Some(mesh) = line
                    .trim()
                    .strip_prefix("usd_path: ")
                    .filter(|path| !path.contains('$'))
                {
                    meshes.insert(mesh.to_owned());
                }
                match line.split_once("global_index: ") {
                    Some((before, _)) => text.push_str(&format!("{before}global_index: {index}\n")),
                    None => text.push_str(&format!("{line}\n")),
                }
            }
            fs::write(folder.join(file.file_name().unwrap()), text).unwrap();
            index += 1;
            *counts.entry(name.clone()).or_default() += 1;
        }
    }
    let list: String = meshes.iter().map(|mesh| format!("{mesh}\n")).collect();
    fs::write(benchmark.join("mesa_required.txt"), list).unwrap();
    fs::write(
        benchmark.join("manifest.yaml"),
        manifest(&counts, meshes.len()),
    )
    .unwrap();
    counts
}

/// The text of a `manifest.yaml` that states these numbers of tasks by family and
/// this number of meshes.
pub fn manifest(counts: &BTreeMap<String, usize>, meshes: usize) -> String {
    let total: usize = counts.values().sum();
    let families: String = counts
        .iter()
        .map(|(family, count)| format!("  {family}: {count}\n"))
        .collect();
    let order: String = counts
        .keys()
        .map(|family| format!("- {family}\n"))
        .collect();
    format!(
        "benchmark: REAL-Bench\ntotal_tasks: {total}\nfamily_counts:\n{families}family_order:\n{order}mesa_required_count: {meshes}\n"
    )
}

fn sorted(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    paths
}
