//! What a dataset says of itself to people: `README.md` as Hugging Face reads it, and
//! `dataset_info.json` for LLaMA-Factory. Only what the manifest holds; no clock.

use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path};

use reel_world::Family;
use serde_json::{Map, Value, json};

use crate::{DatasetError, Format, Manifest, Split, Style};

/// The card's name in a dataset's folder.
pub const CARD: &str = "README.md";
/// LLaMA-Factory's list of datasets.
pub const DATASET_INFO: &str = "dataset_info.json";

/// Writes the card, and `dataset_info.json` where the format wants it. Before
/// [`Manifest::write`], which digests them.
///
/// # Errors
/// When a file cannot be written.
pub fn write_card(root: &Path, manifest: &Manifest) -> Result<(), DatasetError> {
    let path = root.join(CARD);
    fs::write(&path, card(manifest)).map_err(DatasetError::io(&path))?;
    if manifest.format == Format::LlamaFactory {
        let path = root.join(DATASET_INFO);
        fs::write(&path, dataset_info(manifest)).map_err(DatasetError::io(&path))?;
    }
    Ok(())
}

/// The names under which LLaMA-Factory finds the parts: `<name>_<split>`.
pub fn dataset_info(manifest: &Manifest) -> String {
    let mut columns = json!({ "messages": "conversations", "images": "images" });
    if manifest.style != Style::SingleTurn {
        columns["system"] = "system".into();
        columns["tools"] = "tools".into();
    }
    let entry = |split: &Split| json!({ "file_name": split.as_str(), "formatting": "sharegpt", "columns": columns });
    let entries: Map<String, Value> = manifest
        .shards
        .keys()
        .map(|split| (info_name(manifest, *split), entry(split)))
        .collect();
    format!("{:#}\n", Value::Object(entries))
}

fn info_name(manifest: &Manifest, split: Split) -> String {
    format!("{}_{}", manifest.name, split.as_str())
}

/// The card as Markdown with YAML front matter.
pub fn card(manifest: &Manifest) -> String {
    let counts = &manifest.counts;
    let mut text = front_matter(manifest);
    let _ = write!(
        text,
        "\n# {}\n\nDecisions of {} that call tools: what the agent was told and saw, and what it should answer. \
         {} examples, {}, in the format `{}`: {}.\n",
        manifest.name,
        if is_household(manifest) {
            "household agents"
        } else {
            "agents"
        },
        counts.examples,
        match manifest.style {
            Style::SingleTurn => "one user turn a decision with the latest images",
            Style::MultiTurn => "a whole episode each, with native tool calls",
            Style::MultiTurnPrefix =>
                "a conversation up to one decision each, with native tool calls",
        },
        manifest.format.as_str(),
        manifest.format.description(),
    );
    table(
        &mut text,
        "Split",
        counts
            .splits
            .iter()
            .map(|(split, count)| (split.as_str(), *count)),
    );
    table(&mut text, "Family", named(&counts.families));
    // A row that is a whole episode has many calls, and is counted once.
    let of_tools = match manifest.style {
        Style::SingleTurn | Style::MultiTurnPrefix => "Tool",
        Style::MultiTurn => "Tool of the last turn",
    };
    table(&mut text, of_tools, named(&counts.tools));
    let _ = write!(
        text,
        "\n## Provenance\n\nMade by\n\n```sh\n{}\n```\n\nfrom version {} of the tables{}. Every row names its trace (`trace_digest`), \
         episode, call, replay verdict, reward preset (`preset_digest`) and rule version{}. `manifest.json` lists every file with \
         its BLAKE3 digest; the same inputs give the same bytes.\n",
        manifest.command,
        manifest.table_version,
        match &manifest.prompt_template {
            Some(template) => format!(
                ", with the prompt template `{}` (BLAKE3 `{}`{})",
                template.name,
                template.blake3,
                template
                    .memory
                    .iter()
                    .map(|option| format!(", `{option}`"))
                    .collect::<String>(),
            ),
            None => String::new(),
        },
        if manifest.format.holds_provenance() {
            " in `provenance`"
        } else {
            " in the files under `provenance/`, line by line"
        },
    );
    table(&mut text, "Verdict", named(&counts.verdicts));
    table(&mut text, "Policy", named(&counts.policies));
    table(
        &mut text,
        "Reasoning and History by",
        named(&counts.annotators),
    );
    if !manifest.excluded.is_empty() {
        table(&mut text, "Left out because", named(&manifest.excluded));
    }
    lengths(&mut text, manifest);
    leakage(&mut text, manifest);
    let _ = write!(
        text,
        "\n## Loading\n\n```{}\n{}```\n",
        loading_language(manifest.format),
        loading(manifest)
    );
    let _ = write!(text, "\n## Licence\n\n`{}`\n", manifest.licence);
    text
}

/// The Hub's name of the class of sizes that a number of rows is in.
pub fn size_category(rows: u64) -> &'static str {
    match rows {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        1_000_000..10_000_000 => "1M<n<10M",
        _ => "10M<n<100M",
    }
}

