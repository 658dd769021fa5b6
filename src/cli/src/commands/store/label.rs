//! `reel store label`: what people say about failed episodes, beside what the rules say, and about
//! answers of the user.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Context, bail};
use reel_query::{Format, QuerySession, format};
use reel_tables::{AnswerLabelRow, LabelRow, Store};
use reel_taxonomy::{
    CLASSES, Defaults, RuleSet, disputed, from_csv, from_json, injected, stored_classes, to_csv,
    to_json,
};

use crate::{ExitStatus, inputs};

/// Keep labels of failed episodes: who says that it is of which class, and how sure. The rules
/// never read them; `reel taxonomy agreement` compares the two.
///
/// Examples:
///   reel store label set 3f2a91c0 --sub-class missing_ask --step 4 --author ann --store store
///   reel store label import labels.csv --author ann --store store
///   reel store label import traces --store store        # labels that `reel agent faults` left beside its traces
///   reel store label disputed --store store
///   reel store label answer 3f2a91c0 --step 2 --as unclear --author ann --store store
///   reel store label set 3f2a91c0 --sub-class wrong_attribute --author cem --adjudicate --store store
///   reel store label export --out labels.csv --store store
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Label one episode of the store
    Set(Set),
    /// Remove the labels of an episode by one author
    Remove {
        /// The episode's id; its beginning is enough where it is unique
        #[arg(value_name = "EPISODE")]
        episode: String,
        /// Name of the author of the label
        #[arg(long, value_name = "NAME")]
        author: String,
    },
    /// Label an answer of the user to `ask`: faithful to what the user wants and enough to go on
    /// (faithful), wrong (unfaithful), or not enough to tell (unclear)
    Answer(Answer),
    /// List every label of an answer
    Answers,
    /// Read labels: CSV, JSON, or a folder with the `.label.json` files of injected faults
    Import {
        /// The file or folder
        #[arg(value_name = "PATH")]
        path: PathBuf,
        /// Author of labels that name none
        #[arg(long, value_name = "NAME", default_value = "unknown")]
        author: String,
    },
    /// Write the labels: CSV, or JSON where the name ends so
    Export {
        /// The file; without it CSV on standard output
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// List every label of the store
    List,
    /// List the episodes on whose class people disagree and nobody has decided
    Disputed,
}

#[derive(clap::Args)]
struct Set {
    /// The episode's id; its beginning is enough where it is unique
    #[arg(value_name = "EPISODE")]
    episode: String,
    /// Object Confusion, Key Action Missing, Lost Memory or Other; follows from a known sub-class
    #[arg(long, value_name = "CLASS")]
    class: Option<String>,
    /// What within the class (`reel taxonomy rules` lists them; others are possible)
    #[arg(long, value_name = "NAME")]
    sub_class: Option<String>,
    /// Decisive step of the episode, counted from 0
    #[arg(long, value_name = "STEP")]
    step: Option<i32>,
    /// How sure, from 0 to 1
    #[arg(long, value_name = "SHARE")]
    confidence: Option<f64>,
    /// Reason for the label, as free text
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
    /// Name of the author of the label
    #[arg(long, value_name = "NAME")]
    author: String,
    /// Mark the label as the decision between disagreeing authors
    #[arg(long)]
    adjudicate: bool,
    /// The author answered before seeing what the rules and `reel blame` say (`--blind=false`: after);
    /// left out, it is unknown
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    blind: Option<bool>,
}

#[derive(clap::Args)]
struct Answer {
    /// The episode's id; its beginning is enough where it is unique
    #[arg(value_name = "EPISODE")]
    episode: String,
    /// The `ask` that was answered, counted from 0
    #[arg(long, value_name = "STEP")]
    step: i32,
    /// What the answer is
    #[arg(long = "as", value_name = "LABEL", value_parser = ["faithful", "unfaithful", "unclear"])]
    label: String,
    /// Reason for the label, as free text
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
    /// Name of the author of the label
    #[arg(long, value_name = "NAME")]
    author: String,
}

