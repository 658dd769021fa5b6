//! `reel publish`: a dataset to a folder or to the Hugging Face Hub.

use std::{
    env,
    path::{Path, PathBuf},
    thread,
};

use anyhow::bail;
use reel_dataset::lint::{CheckReport, Dataset, LintOptions, Severity};
use reel_publish::{
    Check, CommitOptions, DatasetKind, FileStatus, Hub, MAIN, Plan, Publication, PublishedCommit,
    RepositoryId, Target, existing_files, is_branch_name, printable_path, publish_to_folder,
};
use reel_world::printable_line;
use serde_json::{Value, json};

use crate::{ExitStatus, progress};

/// Files that are listed for people; `--json` has all.
const FILES_SHOWN: usize = 30;

/// Check a dataset, show what would be published, and with --execute publish it: as a folder, or
/// to a dataset repository of the Hugging Face Hub, where the viewer and `load_dataset` read it.
/// DIR is the folder of `reel export sft`, `rl`, `preferences` or `lerobot`, or a LeRobot dataset
/// of version 3 of any origin. Only what is new or changed is written.
///
/// Nothing is published with a wrong checksum, a token or key in any file, no license, errors of
/// `reel dataset lint`, paths of this machine, unverified traces, or a task in two splits; --allow
/// takes the last four.
///
/// Examples:
///   reel publish sft --to published                # what would be written, and what is wrong
///   reel publish sft --to published --execute
///   reel publish sft --to OWNER/NAME --private --execute
///   reel publish sft --to hf://datasets/OWNER/NAME --create-pr --message 'More homes' --execute
///
/// The token of the Hub comes from HF_TOKEN or `hf auth login`, its address from HF_ENDPOINT. Broken
/// off, the same command sends what is missing.
///
/// Exit code 1: something is wrong with the dataset; nothing was published.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the dataset
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Where it goes: a folder, or OWNER/NAME or hf://datasets/OWNER/NAME on the Hub
    #[arg(long, value_name = "TARGET")]
    to: String,
    /// Publish; without it nothing is written
    #[arg(long)]
    execute: bool,
    /// Branch of the repository; it is made if it is not there [default: main]
    #[arg(long, value_name = "BRANCH", value_parser = branch)]
    revision: Option<String>,
    /// Make the repository visible to its owner only, if it is not there yet
    #[arg(long)]
    private: bool,
    /// First line of the commit's message
    #[arg(long, value_name = "TEXT")]
    message: Option<String>,
    /// Propose the change as a pull request instead of committing to the branch
    #[arg(long)]
    create_pr: bool,
    /// Delete the files that only the target has
    #[arg(long)]
    delete: bool,
    /// Publish in spite of these findings: lint, local-paths, splits, unverified
    #[arg(long, value_name = "CHECKS", value_delimiter = ',', value_parser = allowed)]
    allow: Vec<Check>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// What is to be done to the target, and what was.
struct Report<'r> {
    arguments: &'r Arguments,
    target: String,
    publication: &'r Publication,
    plan: &'r Plan,
    notes: Vec<String>,
    executed: bool,
    done: PublishedCommit,
}

/// Checks a dataset and publishes it if the arguments say so.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let target = Target::parse(&arguments.to, Path::exists)?;
    let for_hub = [
        ("--revision", arguments.revision.is_some()),
        ("--private", arguments.private),
        ("--message", arguments.message.is_some()),
        ("--create-pr", arguments.create_pr),
    ];
    if let (Target::Folder(_), Some((option, _))) =
        (&target, for_hub.iter().find(|(_, given)| *given))
    {
        bail!("{option} is for the Hub, and --to names a folder; leave it out");
    }
    let mut publication = open(&arguments.folder)?;
    match target {
        Target::Folder(path) => arguments.to_folder(&publication, &path),
        Target::Hub(id) => arguments.to_hub(&mut publication, &id),
    }
}

impl Arguments {
    fn to_folder(&self, publication: &Publication, path: &Path) -> anyhow::Result<ExitStatus> {
        let plan = Plan::new(publication.files(), &existing_files(&self.folder, path)?);
        let mut executed = false;
        if self.may_execute(publication) && !plan.is_done(self.delete) {
            let spinner = progress::spinner();
            spinner.set_message("bytes written");
            let written = |bytes| spinner.set_position(bytes);
            let result = publish_to_folder(publication, &plan, path, self.delete, written);
            spinner.finish_and_clear();
            result?;
            executed = true;
        }
        self.tell(&Report {
            arguments: self,
            target: printable_line(&path.display().to_string()),
            publication,
            plan: &plan,
            notes: Vec::new(),
            executed,
            done: PublishedCommit::default(),
        })
    }