/// Whether a row is of a household: tasks of other agents have a family of their own.
fn is_household(manifest: &Manifest) -> bool {
    let families = &manifest.counts.families;
    families.is_empty()
        || families
            .keys()
            .any(|family| family != Family::Other.as_str())
}

fn front_matter(manifest: &Manifest) -> String {
    let size = size_category(manifest.counts.examples);
    let (categories, tags) = if is_household(manifest) {
        (
            "- image-text-to-text\n- robotics\n",
            "- embodied-ai\n- tool-use\n- household\n",
        )
    } else {
        ("- text-generation\n", "- tool-use\n")
    };
    let mut text = format!(
        "---\npretty_name: {name}\nlicense: {licence}\nlanguage:\n- en\ntask_categories:\n{categories}\
         size_categories:\n- {size}\ntags:\n{tags}configs:\n- config_name: default\n  data_files:\n",
        name = crate::json::quoted(&manifest.name),
        licence = crate::json::quoted(&manifest.licence.to_lowercase()),
    );
    for split in manifest.shards.keys() {
        let _ = writeln!(
            text,
            "  - split: {0}\n    path: \"{0}/*.{1}\"",
            split.as_str(),
            manifest.format.extension()
        );
    }
    text.push_str("---\n");
    text
}

fn named(counts: &BTreeMap<String, u64>) -> impl Iterator<Item = (&str, u64)> {
    counts.iter().map(|(name, count)| {
        (
            if name.is_empty() {
                "(none)"
            } else {
                name.as_str()
            },
            *count,
        )
    })
}

fn table<'r>(text: &mut String, title: &str, rows: impl Iterator<Item = (&'r str, u64)>) {
    let _ = write!(text, "\n| {title} | Examples |\n| --- | ---: |\n");
    for (name, count) in rows {
        let _ = writeln!(text, "| {} | {count} |", name.replace('|', "\\|"));
    }
}

fn lengths(text: &mut String, manifest: &Manifest) {
    let Some(tokens) = &manifest.tokens else {
        return;
    };
    let _ = write!(
        text,
        "\n## Length\n\nTokens by {}; an image has one for each {side} x {side} pixels. The longest example has {}; {} of {} are over \
         the context of {}.\n",
        tokens.tokenizer,
        tokens.longest,
        tokens.over,
        tokens.examples,
        tokens.budget,
        side = tokens.image_side,
    );
    let bars: Vec<(String, u64)> = tokens
        .histogram
        .iter()
        .map(|(upper, count)| (format!("up to {upper}"), *count))
        .collect();
    table(
        text,
        "Tokens",
        bars.iter().map(|(bar, count)| (bar.as_str(), *count)),
    );
}

fn leakage(text: &mut String, manifest: &Manifest) {
    text.push_str("\n## Splits\n\n");
    if manifest.leakage.is_empty() {
        text.push_str("Nothing that was compared is in more than one split.\n");
        return;
    }
    let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
    for leak in &manifest.leakage {
        *kinds.entry(&leak.kind).or_default() += 1;
    }
    for (what, count) in kinds {
        let _ = writeln!(text, "- In more than one split, of kind {what}: {count}");
    }
}

fn loading_language(format: Format) -> &'static str {
    match format {
        Format::MsSwift | Format::LlamaFactory => "sh",
        _ => "python",
    }
}

/// How a trainer loads it, from the dataset's folder.
fn loading(manifest: &Manifest) -> String {
    let images = "datasets.List(datasets.Image())";
    match manifest.format {
        Format::QwenVl => "# qwenvl/data/__init__.py of Qwen's repository, folder qwen-vl-finetune\n\
             REEL = {\"annotation_path\": \"train/train-00000.json\", \"data_path\": \".\"}  # one entry for each file of train/\n"
            .to_owned(),
        Format::MsSwift => "ROOT_IMAGE_DIR=. swift sft --dataset train/*.jsonl --val_dataset validation/*.jsonl ...\n".to_owned(),
        Format::LlamaFactory => format!(
            "llamafactory-cli train --dataset_dir . --media_dir . --dataset {} --mask_history {} ...\n",
            info_name(manifest, Split::Train),
            manifest.style == Style::MultiTurnPrefix,
        ),
        Format::Trl => format!(
            "import datasets  # from the dataset's folder: the paths of the images are relative to it\n\
             rows = datasets.load_dataset(\"json\", data_files={{\"train\": \"train/*.jsonl\"}}, split=\"train\")\n\
             rows = rows.cast_column(\"images\", {images})  # datasets 3: datasets.Sequence(datasets.Image())\n"
        ),
        Format::OpenAi => "import json\nfrom openai.types.chat import ChatCompletionMessageParam  # the type of each of the messages\n\
             rows = [json.loads(line) for line in open(\"train/train-00000.jsonl\")]\n"
            .to_owned(),
        Format::Parquet => {
            "import datasets\nrows = datasets.load_dataset(\"parquet\", data_files={\"train\": \"train/*.parquet\"}, split=\"train\")\n".to_owned()
        }
    }
}
