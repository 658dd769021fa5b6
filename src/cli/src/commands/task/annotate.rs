//! `reel task annotate`: questions in the plans of tasks, so that the expert has to speak.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use rayon::prelude::*;
#[cfg(feature = "service")]
use reel_llm::client::{Client, Message, Request, Role};
#[cfg(feature = "service")]
use reel_tasks::generate::social::proposal;
use reel_tasks::generate::social::{
    AnnotateOptions, AnnotatedTask, Annotation, FIELD, SkipReason, Strategy, annotate,
};
use reel_world::{Digest, Scene, Task};
use serde_json::{Value, json};

use super::{save, save_scene};
#[cfg(feature = "service")]
use crate::model::Model;
use crate::{ExitStatus, inputs, progress};

/// Tasks that are worked on before their files are written.
const BATCH: usize = 10;

/// Put questions into the plans of tasks, and make the instructions so vague that they
/// have to be asked.
///
/// Strategy A leaves open which object is meant ("a mug"), strategy B which of several receptacles
/// of a kind ("a table"). One or two questions a task, drawn by seed from those that apply; each is
/// tried with the simulated user first: what was said before leaves at least two possible, the
/// answer one. Tasks in which nothing can be asked are left out and counted. `reel run` with the
/// oracle then plays the conversation as part of the episode.
///
/// PATH is what `reel task generate` wrote, or any task file or folder. Files go to
/// DIR/<scene>/<family>/, and the scene beside them. The same command resumes after an
/// interruption: files of the same task, scene and options are kept.
///
/// Examples:
///   reel task generate --count 200 --out made && reel task annotate made --out social
///   reel task annotate made --strategies B --seed 3 --out social
///   reel run --tasks social --out traces
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Task file or folder
    #[arg(value_name = "PATH")]
    tasks: PathBuf,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    /// Strategies that may be used
    #[arg(long, value_name = "A,B", value_delimiter = ',', default_value = "A,B")]
    strategies: Vec<String>,
    /// Seed of every random draw
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Folder for the files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[cfg(feature = "service")]
    #[command(flatten)]
    model: Model,
    /// Threads, and requests at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print counts of tasks and questions as one JSON object
    #[arg(long)]
    json: bool,
}

/// What came of a task.
enum TaskResult {
    /// Its file is there from an earlier run.
    Kept(Vec<Annotation>),
    /// Annotated anew; if a model was asked and its proposal not taken, why.
    Annotated(Box<AnnotatedTask>, Option<String>),
    Skipped(SkipReason),
}

/// What came of all.
#[derive(Default)]
struct Counts {
    annotated: usize,
    kept: usize,
    questions: BTreeMap<String, usize>,
    skipped: BTreeMap<SkipReason, usize>,
    /// Why the rules stand in a model's place.
    fallbacks: BTreeMap<String, usize>,
}