    fn to_hub(
        &self,
        publication: &mut Publication,
        id: &RepositoryId,
    ) -> anyhow::Result<ExitStatus> {
        let hub = Hub::from_environment(&|name| env::var_os(name), Box::new(thread::sleep))?;
        let branch = self.revision.as_deref().unwrap_or(MAIN);
        let mut notes = Vec::new();
        let user = hub.user()?;
        notes.push(match &user {
            Some(user) => format!("as {user}"),
            None => "without a token: set HF_TOKEN to publish".to_owned(),
        });
        let repository = hub.repository(id)?;
        if self.private && repository.as_ref().is_some_and(|it| !it.private) {
            bail!("{id} is public, and --private is given; make it private on the Hub first");
        }
        let mut tree = match &repository {
            Some(_) => hub.tree(id, branch)?,
            None => Default::default(),
        };
        if repository.is_none() {
            let kind = if self.private { "private" } else { "public" };
            notes.push(format!("the repository is new and will be {kind}"));
        } else if tree.commit.is_none() {
            notes.push(format!("the branch {branch} is new"));
        }
        self.validate(&hub, publication, &mut notes)?;
        let mut plan = Plan::new(publication.files(), &tree.files);
        let (mut executed, mut done) = (false, PublishedCommit::default());
        if self.may_execute(publication) && !plan.is_done(self.delete) {
            if user.is_none() {
                bail!("set HF_TOKEN to a token with write access, or run `hf auth login`");
            }
            if repository.is_none() {
                hub.create(id, self.private)?;
            }
            if tree.commit.is_none() {
                tree = hub.tree(id, branch)?;
                if tree.commit.is_none() {
                    hub.create_branch(id, branch)?;
                    tree = hub.tree(id, branch)?;
                }
                // a new repository has files of the Hub's own
                plan = Plan::new(publication.files(), &tree.files);
            }
            done = self.commit(&hub, id, publication, (&plan, &tree))?;
            executed = true;
        }
        self.tell(&Report {
            arguments: self,
            target: format!("hf://datasets/{id}@{branch}"),
            publication,
            plan: &plan,
            notes,
            executed,
            done,
        })
    }

    /// Asks the Hub whether it takes the card.
    fn validate(
        &self,
        hub: &Hub,
        publication: &mut Publication,
        notes: &mut Vec<String>,
    ) -> anyhow::Result<()> {
        let Some(card) = publication.card() else {
            return Ok(());
        };
        match hub.validate_card(card)? {
            None => notes.push("the Hub did not check the card".to_owned()),
            Some(errors) => {
                for error in errors {
                    let problems = publication.problems_mut();
                    problems.add(Check::Card, reel_dataset::CARD, None, &error);
                }
            }
        }
        Ok(())
    }

    fn commit(
        &self,
        hub: &Hub,
        id: &RepositoryId,
        publication: &Publication,
        (plan, tree): (&Plan, &reel_publish::RepositoryTree),
    ) -> anyhow::Result<PublishedCommit> {
        let version = env!("CARGO_PKG_VERSION");
        let message = self.message.clone();
        let options = CommitOptions {
            branch: self.revision.as_deref().unwrap_or(MAIN).to_owned(),
            message: message.unwrap_or_else(|| format!("Publish with reel {version}")),
            create_pr: self.create_pr,
            delete: self.delete,
        };
        let spinner = progress::spinner();
        spinner.set_message("bytes of large files sent");
        let sent = |bytes| spinner.inc(bytes);
        let done = hub.publish(id, publication, (plan, tree), &options, &sent);
        spinner.finish_and_clear();
        Ok(done?)
    }

    fn may_execute(&self, publication: &Publication) -> bool {
        self.execute && !publication.problems().forbid(&self.allow)
    }

    fn tell(&self, report: &Report<'_>) -> anyhow::Result<ExitStatus> {
        if self.json {
            println!("{}", report.json());
        } else {
            report.print();
        }
        Ok(if report.publication.problems().forbid(&self.allow) {
            ExitStatus::CheckFailed
        } else {
            ExitStatus::Success
        })
    }
}

