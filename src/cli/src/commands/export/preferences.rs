//! `reel export preferences`: the decisive call of failed episodes beside the call of a competent
//! agent, as pairs, and what every moment still cost.

use std::{
    collections::BTreeMap,
    fs,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_counterfactual::blame::{Blame, Preferred, blame, preferred};
use reel_dataset::{
    Encoding, Format, ImageOptions, PREFERENCES, PreferenceDescription, Ratios, Style, VALUES,
    WriterOptions, write_preference_card,
};
use reel_export::{AnnotationSource, ExportOptions, Selection, SplitBy};
use reel_replay::verify_trace;
use reel_tables::Store;
use reel_trace::{Trace, TraceFiles};
use serde_json::{Value, json};

use super::shared::{CardOptions, StoreSource, command};
use crate::{ExitStatus, inputs, progress};

/// Discount of the value targets (paper, Full POMDP Definition).
const GAMMA: f64 = 0.99;

/// Preference pairs from the failed episodes of a store, one an episode, at its decisive call: the
/// same prompt, the recorded decision rejected, and chosen what a competent agent that knew what
/// this agent knew would have called (`preferences.jsonl`, prompt/chosen/rejected as TRL loads them).
/// Where the cause is communication, the chosen call is the question that was missing. Every chosen
/// call was played: it is possible at that moment, a competent agent went on after it and succeeded,
/// and the branch replays bit for bit. `values.jsonl` has the cost-to-go of every step of both: the
/// decisions that a competent agent needed at worst, and 0.99 to that power as a value target.
///
/// Example:
///   reel ingest traces --store store
///   reel export preferences --store store --out preferences
///   python -c "import datasets; print(datasets.load_dataset('json', data_files='preferences/preferences.jsonl'))"
///
/// An episode gives no pair if it does not replay bit for bit, if the two decisions are equal, or if
/// success needs knowledge that its agent did not have; the report says why.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    source: StoreSource,
    /// Folder of the dataset; the traces of the chosen futures lie in its folder `traces`
    #[arg(long, value_name = "DIR", default_value = "preferences")]
    out: PathBuf,
    /// Pairs have no images
    #[arg(long)]
    no_images: bool,
    /// Most pixels of an image; 0: as they were taken (640 x 480)
    #[arg(
        long = "max-pixels",
        alias = "pixels",
        value_name = "PIXELS",
        default_value_t = 100_352
    )]
    pixels: u32,
    /// What the dataset is called
    #[arg(long, value_name = "NAME", default_value = "reel-preferences")]
    name: String,
    #[command(flatten)]
    card: CardOptions,
    /// Episodes at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// A failed episode and the future after the better decision.
struct Pair {
    failed: Trace,
    blame: Blame,
    better: Trace,
    preferred: Preferred,
}

/// Plays the better decision of each failed episode of a store and writes preference pairs.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let Arguments { out, .. } = arguments;
    if out.exists() && fs::read_dir(out)?.next().is_some() {
        bail!("the folder {} is not empty", out.display());
    }
    let traces = out.join("traces");
    fs::create_dir_all(&traces)
        .with_context(|| format!("cannot make the folder {}", traces.display()))?;
    let store = arguments.source.open()?;
    let failed = arguments.source.failed_traces()?;
    let bar = progress::bar(failed.len(), "prefer");
    let pool = inputs::pool(arguments.jobs)?;
    let one = |path: &String| {
        let made = pair(store.trace_files(), Path::new(path), &traces)
            .map_err(|reason| (path.clone(), format!("{reason:#}")));
        bar.inc(1);
        made
    };
    let made: Vec<Result<Pair, (String, String)>> =
        pool.install(|| failed.par_iter().with_max_len(1).map(one).collect());
    bar.finish_and_clear();
    let (mut pairs, mut refused) = (Vec::new(), Vec::new());
    for made in made {
        match made {
            Ok(pair) => pairs.push(pair),
            Err(refusal) => refused.push(refusal),
        }
    }
    let count = pool.install(|| write(store.trace_files(), arguments, &pairs, &mut refused))?;
    if arguments.json {
        let refused: Vec<Value> = refused
            .iter()
            .map(|(trace, reason)| json!({ "trace": trace, "reason": reason }))
            .collect();
        println!(
            "{}",
            json!({ "failed": failed.len(), "pairs": count, "refused": refused, "out": out })
        );
        return Ok(ExitStatus::Success);
    }
    println!(
        "{count} pairs of {} failed episodes in {}",
        failed.len(),
        out.display()
    );
    for (trace, reason) in refused {
        println!("  none of {trace}: {reason}");
    }
    Ok(ExitStatus::Success)
}

fn pair(files: &TraceFiles, path: &Path, traces: &Path) -> anyhow::Result<Pair> {
    let failed = files.read(path)?;
    let verdict = verify_trace(&failed);
    if !verdict.is_exact() {
        bail!("it does not replay exactly: {verdict}");
    }
    let blame = blame(&failed);
    let decisive = blame.decisive.as_ref().context("nothing was lost in it")?;
    let name = reel_trace::trace_stem(path);
    let record = traces.join(format!("{name}--preferred.mcap"));
    let preferred = preferred(&failed, decisive, Some(&record))?.map_err(anyhow::Error::msg)?;
    if !preferred.verified {
        bail!("the future after the better call does not replay exactly");
    }
    Ok(Pair {
        better: files.read(&record)?,
        failed,
        blame,
        preferred,
    })
}

