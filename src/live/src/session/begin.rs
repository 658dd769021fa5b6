//! How the episodes of a session begin: the next of the list, a certain task, or a call of a
//! recorded episode. Never what happens in them.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use reel_episode::Episode;
use reel_trace::{FrameLayers, RecordOptions, Recorder};
use reel_world::{Frame, Task, record::PolicyInfo};

use super::{Phase, PrivilegedState, RunningEpisode, Session, StartedEpisode, part};
use crate::{
    LiveError,
    setup::{EpisodeKey, EpisodeRequest},
};

/// What the header of a branch says of this server and session.
#[derive(Debug)]
pub struct BranchInputs {
    /// The run that the session's episodes belong to.
    pub run_id: String,
    /// Who plays from now on.
    pub policy: PolicyInfo,
}

/// An episode that goes on from a call of a recorded one.
#[derive(Debug)]
pub struct BranchedEpisode {
    /// The episode, with the calls that it took over.
    pub episode: Episode,
    /// RGB of the images that the agent got until there, by call (`None`: before the first); empty
    /// if traces hold no images.
    pub frames: BTreeMap<Option<u32>, Vec<u8>>,
    /// The image of the last call before, where that call returned one; else the head camera's image
    /// is the first that the agent gets.
    pub last_frame: Option<Frame>,
}

impl Session {
    /// Ends what runs and begins the next episode; none when all were played.
    ///
    /// # Errors
    /// When the episode cannot start or its trace cannot be written.
    pub fn begin_next(&mut self) -> Result<Option<StartedEpisode>, LiveError> {
        self.abort()?;
        let task = match &self.lease {
            Some(lease) if self.begun >= lease.rollouts => return Ok(None),
            Some(lease) => Some(
                self.setup
                    .task(&lease.task_id)
                    .cloned()
                    .ok_or_else(|| LiveError::UnknownTask(lease.task_id.clone()))?,
            ),
            None => self.setup.tasks.get(self.next).cloned(),
        };
        let Some(task) = task else {
            self.now = Phase::Empty;
            return Ok(None);
        };
        let begun = self.start(task, &EpisodeRequest::default())?;
        self.next += usize::from(self.lease.is_none());
        Ok(Some(begun))
    }

    /// Ends what runs and begins the episode of a certain task, by its id or by the part after the
    /// family where no other task is called so.
    ///
    /// # Errors
    /// When the task is unknown, the episode cannot start or its trace cannot be written.
    pub fn begin(&mut self, task_id: &str) -> Result<StartedEpisode, LiveError> {
        let unknown = || LiveError::UnknownTask(task_id.to_owned());
        let index = self.setup.find(task_id).ok_or_else(unknown)?;
        let task = self.setup.tasks[index].clone();
        let elsewhere = self
            .lease
            .as_ref()
            .is_some_and(|lease| lease.task_id != task.task_id);
        if elsewhere {
            return Err(unknown());
        }
        self.abort()?;
        let begun = self.start(task, &EpisodeRequest::default())?;
        self.next = index + 1;
        Ok(StartedEpisode {
            requested: Some(task_id.to_owned()),
            ..begun
        })
    }

    /// Ends what runs and begins the episode that a client asks for. Without a task the seed
    /// chooses it, so that equal seeds begin equal episodes; without a seed either, the next of the
    /// list comes, and after the last the first.
    ///
    /// # Errors
    /// When the task is unknown, the episode cannot start or its trace cannot be written.
    pub fn begin_requested(
        &mut self,
        request: &EpisodeRequest,
    ) -> Result<StartedEpisode, LiveError> {
        let tasks = &self.setup.tasks;
        let unknown = |id: &str| LiveError::UnknownTask(id.to_owned());
        let count = tasks.len().max(1);
        let index = match (&request.task_id, request.seed) {
            (Some(id), _) => self.setup.find(id).ok_or_else(|| unknown(id))?,
            (None, Some(seed)) => usize::try_from(seed % count as u64).unwrap_or(0),
            (None, None) => self.next % count,
        };
        let task = tasks.get(index).cloned().ok_or(LiveError::NoEpisode)?;
        if let Some(lease) = &self.lease
            && lease.task_id != task.task_id
        {
            return Err(unknown(&task.task_id));
        }
        self.abort()?;
        let begun = self.start(task, request)?;
        self.next = index + 1;
        Ok(StartedEpisode {
            requested: request.task_id.clone(),
            ..begun
        })
    }

