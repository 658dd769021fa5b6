//! `reel store remark`: stars, tags and comments of people on episodes.

use anyhow::bail;
use reel_tables::{RemarkRow, Store};

use super::label::{author, check_step, episodes, now_ms, the_episode};
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
pub fn run(arguments: &Arguments, store: &str, json: bool) -> anyhow::Result<ExitStatus> {
    match &arguments.what {
        Command::Star(who) => keep(store, who.remark(store, "star", "", None)?),
        Command::Tag { who, tag } => {
            let tag = tag.trim();
            if tag.is_empty() || tag.chars().count() > TAG_CHARACTERS || tag.contains(',') {
                bail!("a tag has 1 to {TAG_CHARACTERS} characters and no comma");
            }
            if tag == "none" {
                bail!("lists call episodes without a tag 'none': take another word");
            }
            keep(store, who.remark(store, "tag", tag, None)?)
        }
        Command::Comment { who, text, step } => {
            let text = text.trim();
            if text.is_empty() || text.chars().count() > COMMENT_CHARACTERS {
                bail!("a comment has 1 to {COMMENT_CHARACTERS} characters");
            }
            keep(store, who.remark(store, "comment", text, *step)?)
        }
        Command::Remove {
            who,
            kind,
            text,
            step,
        } => take_back(store, who.remark(store, kind, text.trim(), *step)?),
        Command::List => {
            let remarks = Store::open(store)?.remarks()?;
            if json {
                println!("{}", serde_json::to_string_pretty(&remarks)?);
                return Ok(ExitStatus::Success);
            }
            for remark in remarks {
                let step = remark.step.map(|step| format!(" at {step}"));
                println!(
                    "{}  {:7} {:12} {}{}",
                    remark.episode_id,
                    remark.kind,
                    remark.author,
                    remark.text,
                    step.unwrap_or_default()
                );
            }
            Ok(ExitStatus::Success)
        }
    }
}

impl Who {
    /// A remark on the episode, made now.
    fn remark(
        &self,
        store: &str,
        kind: &str,
        text: &str,
        step: Option<i32>,
    ) -> anyhow::Result<RemarkRow> {
        let episodes = episodes(store)?;
        let episode = the_episode(&episodes, &self.episode)?;
        let (length, _) = episodes[episode];
        check_step(step, length)?;
        Ok(RemarkRow {
            episode_id: episode.clone(),
            author: author(&self.author)?,
            kind: kind.to_owned(),
            text: text.to_owned(),
            step,
            at_ms: now_ms(),
        })
    }
}

/// Whether two remarks are the same, whenever they were made.
fn is_same(one: &RemarkRow, other: &RemarkRow) -> bool {
    let at_ms = one.at_ms;
    *one == RemarkRow {
        at_ms,
        ..other.clone()
    }
}

/// Adds a remark; one that is there already stays as it is.
fn keep(store: &str, remark: RemarkRow) -> anyhow::Result<ExitStatus> {
    Store::open(store)?.change_remarks(|mut before| {
        if !before.iter().any(|other| is_same(other, &remark)) {
            before.push(remark.clone());
        }
        before
    })?;
    println!("{} kept", remark.kind);
    Ok(ExitStatus::Success)
}

fn take_back(store: &str, remark: RemarkRow) -> anyhow::Result<ExitStatus> {
    let mut store = Store::open(store)?;
    if !store.remarks()?.iter().any(|other| is_same(other, &remark)) {
        bail!(
            "{} has made no such {} on episode {}; `reel store remark list` shows all",
            remark.author,
            remark.kind,
            remark.episode_id
        );
    }
    store.change_remarks(|mut before| {
        before.retain(|other| !is_same(other, &remark));
        before
    })?;
    println!("{} removed", remark.kind);
    Ok(ExitStatus::Success)
}