/// Puts questions into the plans of tasks and writes the annotated task files.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let strategies = parse_strategies(&arguments.strategies)?;
    let loaded = inputs::tasks(
        &arguments.tasks,
        &arguments.scene,
        reel_tasks::ObjectOrder::AsWritten,
    )?;
    let (sets, broken) = (loaded.by_scene(), loaded.broken);
    let author = Author::new(arguments, &strategies)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(inputs::workers(arguments.jobs))
        .build()?;
    let all: usize = sets.iter().map(|(_, tasks)| tasks.len()).sum();
    let bar = progress::bar(all, "tasks");
    let mut counts = Counts::default();
    for (scene, tasks) in &sets {
        save_scene(&arguments.out, scene)?;
        let file = |task: &Task| {
            arguments
                .out
                .join(&scene.scene_id)
                .join(format!("{}.yaml", task.task_id))
        };
        for batch in tasks.chunks(BATCH) {
            let done: Vec<anyhow::Result<TaskResult>> = pool.install(|| {
                batch
                    .par_iter()
                    .map(|task| author.write(task, scene, &file(task)))
                    .collect()
            });
            // What was done before something failed is there for the next run.
            for (task, done) in batch.iter().zip(done) {
                let done = done.with_context(|| {
                    format!(
                        "task {}; what is done is kept, run the command again",
                        task.task_id
                    )
                })?;
                if let TaskResult::Annotated(annotated, _) = &done {
                    save(
                        &file(task),
                        &reel_tasks::yaml::write(&annotated.task, scene),
                    )?;
                }
                counts.add(&done);
                bar.inc(1);
            }
        }
    }
    bar.finish_and_clear();
    if arguments.json {
        println!("{}", counts.json(arguments));
    } else {
        counts.print(arguments, author.asks_model());
    }
    Ok(if broken == 0 && counts.annotated > 0 {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

impl Counts {
    fn add(&mut self, done: &TaskResult) {
        let annotations = match done {
            TaskResult::Skipped(why) => {
                *self.skipped.entry(*why).or_default() += 1;
                return;
            }
            TaskResult::Kept(annotations) => {
                self.kept += 1;
                annotations
            }
            TaskResult::Annotated(annotated, fallback) => {
                if let Some(why) = fallback {
                    *self.fallbacks.entry(why.clone()).or_default() += 1;
                }
                &annotated.annotations
            }
        };
        self.annotated += 1;
        for annotation in annotations {
            let name = format!(
                "{} {}",
                annotation.strategy.as_str(),
                annotation.about.as_str()
            );
            *self.questions.entry(name).or_default() += 1;
        }
    }

    fn json(&self, arguments: &Arguments) -> Value {
        let reasons = |(why, count): (&SkipReason, &usize)| (why.to_string(), json!(count));
        let skipped: serde_json::Map<String, Value> = self.skipped.iter().map(reasons).collect();
        json!({
            "annotated": self.annotated, "unchanged": self.kept, "questions": self.questions, "skipped": skipped,
            "fallbacks": self.fallbacks, "out": arguments.out,
        })
    }

    fn print(&self, arguments: &Arguments, with_model: bool) {
        println!(
            "{} tasks with questions in {}",
            self.annotated,
            arguments.out.display()
        );
        if self.kept > 0 {
            println!("  {:5} of them were there already", self.kept);
        }
        for (name, count) in &self.questions {
            println!("  {count:5} questions by strategy {name}");
        }
        if with_model {
            let fallbacks: usize = self.fallbacks.values().sum();
            println!("  {fallbacks:5} tasks annotated by the rules in the model's place");
            for (why, count) in &self.fallbacks {
                println!("        {count:5} {why}");
            }
        }
        let skipped: usize = self.skipped.values().sum();
        println!("{skipped} tasks left out");
        for (why, count) in &self.skipped {
            println!("  {count:5} {why}");
        }
    }
}

/// Who annotates: the rules, and a model, if one was named.
struct Author<'a> {
    options: AnnotateOptions<'a>,
    #[cfg(feature = "service")]
    model: Option<Client>,
}

impl<'a> Author<'a> {
    fn new(arguments: &Arguments, strategies: &'a [Strategy]) -> anyhow::Result<Self> {
        let options = AnnotateOptions {
            strategies,
            seed: arguments.seed,
        };
        #[cfg(feature = "service")]
        let model = {
            fs::create_dir_all(&arguments.out)
                .with_context(|| format!("cannot make the folder {}", arguments.out.display()))?;
            arguments.model.client(
                &arguments.out.join("model-replies"),
                &arguments.out.join("model-calls.jsonl"),
            )?
        };
        Ok(Self {
            options,
            #[cfg(feature = "service")]
            model,
        })
    }

    fn write(&self, task: &Task, scene: &Scene, file: &Path) -> anyhow::Result<TaskResult> {
        let made_from = self.made_from(task, scene);
        if let Some(annotations) = kept(file, scene, &made_from) {
            return Ok(TaskResult::Kept(annotations));
        }
        // Where the rules find nothing to ask, nobody is asked for more.
        let by_rules = match annotate(task, scene, &self.options) {
            Ok(annotated) => annotated,
            Err(why) => return Ok(TaskResult::Skipped(why)),
        };
        let (mut annotated, author, fallback) = self.improved(task, scene, by_rules)?;
        if let Some(Value::Object(social)) = annotated.task.extra.get_mut(FIELD) {
            social.insert("author".to_owned(), json!(author));
            social.insert("made_from".to_owned(), json!(made_from));
        }
        Ok(TaskResult::Annotated(Box::new(annotated), fallback))
    }

    /// Stands in a file for all that it was made from.
    fn made_from(&self, task: &Task, scene: &Scene) -> String {
        let AnnotateOptions { strategies, seed } = self.options;
        let inputs = json!([
            Digest::of_json(task),
            Digest::of_json(scene),
            strategies,
            seed,
            self.name()
        ]);
        Digest::of_json(&inputs).short()
    }
}

#[cfg(not(feature = "service"))]
impl Author<'_> {
    fn asks_model(&self) -> bool {
        false
    }

    fn name(&self) -> String {
        "rules".to_owned()
    }

    fn improved(
        &self,
        _: &Task,
        _: &Scene,
        by_rules: AnnotatedTask,
    ) -> anyhow::Result<(AnnotatedTask, String, Option<String>)> {
        Ok((by_rules, self.name(), None))
    }
}

#[cfg(feature = "service")]
impl Author<'_> {
    fn asks_model(&self) -> bool {
        self.model.is_some()
    }

    fn name(&self) -> String {
        let of_model = |client: &Client| {
            format!(
                "{} by prompt {}",
                client.endpoint().model,
                proposal::prompt_version().short()
            )
        };
        self.model
            .as_ref()
            .map_or_else(|| "rules".to_owned(), of_model)
    }

    /// The model's proposal, if there is a model and nothing speaks against it.
    fn improved(
        &self,
        task: &Task,
        scene: &Scene,
        by_rules: AnnotatedTask,
    ) -> anyhow::Result<(AnnotatedTask, String, Option<String>)> {
        let Some(client) = &self.model else {
            return Ok((by_rules, self.name(), None));
        };
        let summary = proposal::summary(task, scene, self.options.strategies);
        let messages = vec![
            Message::text(Role::System, proposal::PROMPT),
            Message::text(Role::User, summary),
        ];
        let reply = client.complete(&Request {
            messages,
            ..Request::default()
        })?;
        Ok(
            match proposal::judge(task, scene, self.options.strategies, &reply.text) {
                Ok(annotated) => (annotated, self.name(), None),
                Err(why) => (by_rules, "rules".to_owned(), Some(why.kind().to_owned())),
            },
        )
    }
}

/// The questions of a file that is there already, if it was made from the same.
fn kept(file: &Path, scene: &Scene, made_from: &str) -> Option<Vec<Annotation>> {
    let text = fs::read_to_string(file).ok()?;
    let (task, _) = reel_tasks::parse(&text, &file.display().to_string(), scene).ok()?;
    let social = task.extra.get(FIELD)?;
    if social.get("made_from")?.as_str()? != made_from {
        return None;
    }
    serde_json::from_value(social.get("annotations")?.clone()).ok()
}

fn parse_strategies(names: &[String]) -> anyhow::Result<Vec<Strategy>> {
    let mut strategies = Vec::new();
    for name in names {
        let Some(strategy) = Strategy::parse(name) else {
            bail!("no strategy is called '{name}'; there are A and B")
        };
        if !strategies.contains(&strategy) {
            strategies.push(strategy);
        }
    }
    strategies.sort();
    Ok(strategies)
}
