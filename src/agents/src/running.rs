//! An episode under way: the episode, where it is recorded, and what is known of its last
//! call. Carries calls to the episode and records to the trace, inputs before they are
//! used. Never decides anything.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use reel_episode::{
    Briefing, Detail, Episode, EpisodeConfig, Observation, StepOutput, user::UserQuestion,
};
use reel_world::{
    Frame, HORIZON, InstanceId, Scene, Task, Tool, WorldGraph,
    record::{EpisodeHeader, StartRecord, StepInput, StepRecord},
};

use crate::{
    AgentError, EpisodeReport, PerceivedItem, Policy, PolicyContext, ResponderError, Responders,
    perception,
    record::{RecordTo, TraceSink},
    responders::ask_user,
    sink::{NoSink, Sink, SinkError},
};

/// An episode under way.
pub struct RunningEpisode {
    episode: Episode,
    sink: Box<dyn Sink>,
    path: PathBuf,
    known: AgentView,
    outside: Responders,
}

impl RunningEpisode {
    /// Starts an episode, and its recording.
    ///
    /// # Errors
    /// When the episode cannot start or its trace cannot be written.
    pub fn start(config: EpisodeConfig, record: Option<&RecordTo>) -> Result<Self, AgentError> {
        Self::start_with(config, Detail::Full, record)
    }

    /// [`RunningEpisode::start`] with images of so much detail; only with all of it can the
    /// episode be recorded.
    ///
    /// # Errors
    /// As [`RunningEpisode::start`].
    pub fn start_with(
        config: EpisodeConfig,
        detail: Detail,
        record: Option<&RecordTo>,
    ) -> Result<Self, AgentError> {
        let task_id = config.task.task_id.clone();
        let (episode, start, frame) =
            Episode::start_with(config, detail).map_err(|source| AgentError::Start {
                task: task_id,
                source,
            })?;
        let (mut sink, path) = open(&episode, record)?;
        sink.start(&start, Some(&frame))
            .map_err(|source| unwritten(episode.header(), &path, source))?;
        let known = AgentView::at_start(episode.task(), episode.scene(), &start, Some(frame));
        Ok(Self {
            episode,
            sink,
            path,
            known,
            outside: Responders::default(),
        })
    }

    /// Lets these answer from now on.
    pub fn with_responders(self, outside: Responders) -> Self {
        Self { outside, ..self }
    }