impl Report<'_> {
    fn json(&self) -> Value {
        let problems = self.publication.problems();
        let notes = [self.publication.notes(), &self.notes[..]].concat();
        let counts = problems.counts().iter();
        let counts = counts.map(|(check, count)| (check.as_str().to_owned(), json!(count)));
        json!({
            "dataset": self.publication.dataset_kind(), "target": self.target, "executed": self.executed,
            "files": self.plan.files, "only_at_target": self.plan.only_at_target,
            "deletes": self.arguments.delete,
            "new": self.plan.count(FileStatus::New), "changed": self.plan.count(FileStatus::Changed),
            "equal": self.plan.count(FileStatus::Equal), "bytes": self.plan.bytes(),
            "bytes_to_write": self.plan.bytes_to_write(), "card_head": self.publication.card_head(),
            "problems": problems.kept_problems(),
            "problem_counts": counts.collect::<serde_json::Map<String, Value>>(),
            "notes": notes,
            "commit": self.done.commit, "commits": self.done.commits, "url": self.done.url,
        })
    }

    fn print(&self) {
        let plan = self.plan;
        let from = printable_line(&self.arguments.folder.display().to_string());
        println!("{from} -> {}", self.target);
        let mut files: Vec<_> = plan.files.iter().collect();
        files.sort_by_key(|file| (file.status, &file.path));
        for file in files.iter().take(FILES_SHOWN) {
            let (status, size) = (file.status.as_str(), size(file.bytes));
            println!("  {status:8} {size:>9}  {}", printable_path(&file.path));
        }
        if files.len() > FILES_SHOWN {
            println!(
                "  ... and {} more (--json has all)",
                files.len() - FILES_SHOWN
            );
        }
        for path in plan.only_at_target.iter().take(FILES_SHOWN) {
            let what = if self.arguments.delete {
                "delete"
            } else {
                "stays"
            };
            println!("  {what:8} {:>9}  {}", "", printable_path(path));
        }
        println!(
            "{} files, {}: {} new, {} changed, {} equal; {} to write",
            plan.files.len(),
            size(plan.bytes()),
            plan.count(FileStatus::New),
            plan.count(FileStatus::Changed),
            plan.count(FileStatus::Equal),
            size(plan.bytes_to_write())
        );
        println!("card:");
        for line in self.publication.card_head() {
            println!("  {line}");
        }
        for note in self.publication.notes().iter().chain(&self.notes) {
            println!("note: {note}");
        }
        self.print_problems();
        self.print_end();
    }

    fn print_problems(&self) {
        let problems = self.publication.problems();
        for problem in problems.kept_problems() {
            let allowed = self.arguments.allow.contains(&problem.check);
            let word = if allowed { "allowed" } else { "problem" };
            println!("{word}: {problem}");
        }
        for (check, count) in problems.counts() {
            let shown = problems.kept_problems();
            let shown = shown.iter().filter(|problem| problem.check == *check);
            let hidden = count.saturating_sub(shown.count() as u64);
            if hidden > 0 {
                println!("  {}: {hidden} more", check.as_str());
            }
        }
    }

    fn print_end(&self) {
        let refused = self.publication.problems().forbid(&self.arguments.allow);
        match (&self.done.commit, &self.done.url) {
            _ if refused => println!("not published: solve the problems first"),
            (Some(commit), Some(url)) => println!("published: commit {commit}, {url}"),
            (Some(commit), None) => println!("published: commit {commit}"),
            _ if self.executed => println!("published"),
            _ if self.plan.is_done(self.arguments.delete) => {
                println!("nothing to do: the target has all of it");
            }
            _ => println!("nothing was written: this was a dry run, --execute publishes"),
        }
    }
}

/// Reads and checks a folder, the lint included.
fn open(folder: &Path) -> anyhow::Result<Publication> {
    let spinner = progress::spinner();
    spinner.set_message("bytes read");
    let publication = Publication::open(folder, |bytes| spinner.set_position(bytes));
    spinner.finish_and_clear();
    let mut publication = publication?;
    if !publication.problems().counts().contains_key(&Check::Files) {
        lint(folder, &mut publication);
    }
    Ok(publication)
}

/// Adds the errors of `reel dataset lint`, which reads no preference pairs.
fn lint(folder: &Path, publication: &mut Publication) {
    let spinner = progress::spinner();
    spinner.set_message("rows checked");
    let rows = |rows| spinner.set_position(rows);
    let checks: Result<Vec<CheckReport>, String> = match publication.dataset_kind() {
        DatasetKind::Preferences => Ok(Vec::new()),
        DatasetKind::LeRobot => reel_lerobot::lint::lint(folder, 3, rows)
            .map(|report| report.checks)
            .map_err(|error| error.to_string()),
        DatasetKind::Export => Dataset::open(&[folder.to_owned()], None, None)
            .map(|set| reel_dataset::lint::lint(&set, &LintOptions::default(), rows).checks)
            .map_err(|error| error.to_string()),
    };
    spinner.finish_and_clear();
    let problems = publication.problems_mut();
    let checks = match checks {
        Ok(checks) => checks,
        Err(error) => {
            problems.add(Check::Lint, "", None, &error);
            return;
        }
    };
    for report in checks {
        let check = match report.check {
            "splits" => Check::Splits,
            _ => Check::Lint,
        };
        let errors = report.examples.iter();
        for finding in errors.filter(|finding| finding.severity == Severity::Error) {
            let place = finding.examples.first();
            let file = place.map_or("", |place| {
                let file = Path::new(&place.file);
                let inside = file.strip_prefix(folder).unwrap_or(file);
                inside.to_str().unwrap_or(&place.file)
            });
            let line = place.map(|place| u64::from(place.line));
            let message = format!("{}: {}", report.check, finding.message);
            problems.add(check, file, line, &message);
        }
    }
}

fn allowed(name: &str) -> Result<Check, String> {
    let known = Check::ALL.iter().filter(|check| check.may_be_allowed());
    let known: Vec<&str> = known.map(|check| check.as_str()).collect();
    Check::parse_allowed(name).ok_or_else(|| format!("known are {}", known.join(", ")))
}

fn branch(name: &str) -> Result<String, String> {
    if is_branch_name(name) {
        Ok(name.to_owned())
    } else {
        Err("no name of a branch: letters, digits, '-', '_', '.' and '/'".to_owned())
    }
}

/// A number of bytes for people.
fn size(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}
