//! `reel taxonomy`: why episodes fail, by the rules; how often the rules are right; what changed.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_query::{Format, Limits, QuerySession, format};
use reel_tables::{LabelRow, Store};
use reel_taxonomy::{
    Agreement, CLASSES, Calibration, LabelSet, RuleSet, StoredClass, agreement, baseline,
    calibration, classify, disputed, drift, label_set,
    sankey::{Flow, Sankey},
    stored_classes,
};
use serde_json::json;

use crate::{
    ExitStatus, cluster_arguments::ClusterArguments, commands::query::rows, inputs, progress,
};

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
    Agreement(WithLabels),
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
struct WithLabels {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// Which labels: an author, a kind (human, judge, injected), or `agreed`
    #[arg(
        long = "reference",
        alias = "with",
        value_name = "SET",
        default_value = "agreed"
    )]
    set: String,
    /// What is compared: `rules`, or labels of another set, e.g. `judge`
    #[arg(
        long = "prediction",
        alias = "of",
        value_name = "SET",
        default_value = "rules"
    )]
    of: String,
    /// Compare what a naive classifier says, too: the class that the last failed call suggests
    #[arg(long)]
    baseline: bool,
    /// List so many disagreements
    #[arg(
        long = "examples",
        alias = "show",
        value_name = "N",
        default_value_t = 20
    )]
    show: usize,
    /// Print the comparison and the disagreements as JSON
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
        Some(Command::Agreement(with)) => compare(with),
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
        print!("{}", table.text());
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
        "SELECT count(success), count(*) FILTER (WHERE success) FROM episodes WHERE ({condition})"
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
    fn text(&self) -> String {
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
        for class in CLASSES {
            let mut within: Vec<(&str, &str)> = self
                .by_family
                .keys()
                .filter(|(name, _)| *name == class)
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

fn compare(arguments: &WithLabels) -> anyhow::Result<ExitStatus> {
    let session = QuerySession::new(inputs::store(&arguments.store, None)?)?;
    let labels = session.store().labels()?;
    let truth = label_set(&labels, &arguments.set);
    let found = match arguments.of.as_str() {
        "rules" => classes_of(&session, &arguments.store)?,
        set => {
            let authors: BTreeSet<&str> = labels
                .iter()
                .filter(|label| label.kind == set)
                .map(|label| label.author.as_str())
                .collect();
            if authors.len() > 1 {
                let authors: Vec<&str> = authors.into_iter().collect();
                eprintln!(
                    "reel: '{set}' are {} authors ({}): of each episode the latest label counts; name one of them with --prediction",
                    authors.len(),
                    authors.join(", ")
                );
            }
            let traces = traces_of(&session)?;
            label_set(&labels, set)
                .into_values()
                .map(|label| as_found(label, &traces))
                .collect()
        }
    };
    let mut reports = vec![(arguments.of.as_str(), found)];
    if arguments.baseline {
        reports.push(("baseline", baseline(&session)?));
    }
    let mut printed = Vec::new();
    for (name, found) in &reports {
        let both: Vec<_> = found
            .iter()
            .filter_map(|found| Some((truth.get(&found.episode_id)?, found)))
            .collect();
        if both.is_empty() {
            let sets: BTreeSet<&str> = labels
                .iter()
                .flat_map(|label| [label.author.as_str(), label.kind.as_str()])
                .collect();
            let sets: Vec<&str> = sets.into_iter().collect();
            bail!(
                "no episode of '{name}' has a label of '{}'; there are labels of: {}",
                arguments.set,
                sets.join(", ")
            );
        }
        let by_class = agreement(
            both.iter()
                .map(|(label, found)| (label.class.as_str(), found.class.as_str())),
            &CLASSES,
        );
        let with_sub = both.iter().filter_map(|(label, found)| {
            Some((label.sub_class.as_deref()?, found.sub_class.as_str()))
        });
        let with_sub = with_sub.filter(|(_, found)| !found.is_empty());
        let by_sub_class = agreement(with_sub, &[]);
        let with_step = both
            .iter()
            .filter_map(|(label, found)| label.step.map(|step| (step - found.step).abs()));
        let distances: Vec<i32> = with_step.collect();
        let exact = distances.iter().filter(|distance| **distance == 0).count();
        if arguments.json {
            printed.push(json!({
                "of": name, "with": arguments.set, "classes": by_class, "sub_classes": by_sub_class,
                "steps": { "compared": distances.len(), "equal": exact },
            }));
            continue;
        }
        println!(
            "== {name} against '{}': {} episodes\n",
            arguments.set, by_class.episodes
        );
        print!("{}", report(&by_class));
        println!();
        print!("{}", confusion(&by_class));
        if by_sub_class.episodes > 0 {
            println!("\nsub-classes of {} episodes", by_sub_class.episodes);
            print!("{}", report(&by_sub_class));
        }
        if !distances.is_empty() {
            let near = distances.iter().filter(|distance| **distance <= 1).count();
            let share = |part: usize| 100.0 * part as f64 / distances.len() as f64;
            println!(
                "\ndecisive step: equal in {:.1}%, at most one off in {:.1}%",
                share(exact),
                share(near)
            );
        }
        println!();
    }
    let calibration = confidence(&labels, &arguments.of, &truth);
    if let Some(found) = calibration.as_ref().filter(|_| !arguments.json) {
        print!("{}", calibrated(&arguments.of, found));
    }
    let (_, found) = &reports[0];
    let differing: Vec<_> = found
        .iter()
        .filter_map(|found| Some((truth.get(&found.episode_id)?, found)))
        .filter(|(label, found)| {
            label.class != found.class
                || label
                    .sub_class
                    .as_ref()
                    .is_some_and(|said| !found.sub_class.is_empty() && *said != found.sub_class)
        })
        .collect();
    let open = disputed(&labels);
    if arguments.json {
        let list: Vec<_> = differing
            .iter()
            .map(|(label, found)| json!({ "label": label, "found": found }))
            .collect();
        println!(
            "{}",
            json!({
                "reports": printed, "calibration": calibration, "disagreements": list,
                "disputed": open.keys().collect::<Vec<_>>(),
            })
        );
        return Ok(ExitStatus::Success);
    }
    if !differing.is_empty() {
        println!(
            "{} disagreements{}",
            differing.len(),
            if differing.len() > arguments.show {
                ", the first of them:"
            } else {
                ":"
            }
        );
    }
    for (label, found) in differing.iter().take(arguments.show) {
        let said = label.sub_class.as_deref().unwrap_or(&label.class);
        let at = label
            .step
            .map(|step| format!(" at {step}"))
            .unwrap_or_default();
        println!(
            "  {}  {} says {said}{at}; found {} at {}\n    reel show {}",
            found.episode_id,
            label.author,
            match found.sub_class.as_str() {
                "" => &found.class,
                sub_class => sub_class,
            },
            found.step,
            found.trace
        );
    }
    if !open.is_empty() {
        println!(
            "{} episodes are disputed: `reel store label disputed` lists them",
            open.len()
        );
    }
    Ok(ExitStatus::Success)
}

/// How far the stated confidence of a set of labels goes with being right about the class; `None`
/// for the rules and for labels without a confidence.
fn confidence(labels: &[LabelRow], of: &str, truth: &LabelSet) -> Option<Calibration> {
    if of == "rules" {
        return None;
    }
    let answers: Vec<(f64, bool)> = label_set(labels, of)
        .into_values()
        .filter_map(|label| {
            let right = truth.get(&label.episode_id)?.class == label.class;
            Some((label.confidence?, right))
        })
        .collect();
    calibration(&answers)
}

fn calibrated(of: &str, found: &Calibration) -> String {
    let mut text = format!(
        "confidence of {} answers of '{of}': Brier score {:.3} ({:.3} if it always stated its accuracy), expected calibration error {:.3}\n  {:12} {:>8} {:>11} {:>9}\n",
        found.answers,
        found.brier,
        found.brier_baseline,
        found.expected_error,
        "confidence",
        "answers",
        "mean",
        "right"
    );
    for bin in &found.bins {
        let [low, high] = bin.range;
        text += &format!(
            "  {:12} {:>8} {:>11.2} {:>8.0}%\n",
            format!("{low:.1} to {high:.1}"),
            bin.answers,
            bin.confidence,
            100.0 * bin.accuracy
        );
    }
    text + "\n"
}

/// The trace of every episode, by its id.
fn traces_of(session: &QuerySession) -> anyhow::Result<BTreeMap<String, String>> {
    #[derive(serde::Deserialize)]
    struct EpisodeTrace {
        episode_id: String,
        trace: String,
    }
    let rows: Vec<EpisodeTrace> = rows(session, "SELECT episode_id, trace FROM episodes")?;
    Ok(rows
        .into_iter()
        .map(|row| (row.episode_id, row.trace))
        .collect())
}

/// A label in the place of what the rules found.
fn as_found(label: LabelRow, traces: &BTreeMap<String, String>) -> StoredClass {
    StoredClass {
        trace: traces.get(&label.episode_id).cloned().unwrap_or_default(),
        episode_id: label.episode_id,
        family: String::new(),
        policy: String::new(),
        class: label.class,
        sub_class: label.sub_class.unwrap_or_default(),
        step: label.step.unwrap_or(-1),
    }
}

fn report(agreement: &Agreement) -> String {
    let share =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    let mut text = format!(
        "{:24} {:>6} {:>6} {:>10} {:>7} {:>6}\n",
        "", "labels", "found", "precision", "recall", "F1"
    );
    for class in &agreement.classes {
        text += &format!(
            "{:24} {:6} {:6} {:>10} {:>7} {:6.3}\n",
            class.class,
            class.support,
            class.found,
            share(class.precision),
            share(class.recall),
            class.f1
        );
    }
    let kappa = share(agreement.kappa);
    text + &format!(
        "macro-F1 {:.3}, accuracy {:.3}, Cohen's kappa {kappa}\n",
        agreement.macro_f1, agreement.accuracy
    )
}

fn confusion(agreement: &Agreement) -> String {
    let mut text = format!("{:24}", "labelled \\ found");
    agreement
        .classes
        .iter()
        .for_each(|class| text += &format!(" {:>18}", class.class));
    text.push('\n');
    for (class, row) in agreement.classes.iter().zip(&agreement.confusion) {
        text += &format!("{:24}", class.class);
        row.iter()
            .for_each(|count| text += &format!(" {count:>18}"));
        text.push('\n');
    }
    text
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