    /// Goes on with an episode of which some calls were made, recording these first; `rgb` gives
    /// the image after a step (none: of the start), where there is one to record. `witness`, who
    /// may decide from now on, is shown them as they came.
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
        let fail = |source| unwritten(episode.header(), &path, source);
        let mut frame = |step| rgb(step).map(Frame::of_rgb);
        let start = episode.start_record();
        sink.start(start, frame(None).as_ref()).map_err(fail)?;
        // Images are not among what is known again: built-in policies have what they would see
        // in them from `perception`.
        let (mut known, mut graph) = (
            AgentView::at_start(episode.task(), episode.scene(), start, None),
            start.graphs.physics.clone(),
        );
        for step in episode.steps() {
            if let Some(witness) = witness.as_deref_mut() {
                witness.observe(&known.context(), &step.input);
            }
            sink.input(step.step, &step.input).map_err(fail)?;
            sink.step(step, frame(Some(step.step)).as_ref())
                .map_err(fail)?;
            graph.apply(&step.changes.physics);
            known.after(episode.task(), episode.scene(), &graph, step, None);
        }
        Ok(Self {
            episode,
            sink,
            path,
            known,
            outside: Responders::default(),
        })
    }

    /// The episode, as far as it was played.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// What an agent knows when it decides now; the truth is not in it.
    pub fn context(&self) -> PolicyContext<'_> {
        self.known.context()
    }

    /// Makes a call that was decided elsewhere; `witness` is shown it, as somebody else's.
    ///
    /// # Errors
    /// When the trace cannot be written, or nobody answers from outside.
    pub fn execute(
        &mut self,
        input: StepInput,
        witness: Option<&mut dyn Policy>,
    ) -> Result<(), AgentError> {
        if let Some(witness) = witness {
            witness.observe(&self.known.context(), &input);
        }
        self.step(input)
    }

    /// Lets a policy play to the end, or for as many decisions as an episode of the paper has.
    ///
    /// # Errors
    /// When the trace cannot be written, or somebody does not answer. The episode can
    /// be ended even so.
    pub fn play(&mut self, policy: &mut dyn Policy) -> Result<(), AgentError> {
        while self.episode.ended().is_none() && self.known.calls < HORIZON {
            let input = self.decide(policy)?;
            self.step(input)?;
        }
        Ok(())
    }

    /// The call that a policy decides now, in the words of the episode's profile. It is not made.
    ///
    /// # Errors
    /// When somebody whom the policy asks does not answer.
    pub fn decide(&self, policy: &mut dyn Policy) -> Result<StepInput, AgentError> {
        let decided = {
            let truth = policy.needs_privileged().then(|| self.episode.privileged());
            policy.act(&PolicyContext {
                truth: truth.as_ref(),
                ..self.known.context()
            })
        };
        let input = decided.map_err(|source| self.unanswered(source))?;
        let profile = self.episode.header().profile;
        Ok(StepInput {
            call: profile.to_server_call(input.call),
            ..input
        })
    }

    /// Ends it, as aborted where it still runs. `unreachable` is why the policy gave up on the
    /// goal, if it did.
    ///
    /// # Errors
    /// When the trace cannot be written.
    pub fn end(self, unreachable: Option<String>) -> Result<EpisodeReport, AgentError> {
        let Self {
            episode,
            sink,
            path,
            ..
        } = self;
        let (header, start, steps) = (
            episode.header().clone(),
            episode.start_record().clone(),
            episode.steps().to_vec(),
        );
        let (task, scene) = (episode.task().clone(), episode.scene().clone());
        let end = episode.end();
        let recorded = sink
            .end(&end)
            .map_err(|source| unwritten(&header, &path, source))?;
        let (trace, bytes) =
            recorded.map_or((None, 0), |recorded| (Some(recorded.path), recorded.bytes));
        let report = EpisodeReport::new(&header, (&task, &scene), (&start, &steps, &end));
        Ok(EpisodeReport {
            trace,
            bytes,
            unreachable: unreachable.filter(|_| !report.success),
            ..report
        })
    }

    /// Adds what comes from outside, where nobody brought it along.
    fn asked_outside(&mut self, mut input: StepInput) -> Result<StepInput, ResponderError> {
        let Self {
            episode, outside, ..
        } = self;
        let profile = episode.header().profile;
        match profile.tool(&input.call) {
            Ok(Tool::Ask { question }) => {
                let start = episode.start_record();
                let seen_at_start: Vec<InstanceId> = start
                    .visible
                    .iter()
                    .map(|object| object.object.clone())
                    .collect();
                let asked = UserQuestion {
                    question: &question,
                    task: episode.task(),
                    scene: episode.scene(),
                    initial: &start.graphs.physics,
                    steps: episode.steps(),
                    seen_at_start: &seen_at_start,
                    refused: &[],
                };
                if let (None, Some(user)) = (&input.user_reply, &mut outside.user) {
                    ask_user(&mut **user, &asked, &mut input)?;
                }
            }
            Ok(Tool::ShowObjectByCategory { category }) => {
                if let (None, Some(matcher)) = (&input.lookup, &mut outside.matcher) {
                    let categories: BTreeSet<&str> = episode
                        .task()
                        .objects
                        .iter()
                        .map(|object| object.category.as_str())
                        .collect();
                    let categories: Vec<&str> = categories.into_iter().collect();
                    if !profile.takes_literally(&category, &categories) {
                        input.lookup = Some(matcher.look_up(&category, &categories)?);
                    }
                }
            }
            _ => {}
        }
        Ok(input)
    }

    fn unanswered(&self, source: ResponderError) -> AgentError {
        let header = self.episode.header();
        AgentError::NoAnswer {
            task: header.task_id.clone(),
            seed: header.seed,
            step: self.known.calls,
            source,
        }
    }

    fn step(&mut self, input: StepInput) -> Result<(), AgentError> {
        let profile = self.episode.header().profile;
        let input = StepInput {
            call: profile.to_server_call(input.call),
            ..input
        };
        let input = self
            .asked_outside(input)
            .map_err(|source| self.unanswered(source))?;
        let Self {
            episode,
            sink,
            path,
            known,
            ..
        } = self;
        sink.input(known.calls, &input)
            .map_err(|source| unwritten(episode.header(), path, source))?;
        let StepOutput { record, frame } = episode.step(input);
        sink.step(&record, frame.as_ref())
            .map_err(|source| unwritten(episode.header(), path, source))?;
        known.after(
            episode.task(),
            episode.scene(),
            &episode.graphs().physics,
            &record,
            frame,
        );
        Ok(())
    }
}