/// Adds, imports, exports or lists labels, or lists disputed episodes.
pub fn run(arguments: &Arguments, store: &str, json: bool) -> anyhow::Result<ExitStatus> {
    let now_ms = now_ms();
    match &arguments.what {
        Command::Set(set) => keep(store, vec![labelled(store, set, now_ms)?]),
        Command::Remove { episode, author } => remove(store, episode, author),
        Command::Answer(answer) => keep_answer(store, answer, now_ms),
        Command::Answers => {
            let labels = Store::open(store)?.answer_labels()?;
            let lines = labels.iter().map(|label| {
                let note = label.note.iter().map(|note| format!(": {note}"));
                format!(
                    "{}  step {:3} {:12} {}{}\n",
                    label.episode_id,
                    label.step,
                    label.author,
                    label.label,
                    note.collect::<String>()
                )
            });
            let text = if json {
                serde_json::to_string_pretty(&labels)? + "\n"
            } else {
                lines.collect()
            };
            print!("{text}");
            Ok(ExitStatus::Success)
        }
        Command::Import { path, author } => {
            let labels = read(
                path,
                Defaults {
                    author,
                    at_ms: now_ms,
                    own_classes: &own_classes(store)?.into_values().collect(),
                },
            )?;
            known_episodes(store, labels)
        }
        Command::Export { out } => export(store, out.as_deref()),
        Command::List => {
            let labels = Store::open(store)?.labels()?;
            print!(
                "{}",
                if json {
                    to_json(&labels)
                } else {
                    lines(labels.iter())
                }
            );
            Ok(ExitStatus::Success)
        }
        Command::Disputed => {
            let open = disputed(&Store::open(store)?.labels()?);
            for labels in open.values() {
                print!(
                    "{}",
                    if json {
                        to_json(labels)
                    } else {
                        lines(labels.iter())
                    }
                );
            }
            if !json {
                println!(
                    "{} episodes are disputed; decide with `reel store label set EPISODE ... --adjudicate`",
                    open.len()
                );
            }
            Ok(if open.is_empty() {
                ExitStatus::Success
            } else {
                ExitStatus::CheckFailed
            })
        }
    }
}

/// The time of this moment, in milliseconds since 1970.
pub(super) fn now_ms() -> i64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |time| time.as_millis() as i64)
}

fn lines<'a>(labels: impl Iterator<Item = &'a LabelRow>) -> String {
    let line = |label: &LabelRow| {
        let step = label
            .step
            .map(|step| format!(" at {step}"))
            .unwrap_or_default();
        let sure = label
            .confidence
            .map(|sure| format!(" ({sure})"))
            .unwrap_or_default();
        let note = label
            .note
            .as_deref()
            .map(|note| format!(": {note}"))
            .unwrap_or_default();
        let sub_class = label.sub_class.as_deref().unwrap_or("-");
        format!(
            "{}  {:11} {:12} {} / {sub_class}{step}{sure}{note}\n",
            label.episode_id, label.kind, label.author, label.class
        )
    };
    labels.map(line).collect()
}

fn labelled(store: &str, set: &Set, at_ms: i64) -> anyhow::Result<LabelRow> {
    let own = own_classes(store)?;
    let built_in = RuleSet::built_in();
    let of_sub_class = set.sub_class.as_ref().and_then(|name| {
        let class = built_in.class_of(name);
        class.or_else(|| own.get(name).map(String::as_str))
    });
    let names: BTreeSet<&str> = own.values().map(String::as_str).collect();
    let known: Vec<&str> = CLASSES.into_iter().chain(names).collect();
    let class = match (&set.class, of_sub_class) {
        (Some(class), _) if known.contains(&class.as_str()) => class.clone(),
        (Some(class), _) => bail!("the class '{class}' is none of {}", known.join(", ")),
        (None, Some(class)) => class.to_owned(),
        (None, None) => bail!("give --class: one of {}", known.join(", ")),
    };
    if set
        .confidence
        .is_some_and(|sure| !(0.0..=1.0).contains(&sure))
    {
        bail!("the confidence has to lie between 0 and 1");
    }
    let episodes = episodes(store)?;
    let episode = the_episode(&episodes, &set.episode)?;
    let (length, success) = episodes[episode];
    if success {
        eprintln!("reel: note: episode {episode} succeeded; the label says why it failed");
    }
    check_step(set.step, length)?;
    Ok(LabelRow {
        episode_id: episode.clone(),
        author: author(&set.author)?,
        kind: if set.adjudicate {
            "adjudicated"
        } else {
            "human"
        }
        .to_owned(),
        class,
        sub_class: set.sub_class.clone(),
        step: set.step,
        confidence: set.confidence,
        note: set.note.clone(),
        at_ms,
        blind: set.blind,
    })
}