/// Makes the examples of all these episodes with the exporter of training sets, and pairs them.
fn write(
    files: &TraceFiles,
    arguments: &Arguments,
    pairs: &[Pair],
    refused: &mut Vec<(String, String)>,
) -> anyhow::Result<usize> {
    let Arguments { out, .. } = arguments;
    let (work, examples) = (out.join(".store"), out.join(".examples"));
    let paths: Vec<PathBuf> = pairs
        .iter()
        .flat_map(|pair| [pair.failed.path.clone(), pair.better.path.clone()])
        .collect();
    let mut store = Store::open_or_create(&work)?.with_trace_files(files.clone());
    store.ingest(&paths, &|_, _| ())?;
    reel_export::export(&store, &examples, &options(arguments), &|_| (), &|_| ())?;
    let rows = rows(&examples)?;
    let mut preferences = BufWriter::new(fs::File::create(out.join(PREFERENCES))?);
    let mut values = BufWriter::new(fs::File::create(out.join(VALUES))?);
    let (mut count, mut targets) = (0, 0);
    for pair in pairs {
        let at = pair.preferred.at;
        let row = |trace: &Trace| rows.get(&format!("{}/{at}", trace.header.episode_id));
        let reason = match (row(&pair.failed), row(&pair.better)) {
            (Some(rejected), Some(chosen)) if rejected["completion"] != chosen["completion"] => {
                writeln!(preferences, "{}", preference(pair, rejected, chosen))?;
                count += 1;
                None
            }
            (Some(_), Some(_)) => Some("both decisions have the same words".to_owned()),
            _ => Some(format!("only one of the two has a decision {at}")),
        };
        if let Some(reason) = reason {
            refused.push((pair.failed.path.display().to_string(), reason));
        }
        for (trace, measured) in [
            (&pair.failed, &pair.blame),
            (&pair.better, &blame(&pair.better)),
        ] {
            for cost in &measured.costs {
                let value = cost.before.map_or(0.0, |cost| GAMMA.powi(cost as i32));
                writeln!(
                    values,
                    "{}",
                    json!({ "example": format!("{}/{}", measured.episode_id, cost.step), "trace_digest": measured.trace_digest,
                        "call": trace.steps[cost.step as usize].input.call, "cost_to_go": cost.before, "regret": cost.regret,
                        "value": value })
                )?;
                targets += 1;
            }
        }
    }
    preferences.flush()?;
    values.flush()?;
    let images = examples.join("images");
    if images.exists() {
        fs::rename(images, out.join("images"))?;
    }
    fs::remove_dir_all(&examples)?;
    fs::remove_dir_all(&work)?;
    let words = crate::words().iter().skip(1);
    let description = PreferenceDescription {
        name: arguments.name.clone(),
        licence: arguments.card.licence.clone(),
        command: command(words.map(|word| word.to_string_lossy().into_owned())),
        pairs: count as u64,
        values: targets,
    };
    write_preference_card(out, &description)?;
    Ok(count)
}

fn preference(pair: &Pair, rejected: &Value, chosen: &Value) -> Value {
    let decisive = pair.blame.decisive.as_ref();
    json!({
        "prompt": rejected["prompt"], "chosen": chosen["completion"], "rejected": rejected["completion"], "images": rejected["images"],
        "provenance": {
            "rejected": rejected["provenance"], "chosen": chosen["provenance"], "call": pair.preferred.at,
            "rejected_call": decisive.map(|decisive| &decisive.call), "chosen_call": pair.preferred.call,
            "cause": decisive.map(|decisive| decisive.cause),
            "harm": decisive.map(|decisive| decisive.harm),
        },
    })
}

/// The rows of a dataset by the name of their example.
fn rows(folder: &Path) -> anyhow::Result<BTreeMap<String, Value>> {
    let mut rows = BTreeMap::new();
    let parts = folder.join("train");
    if !parts.exists() {
        return Ok(rows);
    }
    for entry in fs::read_dir(parts)? {
        for line in fs::read_to_string(entry?.path())?.lines() {
            let row: Value = serde_json::from_str(line)?;
            let name = row["provenance"]["example"]
                .as_str()
                .unwrap_or_default()
                .to_owned();
            rows.insert(name, row);
        }
    }
    Ok(rows)
}

fn options(arguments: &Arguments) -> ExportOptions {
    let pixels_max = (arguments.pixels > 0).then_some(arguments.pixels);
    ExportOptions {
        selection: Selection {
            failed: true,
            mistakes: true,
            after_decisive: true,
            contradictions: true,
            ..Selection::default()
        },
        writer: WriterOptions {
            images: ImageOptions {
                encoding: Encoding::Png,
                pixels_max,
                ..ImageOptions::default()
            },
            ..WriterOptions::new(Format::Trl)
        },
        style: Style::SingleTurn,
        prompt: reel_prompt::Prompt::builtin(),
        words: AnnotationSource::Auto,
        split_by: SplitBy::Task,
        ratios: Ratios::new([1.0, 0.0, 0.0]).expect("all of it is one part"),
        images: !arguments.no_images,
        allow_unverified: false,
        replay: true,
        rollouts: None,
        tokenizer: None,
        trace_base: std::env::current_dir().ok(),
        name: arguments.name.clone(),
        licence: arguments.card.licence.clone(),
        command: "reel export preferences".to_owned(),
    }
}