    /// Ends what runs and goes on from a call of a recorded episode of this task. `open` makes the
    /// branch from what its header is to say; where it fails, what runs goes on.
    ///
    /// # Errors
    /// When the branch cannot be made, or its trace cannot be written.
    pub fn begin_branch(
        &mut self,
        task: &Task,
        label: Option<&str>,
        open: impl FnOnce(BranchInputs) -> Result<BranchedEpisode, String>,
    ) -> Result<StartedEpisode, LiveError> {
        let key = EpisodeKey {
            session: &self.name,
            number: self.begun,
            policy: &self.policy,
            lease: None,
            seed: None,
            label,
        };
        let (path, before) = self.setup.path(task, &key);
        let inputs = BranchInputs {
            run_id: self.setup.run_id.clone(),
            policy: self.setup.policy(&key, before),
        };
        let BranchedEpisode {
            episode,
            frames,
            last_frame,
        } = open(inputs).map_err(LiveError::Branch)?;
        self.abort()?;
        let number = self.reserve(&path)?;
        // What a trace holds besides RGB is not drawn again for the calls that were taken over.
        let options = RecordOptions {
            layers: FrameLayers::default(),
            ..self.setup.options
        };
        let mut recorder = self.recorder(&episode, &path, options)?;
        let first = frames.get(&None).map(|rgb| Frame::of_rgb(rgb.clone()));
        recorder.start(episode.start_record(), first.as_ref())?;
        for step in episode.steps() {
            recorder.input(step.step, &step.input)?;
            let frame = frames
                .get(&Some(step.step))
                .map(|rgb| Frame::of_rgb(rgb.clone()));
            recorder.step(step, frame.as_ref())?;
        }
        let taken_over = episode.steps().last().cloned().map(Box::new);
        let frame = last_frame.unwrap_or_else(|| episode.render_frame());
        let playing = RunningEpisode {
            episode,
            recorder,
            path,
        };
        Ok(StartedEpisode {
            taken_over,
            ..self.play(playing, number, frame)
        })
    }

    fn start(
        &mut self,
        task: Arc<Task>,
        request: &EpisodeRequest,
    ) -> Result<StartedEpisode, LiveError> {
        let key = EpisodeKey {
            session: &self.name,
            number: self.begun,
            policy: &self.policy,
            lease: self.lease.as_ref(),
            seed: request.seed,
            label: request.label.as_deref(),
        };
        let (path, before) = self.setup.path(&task, &key);
        let config = self.setup.config(&task, &key, before);
        let number = self.reserve(&path)?;
        let (episode, start, frame) = Episode::start_on(self.setup.stage(&task)?, config);
        let mut recorder = self.recorder(&episode, &path, self.setup.options)?;
        recorder.start(&start, Some(&frame))?;
        let playing = RunningEpisode {
            episode,
            recorder,
            path,
        };
        Ok(self.play(playing, number, frame))
    }

    /// Makes the folder of a trace and counts its episode, which is broken until it plays; how many
    /// there were before.
    fn reserve(&mut self, path: &Path) -> Result<u32, LiveError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let made = self.setup.host.disk.create_dir_all(folder);
        made.map_err(|source| LiveError::Folder {
            path: folder.display().to_string(),
            source,
        })?;
        self.now = Phase::Broken {
            part: part(path),
            reason: "it could not be started".to_owned(),
        };
        self.begun += 1;
        Ok(self.begun - 1)
    }

    fn recorder(
        &self,
        episode: &Episode,
        path: &Path,
        options: RecordOptions,
    ) -> Result<Recorder, LiveError> {
        let inputs = (episode.header(), &**episode.task(), &**episode.scene());
        let disk = self.setup.host.disk.clone();
        Ok(Recorder::create_on(disk, path, inputs, options)?)
    }

    /// Lets the agent play an episode whose start is recorded.
    fn play(&mut self, playing: RunningEpisode, number: u32, frame: Frame) -> StartedEpisode {
        let episode = &playing.episode;
        let task = episode.task().clone();
        let mut tasks = self.setup.tasks.iter();
        let begun = StartedEpisode {
            briefing: episode.briefing(),
            requested: None,
            index: tasks
                .position(|other| other.task_id == task.task_id)
                .unwrap_or(0),
            of: self.setup.tasks.len(),
            number,
            frame,
            view: PrivilegedState::of(episode),
            taken_over: None,
            task,
        };
        self.episode_id = Some(episode.header().episode_id.clone());
        self.now = Phase::Playing(Box::new(playing));
        begun
    }
}
