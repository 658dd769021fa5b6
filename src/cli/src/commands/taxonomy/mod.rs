//! `reel taxonomy`: why episodes fail, by the rules; how often the rules are right; what changed.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_query::{Format, Limits, QuerySession, format};
use reel_tables::Store;
use reel_taxonomy::{
    RuleSet, StoredClass, classify, drift,
    sankey::{Flow, Sankey},
    stored_classes,
};
use serde_json::json;

use crate::{ExitStatus, cluster_arguments::ClusterArguments, inputs, progress};

mod agreement;
mod clusters;
pub mod judge;

/// Say why every failed episode of a store failed: its class (paper, Failure Mode Taxonomy), what
/// within it, the decisive step and the evidence. The rules are SQL, one file each (`reel taxonomy
/// rules`), and see the recorded episodes only, never a label. The result is kept in table
/// `classes`; where `reel blame --store` measured the decisive step before, with that one.
///
/// Examples:
///   reel taxonomy --store store
///   reel taxonomy --store store --sankey failures.svg
///   reel query --store store "SELECT * FROM classes WHERE sub_class = 'missing_ask'"
///   reel taxonomy agreement --store store --reference agreed
///   reel taxonomy clusters --store store --propose my-rules
///   reel taxonomy drift --store store --before "policy = 'old'" --after "policy = 'new'"
#[derive(clap::Args)]
#[command(verbatim_doc_comment, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    #[command(subcommand)]
    what: Option<Command>,
    #[command(flatten)]
    classify: Classify,
}

#[derive(clap::Subcommand)]
enum Command {
    /// List the rules: priority, class, sub-class, and what each says
    Rules(Rules),
    /// Compare the classes with labels: precision, recall, F1, Cohen's
    /// kappa, confusion matrix, disagreements
    Agreement(agreement::Arguments),
    /// Compare two sets of episodes: which classes grew, and whether more than chance explains
    Drift(Drift),
    #[command(about = "Group the failures that no rule explains, and draft a rule for each group")]
    Clusters(clusters::Arguments),
    #[command(
        about = "Ask a model behind an OpenAI-compatible endpoint for its opinion on failed episodes"
    )]
    Judge(judge::Arguments),
}

