//! `reel store remark`: stars, tags and comments of people on episodes.

use anyhow::bail;
use reel_tables::{RemarkRow, Store};

use super::label::{author, episodes, now_ms, the_episode};
use crate::ExitStatus;

/// The longest tag that is kept, in characters.
const TAG_CHARACTERS: usize = 60;
/// The longest comment that is kept, in characters.
const COMMENT_CHARACTERS: usize = 4000;

/// Keep stars, tags and comments on episodes of the store, each with its author.
///
/// Examples:
///   reel store remark star 3f2a91c0 --author ann --store store
///   reel store remark tag 3f2a91c0 --text "for the talk" --author ann --store store
///   reel store remark comment 3f2a91c0 --text "It looks into the wrong drawer." --step 4 --author ann --store store
///   reel store remark remove 3f2a91c0 --kind tag --text "for the talk" --author ann --store store
///   reel query --store store "SELECT episode_id FROM remarks WHERE kind = 'tag' AND text = 'for the talk'"
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: Command,
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store", global = true)]
    store: String,
    /// Print remarks as JSON (`list`)
    #[arg(long, global = true)]
    json: bool,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Star an episode, to find it again
    Star(Who),
    /// Tag an episode with a few words
    Tag {
        #[command(flatten)]
        who: Who,
        /// The tag: 1 to 60 characters without a comma
        #[arg(long = "text", value_name = "TAG")]
        tag: String,
    },
    /// Comment on an episode, or on one of its steps
    Comment {
        #[command(flatten)]
        who: Who,
        /// The comment: 1 to 4000 characters
        #[arg(long, value_name = "TEXT")]
        text: String,
        /// The step that it is about, counted from 0; without it the whole episode
        #[arg(long, value_name = "STEP")]
        step: Option<i32>,
    },
    /// Take back one star, tag or comment of your own
    Remove {
        #[command(flatten)]
        who: Who,
        /// What the remark is: star, tag or comment
        #[arg(long, value_name = "KIND", value_parser = ["star", "tag", "comment"])]
        kind: String,
        /// Its words; a star has none
        #[arg(long, value_name = "TEXT", default_value = "")]
        text: String,
        /// The step that it is about
        #[arg(long, value_name = "STEP")]
        step: Option<i32>,
    },
    /// List every remark of the store
    List,
}

#[derive(clap::Args)]
struct Who {
    /// The episode's id; its beginning is enough where it is unique
    #[arg(value_name = "EPISODE")]
    episode: String,
    /// Name of the author of the remark
    #[arg(long, value_name = "NAME")]
    author: String,
}

/// Adds, removes or lists remarks.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let store = &arguments.store;
    match &arguments.what {
        Command::Star(who) => keep(store, who, "star", "", None),
        Command::Tag { who, tag } => {
            let tag = tag.trim();
            if tag.is_empty() || tag.chars().count() > TAG_CHARACTERS || tag.contains(',') {
                bail!("a tag has 1 to {TAG_CHARACTERS} characters and no comma");
            }
            keep(store, who, "tag", tag, None)
        }
        Command::Comment { who, text, step } => {
            let text = text.trim();
            if text.is_empty() || text.chars().count() > COMMENT_CHARACTERS {
                bail!("a comment has 1 to {COMMENT_CHARACTERS} characters");
            }
            keep(store, who, "comment", text, *step)
        }
        Command::Remove {
            who,
            kind,
            text,
            step,
        } => remove(store, who, kind, text.trim(), *step),
        Command::List => {
            let remarks = Store::open(store)?.remarks()?;
            if arguments.json {
                println!("{}", serde_json::to_string_pretty(&remarks)?);
            }
            for remark in remarks.iter().filter(|_| !arguments.json) {
                let step = remark
                    .step
                    .map(|step| format!(" at {step}"))
                    .unwrap_or_default();
                println!(
                    "{}  {:7} {:12} {}{step}",
                    remark.episode_id, remark.kind, remark.author, remark.text
                );
            }
            Ok(ExitStatus::Success)
        }
    }
}

/// What makes a remark the same as another: everything but its time.
fn is_same(one: &RemarkRow, other: &RemarkRow) -> bool {
    let at_ms = one.at_ms;
    *one == RemarkRow {
        at_ms,
        ..other.clone()
    }
}

fn remark(
    store: &str,
    who: &Who,
    kind: &str,
    text: &str,
    step: Option<i32>,
) -> anyhow::Result<RemarkRow> {
    let episodes = episodes(store)?;
    let episode = the_episode(&episodes, &who.episode)?;
    let (length, _) = episodes[episode];
    if step.is_some_and(|step| step < 0 || step >= length) {
        bail!("the episode has {length} steps, from 0 to {}", length - 1);
    }
    Ok(RemarkRow {
        episode_id: episode.clone(),
        author: author(&who.author)?,
        kind: kind.to_owned(),
        text: text.to_owned(),
        step,
        at_ms: now_ms(),
    })
}

/// Adds a remark; one that is there already stays as it is.
fn keep(
    store: &str,
    who: &Who,
    kind: &str,
    text: &str,
    step: Option<i32>,
) -> anyhow::Result<ExitStatus> {
    let new = remark(store, who, kind, text, step)?;
    Store::open(store)?.change_remarks(|mut before| {
        if !before.iter().any(|other| is_same(other, &new)) {
            before.push(new.clone());
        }
        before
    })?;
    println!("{kind} kept");
    Ok(ExitStatus::Success)
}

fn remove(
    store: &str,
    who: &Who,
    kind: &str,
    text: &str,
    step: Option<i32>,
) -> anyhow::Result<ExitStatus> {
    let old = remark(store, who, kind, text, step)?;
    let mut store = Store::open(store)?;
    if !store.remarks()?.iter().any(|other| is_same(other, &old)) {
        bail!(
            "{} has made no such {kind} on episode {}; `reel store remark list` shows all",
            old.author,
            old.episode_id
        );
    }
    store.change_remarks(|mut before| {
        before.retain(|other| !is_same(other, &old));
        before
    })?;
    println!("{kind} removed");
    Ok(ExitStatus::Success)
}
