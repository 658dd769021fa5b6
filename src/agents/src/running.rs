//! An episode under way: the episode, where it is recorded, and what is known of its last call. Carries calls to the
//! episode and records to the trace, inputs before they are used. Never decides anything.

use std::{path::PathBuf, sync::Arc};

use reel_episode::{Briefing, Episode, EpisodeConfig, Observation, StepOutput};
use reel_world::{
    Frame, Scene, Task, WorldGraph,
    record::{StepInput, StepRecord},
};

use crate::{
    AgentError, Context, EpisodeReport, Policy, Seen, perception,
    record::{RecordTo, TraceSink},
    sink::{NoSink, Sink, SinkError},
};

/// An episode under way.
pub struct Running {
    episode: Episode,
    sink: Box<dyn Sink>,
    path: PathBuf,
    briefing: Briefing,
    observation: Observation,
    seen: Vec<Seen>,
}

impl Running {
    /// Starts an episode, and its recording.
    ///
    /// # Errors
    /// When the episode cannot start or its trace cannot be written.
    pub fn start(config: EpisodeConfig, record: Option<&RecordTo>) -> Result<Self, AgentError> {
        let task = config.task.clone();
        let (episode, start, frame) =
            Episode::start(config).map_err(|source| AgentError::Start { task: task.task_id.clone(), source })?;
        let (mut sink, path) = open(&episode, record)?;
        sink.start(&start, Some(&frame)).map_err(|source| unwritten(&episode, &path, source))?;
        let observation = Observation { text: String::new(), error: None, frame: Some(frame) };
        let seen = perception::at_start(&task, episode.scene(), &start);
        Ok(Self { briefing: episode.briefing(), episode, sink, path, observation, seen })
    }

    /// Goes on with an episode of which some calls were made, recording these first; `rgb` gives the picture after a step
    /// (none: of the start), where there is one to record. `witness`, who may decide from now on, is shown them as they came.
    ///
    /// # Errors
    /// When the trace cannot be written.
    pub fn resume(
        episode: Episode,
        record: Option<&RecordTo>,
        mut rgb: impl FnMut(Option<u32>) -> Option<Vec<u8>>,
        mut witness: Option<&mut dyn Policy>,
    ) -> Result<Self, AgentError> {
        let (mut sink, path) = open(&episode, record)?;
        let fail = |source| unwritten(&episode, &path, source);
        let mut frame = |step| rgb(step).map(|rgb| Frame { rgb, ids: Vec::new(), depth_mm: Vec::new() });
        sink.start(episode.start_record(), frame(None).as_ref()).map_err(fail)?;
        let mut past = Past::new(&episode);
        for step in episode.steps() {
            if let Some(witness) = witness.as_deref_mut() {
                witness.watch(&past.context(), &step.input);
            }
            sink.input(step.step, &step.input).map_err(fail)?;
            sink.step(step, frame(Some(step.step)).as_ref()).map_err(fail)?;
            past.after(step);
        }
        let Past { briefing, observation, seen, .. } = past;
        Ok(Self { episode, sink, path, briefing, observation, seen })
    }

    /// The episode, as far as it was played.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Makes a call that was decided elsewhere; `witness` is shown it, as somebody else's.
    ///
    /// # Errors
    /// When the trace cannot be written.
    pub fn make(&mut self, input: StepInput, witness: Option<&mut dyn Policy>) -> Result<(), AgentError> {
        if let Some(witness) = witness {
            witness.watch(&self.context(), &input);
        }
        self.step(input)
    }

    /// Lets a policy play to the end.
    ///
    /// # Errors
    /// When the trace cannot be written.
    pub fn play(&mut self, policy: &mut dyn Policy) -> Result<(), AgentError> {
        while self.episode.ended().is_none() {
            let input = {
                let truth = policy.wants_truth().then(|| self.episode.privileged());
                policy.act(&Context { truth: truth.as_ref(), ..self.context() })
            };
            self.step(input)?;
        }
        Ok(())
    }