#[derive(clap::Args)]
struct Classify {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    in_cluster: ClusterArguments,
    /// Folder with rule files of your own, beside those that come with Reel
    #[arg(long, value_name = "DIR")]
    rules: Option<PathBuf>,
    /// Only episodes that fulfil this condition in SQL; keeps nothing
    #[arg(long = "where", value_name = "SQL")]
    condition: Option<String>,
    /// Classify and print, but leave the store unchanged
    #[arg(long)]
    dry_run: bool,
    /// Draw family, class and sub-class as a Sankey diagram: FILE.svg or FILE.png;
    /// may be given twice
    #[arg(long, value_name = "FILE")]
    sankey: Vec<PathBuf>,
    /// Print JSON, one line an episode
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct Rules {
    /// Folder with rule files of your own, beside those that come with Reel
    #[arg(long, value_name = "DIR")]
    rules: Option<PathBuf>,
    /// Print each rule as one line of JSON
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct Drift {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// The episodes before, as a condition in SQL
    #[arg(long, value_name = "SQL")]
    before: String,
    /// The episodes after, as a condition in SQL
    #[arg(long, value_name = "SQL")]
    after: String,
    /// Print the counts and test results as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the given taxonomy subcommand; without one, classifies the failed episodes.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.what {
        None => run_classify(&arguments.classify),
        Some(Command::Rules(rules)) => list_rules(rules),
        Some(Command::Agreement(with)) => agreement::run(with),
        Some(Command::Drift(sets)) => compare_sets(sets),
        Some(Command::Clusters(arguments)) => clusters::run(arguments),
        Some(Command::Judge(arguments)) => judge::run(arguments),
    }
}

/// Classifies the failed episodes of a store, keeps and prints the classes, and draws them.
///
/// # Errors
/// When the store cannot be read or written, or the image cannot be written.
pub fn classify_and_print(store: &str, sankey: PathBuf) -> anyhow::Result<()> {
    let sankey = vec![sankey];
    let in_cluster = ClusterArguments::default();
    let classify = Classify {
        store: store.to_owned(),
        in_cluster,
        rules: None,
        condition: None,
        dry_run: false,
        sankey,
        json: false,
    };
    run_classify(&classify).map(drop)
}

/// The rules that come with Reel, and those of a folder.
fn rule_set(folder: Option<&Path>) -> anyhow::Result<RuleSet> {
    Ok(match folder {
        Some(folder) => RuleSet::with_folder(folder)?,
        None => RuleSet::built_in(),
    })
}

fn list_rules(arguments: &Rules) -> anyhow::Result<ExitStatus> {
    let set = rule_set(arguments.rules.as_deref())?;
    for rule in set.rules() {
        if arguments.json {
            println!("{}", serde_json::to_string(rule)?);
        } else {
            println!(
                "{:3}  {} / {} ({})\n     {}",
                rule.priority, rule.class, rule.sub_class, rule.name, rule.prose
            );
        }
    }
    if !arguments.json {
        println!("version {}", set.version().short());
    }
    Ok(ExitStatus::Success)
}

fn run_classify(arguments: &Classify) -> anyhow::Result<ExitStatus> {
    let set = rule_set(arguments.rules.as_deref())?;
    let spinner = progress::spinner();
    spinner.enable_steady_tick(std::time::Duration::from_millis(100));
    spinner.set_message("asking the rules");
    let session = arguments
        .in_cluster
        .session(inputs::store(&arguments.store, None)?, Limits::default())?;
    let verdicts = classify(&session, &set, arguments.condition.as_deref())?;
    if !arguments.dry_run && arguments.condition.is_none() {
        spinner.set_message(format!("keeping {} classes", verdicts.len()));
        Store::open(&arguments.store)?.replace_classes(|| verdicts.classes())?;
    }
    spinner.finish_and_clear();
    let mut table = Table::default();
    for (class, (family, policy)) in verdicts.classes().zip(verdicts.groups()) {
        if arguments.json {
            println!("{}", serde_json::to_string(&class)?);
        }
        table.count((class.class, class.sub_class), family, policy);
    }
    let condition = arguments.condition.as_deref().unwrap_or("true");
    let (episodes, successes) = how_many(&session, condition)?;
    if !arguments.json {
        print!("{}", table.text(&set.classes()));
        println!(
            "{} failures of {episodes} episodes; rules version {}",
            verdicts.len(),
            set.version().short()
        );
    }
    if !arguments.sankey.is_empty() {
        let flows = table.flows();
        let subtitle = format!(
            "{} | rules version {}",
            arguments.store,
            set.version().short()
        );
        let image = Sankey::new("Why do they fail?", &subtitle, &flows, episodes, successes);
        arguments
            .sankey
            .iter()
            .try_for_each(|file| draw(&image, file))?;
    }
    Ok(ExitStatus::Success)
}

/// Episodes that were played to an end, and how many of them succeeded.
fn how_many(session: &QuerySession, condition: &str) -> anyhow::Result<(u64, u64)> {
    let sql = format!(
        "SELECT count(end_reason), count(*) FILTER (WHERE success) FROM episodes WHERE ({condition})"
    );
    let text = format(&session.run(&sql)?, Format::Csv)?;
    let counted = text.lines().nth(1).and_then(|line| line.split_once(','));
    let (episodes, successes) =
        counted.context("the store does not say how many episodes it has")?;
    Ok((episodes.parse()?, successes.parse()?))
}

fn draw(image: &Sankey, file: &Path) -> anyhow::Result<()> {
    let bytes = match file.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => image.svg().into_bytes(),
        Some("png") => image.png(2.0)?,
        _ => bail!("the name has to end in .svg or .png: {}", file.display()),
    };
    fs::write(file, bytes).with_context(|| format!("cannot write {}", file.display()))
}

/// More policies than this get no columns of their own.
const POLICY_COLUMNS_MAX: usize = 8;

/// Episodes by class and sub-class, and within these by something else.
type Counts<'a> = BTreeMap<(&'a str, &'a str), BTreeMap<&'a str, u64>>;

/// How often each class and sub-class was found, by family and by policy.
#[derive(Default)]
struct Table<'a> {
    by_family: Counts<'a>,
    by_policy: Counts<'a>,
}

impl<'a> Table<'a> {
    fn count(&mut self, class: (&'a str, &'a str), family: &'a str, policy: &'a str) {
        *self
            .by_family
            .entry(class)
            .or_default()
            .entry(family)
            .or_default() += 1;
        *self
            .by_policy
            .entry(class)
            .or_default()
            .entry(policy)
            .or_default() += 1;
    }

    fn flows(&self) -> Vec<Flow> {
        let of_class = |((class, sub_class), families): (&(&str, &str), &BTreeMap<&str, u64>)| {
            let flow = |(family, episodes): (&&str, &u64)| Flow {
                family: (*family).to_owned(),
                class: (*class).to_owned(),
                sub_class: (*sub_class).to_owned(),
                episodes: *episodes,
            };
            families.iter().map(flow).collect::<Vec<_>>()
        };
        self.by_family.iter().flat_map(of_class).collect()
    }