/// The classes of a taxonomy of one's own with which episodes of the store are classified, by sub-class.
fn own_classes(store: &str) -> anyhow::Result<BTreeMap<String, String>> {
    let session = QuerySession::new(inputs::store(store, None)?)?;
    let classes = stored_classes(&session)?.into_iter();
    let own = classes.filter(|episode| !CLASSES.contains(&episode.class.as_str()));
    Ok(own
        .map(|episode| (episode.sub_class, episode.class))
        .collect())
}

/// Refuses a step that an episode of this length does not have.
pub(super) fn check_step(step: Option<i32>, length: i32) -> anyhow::Result<()> {
    if step.is_some_and(|step| step < 0 || step >= length) {
        bail!("the episode has {length} steps, from 0 to {}", length - 1);
    }
    Ok(())
}

/// Removes an author's labels of an episode, one that adjudicates too.
fn remove(store: &str, episode: &str, author: &str) -> anyhow::Result<ExitStatus> {
    let mut store = Store::open(store)?;
    let of_author = |label: &&LabelRow| label.author == author.trim();
    let labelled: BTreeMap<String, ()> = store
        .labels()?
        .iter()
        .filter(of_author)
        .map(|label| (label.episode_id.clone(), ()))
        .collect();
    let episode = the_episode(&labelled, episode)
        .with_context(|| format!("{author} has labelled no such episode"))?;
    store.change_labels(|mut before| {
        before.retain(|label| label.episode_id != *episode || !of_author(&label));
        before
    })?;
    println!("label removed");
    Ok(ExitStatus::Success)
}

/// The name of an author, which is not blank.
pub(super) fn author(name: &str) -> anyhow::Result<String> {
    let name = name.trim();
    if name.is_empty() {
        bail!("--author needs a name");
    }
    Ok(name.to_owned())
}

/// The one episode whose id begins so.
pub(super) fn the_episode<'a, T>(
    episodes: &'a BTreeMap<String, T>,
    id: &str,
) -> anyhow::Result<&'a String> {
    let fitting: Vec<&String> = episodes.keys().filter(|it| it.starts_with(id)).collect();
    match fitting[..] {
        [episode] => Ok(episode),
        _ => bail!(
            "{} episodes have an id that begins with '{id}'; give one that only one has",
            fitting.len()
        ),
    }
}

/// Keeps what an author says about an answer; of one author the last word counts.
fn keep_answer(store: &str, answer: &Answer, at_ms: i64) -> anyhow::Result<ExitStatus> {
    let known = episodes(store)?;
    let episode = the_episode(&known, &answer.episode)?;
    let session = QuerySession::new(inputs::store(store, None)?)?;
    let answered = format!(
        "SELECT 1 FROM steps WHERE episode_id = '{episode}' AND step = {} AND reply IS NOT NULL",
        answer.step
    );
    if session
        .run(&answered)?
        .iter()
        .all(|batch| batch.num_rows() == 0)
    {
        bail!(
            "episode {episode} has no answer to label at step {}",
            answer.step
        );
    }
    let label = AnswerLabelRow {
        episode_id: episode.clone(),
        step: answer.step,
        author: author(&answer.author)?,
        label: answer.label.clone(),
        note: answer.note.clone(),
        at_ms,
    };
    Store::open(store)?.change_answer_labels(|mut before| {
        let of = |it: &AnswerLabelRow| (it.episode_id.clone(), it.step, it.author.clone());
        before.retain(|other| of(other) != of(&label));
        before.push(label.clone());
        before
    })?;
    println!("label kept");
    Ok(ExitStatus::Success)
}

