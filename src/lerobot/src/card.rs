//! What a LeRobot dataset says of itself to people: `README.md` as the Hugging Face Hub reads it.
//! Only what the writer counted; no clock.

use reel_dataset::{quoted, size_category};

use crate::{CODEBASE_VERSION, DatasetCounts};

/// What the caller knows of a dataset, for its card and manifest.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DatasetDescription {
    /// What the dataset is called.
    pub name: String,
    /// Its licence, as an SPDX name or `other`.
    pub licence: String,
    /// The command that makes it again.
    pub command: String,
}

/// The card as Markdown with YAML front matter. LeRobot's pages find a dataset by its tag, the
/// viewer its rows by `configs`.
pub(crate) fn card(description: &DatasetDescription, counts: DatasetCounts, fps: u32) -> String {
    let DatasetDescription {
        name,
        licence,
        command,
    } = description;
    let DatasetCounts {
        episodes,
        frames,
        tasks,
    } = counts;
    format!(
        "---\npretty_name: {pretty}\nlicense: {license}\nlanguage:\n- en\ntask_categories:\n- robotics\n\
         size_categories:\n- {size}\ntags:\n- LeRobot\n- embodied-ai\n- household\nconfigs:\n- config_name: default\n  \
         data_files: \"data/*/*.parquet\"\n---\n\n# {name}\n\nEpisodes of a household robot in the simulator of Reel, as a \
         [LeRobot](https://github.com/huggingface/lerobot) dataset ({CODEBASE_VERSION}): {frames} frames of {episodes} episodes \
         of {tasks} tasks at {fps} fps, with the video of the head camera. `meta/info.json` describes the columns.\n\n\
         ## Provenance\n\nMade by\n\n```sh\n{command}\n```\n\nfrom traces that replay exactly. Column `call.index` and the \
         columns `reel/...` of `meta/episodes` lead from a frame to its decision; `manifest.json` lists every file with its \
         BLAKE3 digest.\n\n## Loading\n\n```python\nfrom lerobot.datasets.lerobot_dataset import LeRobotDataset\n\
         dataset = LeRobotDataset(\"OWNER/NAME\", root=\".\")  # from the dataset's folder\n```\n\n## Licence\n\n`{licence}`\n",
        pretty = quoted(name),
        license = quoted(&licence.to_lowercase()),
        size = size_category(frames),
    )
}