/// Shows somebody every moment of a recorded episode as its agent knew it, without images: what
/// was known, and the step that came then; none at the end.
pub fn retrace(
    task: &Task,
    scene: &Scene,
    start: &StartRecord,
    steps: &[StepRecord],
    mut show: impl FnMut(&PolicyContext<'_>, Option<&StepRecord>),
) {
    let (mut known, mut graph) = (
        AgentView::at_start(task, scene, start, None),
        start.graphs.physics.clone(),
    );
    for step in steps {
        show(&known.context(), Some(step));
        graph.apply(&step.changes.physics);
        known.after(task, scene, &graph, step, None);
    }
    show(&known.context(), None);
}

/// What an agent knows at a moment of an episode.
struct AgentView {
    briefing: Briefing,
    observation: Observation,
    seen: Vec<PerceivedItem>,
    calls: u32,
}

impl AgentView {
    fn at_start(task: &Task, scene: &Scene, start: &StartRecord, frame: Option<Frame>) -> Self {
        Self {
            briefing: Briefing::new(task, scene),
            observation: Observation {
                text: String::new(),
                error: None,
                frame,
                held: None,
            },
            seen: perception::at_start(task, scene, start),
            calls: 0,
        }
    }

    fn context(&self) -> PolicyContext<'_> {
        PolicyContext {
            briefing: &self.briefing,
            observation: &self.observation,
            perceived: &self.seen,
            truth: None,
            step: self.calls,
        }
    }

    /// Takes in what came of a call; `graph` is where physics says the objects are then.
    fn after(
        &mut self,
        task: &Task,
        scene: &Scene,
        graph: &WorldGraph,
        step: &StepRecord,
        frame: Option<Frame>,
    ) {
        self.calls = step.step + 1;
        self.seen = perception::after_step(task, scene, graph, step);
        let held = step
            .held
            .as_ref()
            .and_then(|id| task.object(id))
            .map(|object| object.category.clone());
        self.observation = Observation {
            text: step.outcome.text.clone(),
            error: step.outcome.error,
            frame,
            held,
        };
    }
}

fn open(
    episode: &Episode,
    record: Option<&RecordTo>,
) -> Result<(Box<dyn Sink>, PathBuf), AgentError> {
    let Some(RecordTo { path, options }) = record else {
        return Ok((Box::new(NoSink), PathBuf::new()));
    };
    let sink = TraceSink::create(
        path,
        *options,
        episode.header(),
        episode.task(),
        episode.scene(),
    );
    Ok((
        Box::new(sink.map_err(|source| unwritten(episode.header(), path, source))?),
        path.clone(),
    ))
}

fn unwritten(header: &EpisodeHeader, path: &Path, source: SinkError) -> AgentError {
    AgentError::Trace {
        task: header.task_id.clone(),
        seed: header.seed,
        path: path.to_owned(),
        source,
    }
}