    /// A line a class and sub-class, the families' columns first.
    fn text(&self, classes: &[&str]) -> String {
        let sum = |counts: &BTreeMap<&str, u64>| counts.values().sum::<u64>();
        let failures: u64 = self.by_family.values().map(sum).sum();
        let columns = |of: &Counts<'a>| -> BTreeSet<&'a str> {
            of.values()
                .flat_map(|counts| counts.keys().copied())
                .collect()
        };
        let (families, mut policies) = (columns(&self.by_family), columns(&self.by_policy));
        let hidden = if policies.len() > POLICY_COLUMNS_MAX {
            std::mem::take(&mut policies).len()
        } else {
            0
        };
        let width = |name: &str| name.len().max(5);
        // `classes` are those that the line adds up
        let line = |name: &str, classes: &[(&str, &str)]| {
            let cell = |of: &Counts<'_>, column: &str| {
                let counted = classes
                    .iter()
                    .filter_map(|class| of.get(class)?.get(column))
                    .sum::<u64>();
                format!(" {counted:>0$}", width(column))
            };
            let episodes: u64 = classes
                .iter()
                .filter_map(|class| self.by_family.get(class))
                .map(sum)
                .sum();
            let cells = families.iter().map(|column| cell(&self.by_family, column));
            let cells: String = cells
                .chain(policies.iter().map(|column| cell(&self.by_policy, column)))
                .collect();
            format!(
                "{name:24} {episodes:8} {:6.1}%{cells}\n",
                100.0 * episodes as f64 / failures.max(1) as f64
            )
        };
        let heads: String = families
            .iter()
            .chain(&policies)
            .map(|column| format!(" {column:>0$}", width(column)))
            .collect();
        let mut text = format!("{:24} episodes   share{heads}\n", "");
        for class in classes {
            let mut within: Vec<(&str, &str)> = self
                .by_family
                .keys()
                .filter(|(name, _)| name == class)
                .copied()
                .collect();
            within.sort_by_key(|key| (std::cmp::Reverse(sum(&self.by_family[key])), key.1));
            text += &line(class, &within);
            within
                .iter()
                .for_each(|key| text += &line(&format!("  {}", key.1), &[*key]));
        }
        if hidden > 0 {
            text += &format!(
                "{hidden} policies; by policy: reel query \"SELECT e.policy, c.sub_class, count(*) AS episodes \
                 FROM classes c JOIN episodes e USING (episode_id) GROUP BY ALL ORDER BY ALL\"\n"
            );
        }
        text
    }
}

/// The classes that the store holds.
pub fn classes_of(session: &QuerySession, store: &str) -> anyhow::Result<Vec<StoredClass>> {
    let classes = stored_classes(session)?;
    if classes.is_empty() {
        bail!("no failed episode has a class yet; run `reel taxonomy --store {store}` first");
    }
    Ok(classes)
}

fn compare_sets(arguments: &Drift) -> anyhow::Result<ExitStatus> {
    let session = QuerySession::new(inputs::store(&arguments.store, None)?)?;
    classes_of(&session, &arguments.store)?;
    let (before, _) = how_many(&session, &arguments.before)?;
    let (after, _) = how_many(&session, &arguments.after)?;
    if before == 0 || after == 0 {
        bail!("{before} episodes before and {after} after: both conditions have to fit some");
    }
    let mut printed = Vec::new();
    for (what, name) in [
        ("class", "c.class"),
        ("sub_class", "c.class || ' / ' || c.sub_class"),
    ] {
        let sql = format!(
            "SELECT {name}, count(*) FILTER (WHERE ({})), count(*) FILTER (WHERE ({})) FROM episodes JOIN (SELECT \
             episode_id AS of_episode, class, sub_class FROM classes) c ON c.of_episode = episodes.episode_id GROUP BY 1",
            arguments.before, arguments.after
        );
        let text = format(&session.run(&sql)?, Format::Csv)?;
        let row = |line: &str| -> Option<(String, u64, u64)> {
            let mut cells = line.rsplitn(3, ',');
            let (after, before) = (cells.next()?.parse().ok()?, cells.next()?.parse().ok()?);
            Some((cells.next()?.to_owned(), before, after))
        };
        let counts: Vec<(String, u64, u64)> = text.lines().skip(1).filter_map(row).collect();
        let found = drift(&counts, before, after);
        if arguments.json {
            printed.push(json!({ "by": what, "drift": found }));
            continue;
        }
        println!(
            "{what:44} {:>8} {:>8} {:>8} {:>9} {:>9}",
            format!("of {before}"),
            format!("of {after}"),
            "change",
            "p",
            "corrected"
        );
        for class in &found {
            let mark = if class.significant { "  *" } else { "" };
            println!(
                "{:44} {:8} {:8} {:+7.1}% {:9.2e} {:9.2e}{mark}",
                class.name,
                class.before,
                class.after,
                100.0 * class.difference,
                class.p,
                class.p_corrected
            );
        }
        println!();
    }
    if arguments.json {
        println!(
            "{}",
            json!({ "before": before, "after": after, "drifts": printed })
        );
    } else {
        println!(
            "* more than chance explains: Fisher's exact test, two-sided, Holm's correction, 5%"
        );
    }
    Ok(ExitStatus::Success)
}