/// The episodes of a store with the number of their steps, and whether they succeeded.
pub(super) fn episodes(store: &str) -> anyhow::Result<BTreeMap<String, (i32, bool)>> {
    let session = QuerySession::new(inputs::store(store, None)?)?;
    let text = format(
        &session.run(
            "SELECT episode_id, array_length(steps), coalesce(success, false) FROM episodes",
        )?,
        Format::Csv,
    )?;
    let row = |line: &str| {
        let mut cells = line.rsplitn(3, ',');
        let (success, length) = (cells.next()? == "true", cells.next()?.parse().unwrap_or(0));
        Some((cells.next()?.to_owned(), (length, success)))
    };
    Ok(text.lines().skip(1).filter_map(row).collect())
}

fn read(path: &Path, defaults: Defaults<'_>) -> anyhow::Result<Vec<LabelRow>> {
    let text = |path: &Path| {
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
    };
    if !path.is_dir() {
        let (content, place) = (text(path)?, path.display().to_string());
        let is_json = path
            .extension()
            .is_some_and(|extension| extension == "json" || extension == "jsonl");
        return Ok(if is_json {
            from_json(&content, &place, defaults)?
        } else {
            from_csv(&content, &place, defaults)?
        });
    }
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in fs::read_dir(path).with_context(|| format!("cannot read {}", path.display()))? {
        files.push(entry?.path());
    }
    files.retain(|file| file.to_string_lossy().ends_with(".label.json"));
    files.sort();
    if files.is_empty() {
        bail!(
            "no .label.json file there; `reel agent faults run` writes them beside its traces: {}",
            path.display()
        );
    }
    let mut labels = Vec::new();
    for file in files {
        labels.extend(injected(
            &text(&file)?,
            &file.display().to_string(),
            defaults.at_ms,
        )?);
    }
    Ok(labels)
}

/// Keeps labels of episodes that the store has, and says which it does not have.
fn known_episodes(store: &str, labels: Vec<LabelRow>) -> anyhow::Result<ExitStatus> {
    let episodes = episodes(store)?;
    let (known, unknown): (Vec<LabelRow>, Vec<LabelRow>) = labels
        .into_iter()
        .partition(|label| episodes.contains_key(&label.episode_id));
    for label in unknown.iter().take(5) {
        eprintln!("reel: not in the store, left out: {}", label.episode_id);
    }
    let answer = keep(store, known)?;
    if unknown.is_empty() {
        return Ok(answer);
    }
    eprintln!(
        "reel: {} labels are of episodes that the store does not have",
        unknown.len()
    );
    Ok(ExitStatus::Partial)
}

fn keep(store: &str, labels: Vec<LabelRow>) -> anyhow::Result<ExitStatus> {
    let count = labels.len();
    // of one author about one episode the last word counts
    let of = |label: &LabelRow| {
        (
            label.episode_id.clone(),
            label.author.clone(),
            label.kind.clone(),
        )
    };
    let said: BTreeSet<_> = labels.iter().map(of).collect();
    Store::open(store)?.change_labels(|mut before| {
        before.retain(|label| !said.contains(&of(label)));
        before.extend(labels.iter().cloned());
        before
    })?;
    println!("{count} labels kept");
    Ok(ExitStatus::Success)
}

fn export(store: &str, out: Option<&Path>) -> anyhow::Result<ExitStatus> {
    let labels = Store::open(store)?.labels()?;
    let as_json = out
        .and_then(Path::extension)
        .is_some_and(|extension| extension == "json" || extension == "jsonl");
    let text = if as_json {
        to_json(&labels)
    } else {
        to_csv(&labels)
    };
    match out {
        Some(file) => {
            fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))?
        }
        None => print!("{text}"),
    }
    Ok(ExitStatus::Success)
}
