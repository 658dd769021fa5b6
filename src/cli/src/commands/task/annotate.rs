//! `reel task annotate`: questions in the plans of tasks, so that the expert has to speak.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use rayon::prelude::*;
#[cfg(feature = "service")]
use reel_llm::client::{Client, Message, Part, Request, Role};
use reel_tasks::generate::social::{
    AnnotateOptions, AnnotatedTask, Annotation, FIELD, SkipReason, Strategy, annotate,
};
#[cfg(feature = "service")]
use reel_tasks::generate::{scene::Plan, social::proposal};
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
/// Strategy A is a dialogue before the first step: the instruction says neither where the object is
/// nor where it goes, and often leaves open which object is meant ("a mug"). Strategy B leaves open
/// which of several receptacles of a kind is meant ("a table"). They are drawn by seed from those
/// that apply; each question is tried with the simulated user first: what was said before leaves at
/// least two possible, the answer fewer. Tasks in which nothing can be asked are left out and
/// counted. `reel run` with the oracle then plays the conversation as part of the episode.
///
/// A model sees the floor plan of the scene beside the captions; --no-image is for models that
/// read text alone.
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
    /// Leave out the floor plan of the scene, for a model that reads text alone
    #[cfg(feature = "service")]
    #[arg(long, requires = "model")]
    no_image: bool,
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
    let pool = inputs::pool(arguments.jobs)?;
    let all: usize = sets.iter().map(|(_, tasks)| tasks.len()).sum();
    let bar = progress::bar(all, "tasks");
    let mut counts = Counts::default();
    for (scene, tasks) in &sets {
        save_scene(&arguments.out, scene)?;
        let author = author.of_scene(scene)?;
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
                    .map(|task| author.write(task, &file(task)))
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
    #[cfg(feature = "service")]
    sees_plan: bool,
}

/// Who annotates the tasks of one scene.
struct SceneAuthor<'a> {
    author: &'a Author<'a>,
    scene: &'a Scene,
    /// The floor plan that the model gets; `None` without a model, and with `--no-image`.
    plan: Option<FloorPlan>,
}

/// The top-down image of a scene.
struct FloorPlan {
    digest: Digest,
    #[cfg(feature = "service")]
    png: Vec<u8>,
}

/// A task's annotation and where it comes from.
struct Authored {
    task: AnnotatedTask,
    /// The model with its prompt, or the rules.
    author: String,
    by_model: bool,
    /// Why the rules stand in a model's place.
    fallback: Option<String>,
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
            #[cfg(feature = "service")]
            sees_plan: !arguments.no_image,
        })
    }

    fn of_scene(&'a self, scene: &'a Scene) -> anyhow::Result<SceneAuthor<'a>> {
        Ok(SceneAuthor {
            author: self,
            scene,
            plan: self.plan(scene)?,
        })
    }
}

impl SceneAuthor<'_> {
    fn write(&self, task: &Task, file: &Path) -> anyhow::Result<TaskResult> {
        let made_from = self.made_from(task);
        if let Some(annotations) = kept(file, self.scene, &made_from) {
            return Ok(TaskResult::Kept(annotations));
        }
        // Where the rules find nothing to ask, nobody is asked for more.
        let by_rules = match annotate(task, self.scene, &self.author.options) {
            Ok(annotated) => annotated,
            Err(why) => return Ok(TaskResult::Skipped(why)),
        };
        let mut authored = self.improved(task, by_rules)?;
        if let Some(Value::Object(social)) = authored.task.task.extra.get_mut(FIELD) {
            social.insert("author".to_owned(), json!(authored.author));
            social.insert("made_from".to_owned(), json!(made_from));
            if let Some(plan) = self.plan.as_ref().filter(|_| authored.by_model) {
                let image = json!({ "kind": "floor_plan", "digest": plan.digest });
                social.insert("image".to_owned(), image);
            }
        }
        Ok(TaskResult::Annotated(
            Box::new(authored.task),
            authored.fallback,
        ))
    }

    /// Stands in a file for all that it was made from.
    fn made_from(&self, task: &Task) -> String {
        let AnnotateOptions { strategies, seed } = self.author.options;
        let inputs = json!([
            Digest::of_json(task),
            Digest::of_json(self.scene),
            strategies,
            seed,
            self.author.name(),
            self.plan.as_ref().map(|plan| plan.digest),
        ]);
        Digest::of_json(&inputs).short()
    }
}

fn by_the_rules(task: AnnotatedTask, fallback: Option<String>) -> Authored {
    Authored {
        task,
        author: "rules".to_owned(),
        by_model: false,
        fallback,
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

    fn plan(&self, _: &Scene) -> anyhow::Result<Option<FloorPlan>> {
        Ok(None)
    }
}

#[cfg(not(feature = "service"))]
impl SceneAuthor<'_> {
    fn improved(&self, _: &Task, by_rules: AnnotatedTask) -> anyhow::Result<Authored> {
        Ok(by_the_rules(by_rules, None))
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

    /// The floor plan of a scene for the model; `None` if no model looks at it.
    fn plan(&self, scene: &Scene) -> anyhow::Result<Option<FloorPlan>> {
        if self.model.is_none() || !self.sees_plan {
            return Ok(None);
        }
        let png = Plan::of(scene).png().with_context(|| {
            format!(
                "scene {} has no floor plan; --no-image leaves it out",
                scene.scene_id
            )
        })?;
        Ok(Some(FloorPlan {
            digest: Digest::of(&png),
            png,
        }))
    }
}

#[cfg(feature = "service")]
impl SceneAuthor<'_> {
    /// The model's proposal, if there is a model and nothing speaks against it.
    fn improved(&self, task: &Task, by_rules: AnnotatedTask) -> anyhow::Result<Authored> {
        let author = self.author;
        let Some(client) = &author.model else {
            return Ok(by_the_rules(by_rules, None));
        };
        let strategies = author.options.strategies;
        let summary = proposal::summary(task, self.scene, strategies);
        let mut question = Message::text(Role::User, summary);
        if let Some(plan) = &self.plan {
            question
                .parts
                .push(Part::Text(proposal::IMAGE_CAPTION.to_owned()));
            question.parts.push(Part::Image {
                media_type: "image/png".to_owned(),
                bytes: plan.png.clone(),
            });
        }
        let messages = vec![Message::text(Role::System, proposal::PROMPT), question];
        let reply = client.complete(&Request {
            messages,
            ..Request::default()
        })?;
        Ok(
            match proposal::judge(task, self.scene, strategies, &reply.text) {
                Ok(annotated) => Authored {
                    task: annotated,
                    author: author.name(),
                    by_model: true,
                    fallback: None,
                },
                Err(why) => by_the_rules(by_rules, Some(why.kind().to_owned())),
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