    /// Ends it, as aborted where it still runs. `unreachable` is why the policy gave up on the goal, if it did.
    ///
    /// # Errors
    /// When the trace cannot be written.
    pub fn end(self, unreachable: Option<String>) -> Result<EpisodeReport, AgentError> {
        let Self { episode, sink, path, .. } = self;
        let header = episode.header().clone();
        let end = episode.end();
        let recorded = sink.end(&end).map_err(|source| AgentError::Trace {
            task: header.task_id.clone(),
            seed: header.seed,
            path,
            source,
        })?;
        let metrics = end.metrics;
        Ok(EpisodeReport {
            episode_id: header.episode_id,
            task_id: header.task_id,
            family: header.family,
            policy: header.policy.name,
            seed: header.seed,
            success: metrics.success,
            completion: metrics.completion,
            total_reward: metrics.total_reward,
            length: end.steps,
            asks: metrics.asks,
            end_reason: end.reason,
            bytes: recorded.as_ref().map_or(0, |recorded| recorded.bytes),
            trace: recorded.map(|recorded| recorded.path),
            unreachable: unreachable.filter(|_| !metrics.success),
        })
    }

    fn context(&self) -> Context<'_> {
        let step = number(self.episode.steps().len());
        Context { briefing: &self.briefing, observation: &self.observation, seen: &self.seen, truth: None, step }
    }

    fn step(&mut self, input: StepInput) -> Result<(), AgentError> {
        let step = number(self.episode.steps().len());
        self.sink.input(step, &input).map_err(|source| unwritten(&self.episode, &self.path, source))?;
        let StepOutput { record, frame } = self.episode.step(input);
        self.sink.step(&record, frame.as_ref()).map_err(|source| unwritten(&self.episode, &self.path, source))?;
        let graph = self.episode.privileged().graph;
        self.seen = perception::after_step(self.episode.task(), self.episode.scene(), graph, &record);
        self.observation = Observation { text: record.outcome.text, error: record.outcome.error, frame };
        Ok(())
    }
}

/// What an agent knew at each moment of an episode that was played already. Pictures are not among it: built-in policies
/// have what they would see in them from [`perception`].
struct Past<'e> {
    task: &'e Arc<Task>,
    scene: &'e Arc<Scene>,
    graph: WorldGraph,
    calls: u32,
    briefing: Briefing,
    observation: Observation,
    seen: Vec<Seen>,
}

impl<'e> Past<'e> {
    fn new(episode: &'e Episode) -> Self {
        let (task, scene, start) = (episode.task(), episode.scene(), episode.start_record());
        Self {
            task,
            scene,
            graph: start.graphs.physics.clone(),
            calls: 0,
            briefing: episode.briefing(),
            observation: Observation { text: String::new(), error: None, frame: None },
            seen: perception::at_start(task, scene, start),
        }
    }

    fn context(&self) -> Context<'_> {
        Context { briefing: &self.briefing, observation: &self.observation, seen: &self.seen, truth: None, step: self.calls }
    }

    fn after(&mut self, step: &StepRecord) {
        self.graph.apply(&step.changes.physics);
        self.calls = step.step + 1;
        self.seen = perception::after_step(self.task, self.scene, &self.graph, step);
        self.observation = Observation { text: step.outcome.text.clone(), error: step.outcome.error, frame: None };
    }
}

fn open(episode: &Episode, record: Option<&RecordTo>) -> Result<(Box<dyn Sink>, PathBuf), AgentError> {
    let Some(RecordTo { path, options }) = record else { return Ok((Box::new(NoSink), PathBuf::new())) };
    let sink = TraceSink::create(path, *options, episode.header(), episode.task(), episode.scene());
    Ok((Box::new(sink.map_err(|source| unwritten(episode, path, source))?), path.clone()))
}

fn unwritten(episode: &Episode, path: &std::path::Path, source: SinkError) -> AgentError {
    let header = episode.header();
    AgentError::Trace { task: header.task_id.clone(), seed: header.seed, path: path.to_owned(), source }
}

fn number(steps: usize) -> u32 {
    u32::try_from(steps).expect("an episode has few steps")
}
