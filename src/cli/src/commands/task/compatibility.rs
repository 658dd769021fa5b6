//! `reel task compatibility`: the table of what belongs where, to be changed by people or
//! written by a model.

#[cfg(feature = "service")]
use std::collections::BTreeMap;
use std::{fs, path::PathBuf, sync::Arc};

use anyhow::Context;
#[cfg(feature = "service")]
use anyhow::bail;
use reel_tasks::generate::task::Compatibility;
use reel_world::Scene;

use crate::ExitStatus;
#[cfg(feature = "service")]
use crate::model::Model;

/// Write the table of what belongs where, as it comes with Reel or as a model judges it.
///
/// Tasks are generated from it: an object moves between two receptacles that both hold it. Without
/// a model it is the table that comes with Reel, to be changed in an editor. A model is asked once
/// for every kind of receptacle in every kind of room that the scenes have; where its answer cannot
/// be used, what the table said stays. Replies are kept beside the file and not asked for again.
///
/// Examples:
///   reel task compatibility --out table.json
///   reel task compatibility --scene S1,S2 --endpoint http://localhost:8000/v1 --model qwen3 --out table.json
///   reel task generate --compatibility table.json --scene S1,S2 --out made
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Scenes: S1 to S7, S1-parts to S7-parts, home, or files; without it the home
    #[arg(long, value_name = "SCENES", value_delimiter = ',')]
    scene: Vec<PathBuf>,
    /// Compatibility table (JSON) to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[cfg(feature = "service")]
    #[command(flatten)]
    model: Model,
}

/// Writes the compatibility table, as built in or as a model proposes it.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let scenes = super::scenes(&arguments.scene)?;
    let committed = Compatibility::committed();
    let table = proposed(arguments, committed, &scenes)?.unwrap_or_else(|| committed.clone());
    let text = serde_json::to_string_pretty(&table).context("a table is plain data")?;
    super::save(&arguments.out, &(text + "\n"))?;
    println!("{}", arguments.out.display());
    Ok(ExitStatus::Success)
}

/// Reads a compatibility table; fails if the file is missing or not such a table.
pub fn read(file: &PathBuf) -> anyhow::Result<Compatibility> {
    let text =
        fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let table = serde_json::from_str(&text);
    table.with_context(|| {
        format!(
            "{} is no table of what belongs where; `reel task compatibility` writes one",
            file.display()
        )
    })
}

#[cfg(not(feature = "service"))]
fn proposed(
    _: &Arguments,
    _: &Compatibility,
    _: &[Arc<Scene>],
) -> anyhow::Result<Option<Compatibility>> {
    Ok(None)
}

/// The table as a model sees it; none where no model was named.
#[cfg(feature = "service")]
fn proposed(
    arguments: &Arguments,
    table: &Compatibility,
    scenes: &[Arc<Scene>],
) -> anyhow::Result<Option<Compatibility>> {
    use reel_llm::client::{Message, Request, Role};
    use reel_tasks::generate::task::compatibility::{PROMPT, judge, question};
    use reel_tasks::library::objects;

    let Arguments { out, model, .. } = arguments;
    let beside = |ending: &str| out.with_extension(ending);
    let Some(client) = model.client(&beside("model-replies"), &beside("model-calls.jsonl"))? else {
        return Ok(None);
    };
    let places = table.receptacle_kinds(scenes.iter().map(Arc::as_ref));
    let bar = crate::progress::bar(places.len(), "places");
    let (mut rows, mut unused, asked) = (BTreeMap::new(), 0, places.len());
    for place in places {
        let messages = vec![
            Message::text(Role::System, PROMPT),
            Message::text(Role::User, question(&place, objects())),
        ];
        let reply = client.complete(&Request {
            messages,
            ..Request::default()
        })?;
        match judge(&reply.text, objects()) {
            Some(held) => {
                if !held.unknown.is_empty() {
                    bar.suspend(|| {
                        eprintln!(
                            "reel: {} in the {}: unknown {}",
                            place.kind,
                            place.room,
                            held.unknown.join(", ")
                        )
                    });
                }
                rows.insert(place, held.known);
            }
            None => unused += 1,
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if rows.is_empty() {
        bail!("none of the {asked} answers holds a list of things that there are");
    }
    println!(
        "{} of {asked} places by {}, {unused} as they were",
        rows.len(),
        client.endpoint().model
    );
    Ok(Some(table.with(rows)))
}
