//! A policy that sees only what an agent sees: it keeps what it learns as a belief, and does what a
//! competent agent does next with it. Never the simulator's truth; what the words of the
//! instruction mean is taken as understood.

use std::collections::{BTreeMap, BTreeSet};

use crate::plan::{
    Belief, CallEffect, DeliveryGoal, Move, ObjectIndex, Objection, PerceivedView, Presumption,
};
use reel_world::{
    ErrorCode, FLOOR, ObjectInstance, ReceptacleId, Scene, Task, Tool, ToolCall, language,
    record::{PolicyInfo, StepInput},
};

use crate::{PerceivedItem, Policy, PolicyContext, ResponderError, oracle::question, policy};

/// Failed calls of its own after which it stops.
const FAILURES_MAX: u32 = 6;
/// Furniture that one expects to have a closed door.
pub(crate) const DOOR_WORDS: [&str; 6] = reel_world::words! {
    fridge refrigerator microwave washing dishwasher electriccooker
};
/// Parts of furniture that one expects to be closed.
const CLOSED_PARTS: [&str; 2] = ["drawer", "compartment"];
/// What the user says as long as the object was not seen.
const NOT_SEEN: [&str; 2] = ["please check", "look around"];

/// One object to move, as the instruction and the list of receptacles tell
/// one who understands them.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct GoalHint {
    /// What to look for: a category, or a purpose where the instruction is underspecified.
    pub category: String,
    /// How it is described, where the instruction is precise.
    pub caption: Option<String>,
    /// Where it may stand and may have to go, in identifier order, and which of
    /// these the words mean.
    pub goal: DeliveryGoal,
    /// Whether it has nothing but the words: else it knows which receptacles they may mean, and
    /// the caption of the object.
    pub by_words: bool,
}

impl GoalHint {
    /// The hints of a task: one for every object that its goal moves, the target first.
    pub fn of_task(task: &Task) -> Vec<GoalHint> {
        let sorted = |one: &ReceptacleId, others: &[ReceptacleId]| {
            let all: BTreeSet<ReceptacleId> = others.iter().chain([one]).cloned().collect();
            all.into_iter().collect::<Vec<_>>()
        };
        let mut moved: Vec<_> = task.goal_objects().collect();
        moved.sort_by_key(|object| object.instance != task.target);
        let hint = |object: &&ObjectInstance| {
            let is_target = object.instance == task.target;
            let to = task
                .goal
                .receptacle_of(&object.instance)
                .unwrap_or(&task.dest);
            let purpose = task.purpose.clone().filter(|_| task.fuzzy && is_target);
            GoalHint {
                caption: object.caption.clone().filter(|_| purpose.is_none()),
                goal: DeliveryGoal {
                    sources: sorted(
                        &object.receptacle,
                        if is_target {
                            &task.src_distractors
                        } else {
                            &[]
                        },
                    ),
                    source: object.receptacle.clone(),
                    destinations: sorted(
                        to,
                        if is_target {
                            &task.dest_distractors
                        } else {
                            &[]
                        },
                    ),
                    destination: to.clone(),
                    vague: purpose.is_some(),
                },
                category: purpose.unwrap_or_else(|| object.category.clone()),
                by_words: false,
            }
        };
        moved.iter().map(hint).collect()
    }

    /// The same for one who has nothing but the words of the instruction: any furniture of the kind
    /// that they name may be meant, and any object of the kind that they describe.
    pub fn of_words(task: &Task, scene: &Scene) -> Vec<GoalHint> {
        let of_kind = |named: &[ReceptacleId]| {
            let is_kind = |category: &str| {
                let mut named = named.iter().filter_map(|id| scene.receptacle(id));
                named.any(|known| known.category == category)
            };
            let alike = scene
                .receptacles
                .iter()
                .filter(|receptacle| is_kind(&receptacle.category))
                .map(|receptacle| &receptacle.id);
            let all: BTreeSet<ReceptacleId> = named.iter().chain(alike).cloned().collect();
            all.into_iter().collect::<Vec<_>>()
        };
        let widened = |hint: GoalHint| GoalHint {
            goal: DeliveryGoal {
                sources: of_kind(&hint.goal.sources),
                destinations: of_kind(&hint.goal.destinations),
                ..hint.goal
            },
            by_words: true,
            ..hint
        };
        Self::of_task(task).into_iter().map(widened).collect()
    }

    /// The same for one who knows which receptacles are meant.
    #[must_use]
    pub fn in_hindsight(&self) -> GoalHint {
        let errand = DeliveryGoal {
            sources: vec![self.goal.source.clone()],
            destinations: vec![self.goal.destination.clone()],
            ..self.goal.clone()
        };
        GoalHint {
            goal: errand,
            ..self.clone()
        }
    }

    /// Whether the instruction may mean a thing that looks like this.
    fn fits(&self, seen: &PerceivedItem, instruction: &str) -> bool {
        match self.goal.vague {
            false if self.by_words => {
                language::is_a(&seen.category, &self.category)
                    && language::fits(instruction, &seen.described(), Some(&self.category))
            }
            false => {
                seen.category == self.category
                    && (self.caption.is_none() || seen.caption == self.caption)
            }
            true => {
                language::fits(instruction, &seen.described(), Some(&self.category))
                    || language::is_a(&seen.category, &self.category)
                    // Who does not know what serves the purpose has to ask.
                    || !language::is_known_kind(&self.category)
            }
        }
    }
}

/// Searches, remembers, asks, puts back.
#[derive(Debug)]
pub struct Planner {
    seed: u64,
    hints: Vec<GoalHint>,
    /// What it knows; none before it saw anything.
    belief: Option<Belief>,
    /// How the things look that it saw.
    looks: BTreeMap<ObjectIndex, PerceivedItem>,
    replies: Vec<String>,
    failures: u32,
    /// The last call, if it was one of a tool, and what was in view when it was made.
    last: Option<Last>,
}

#[derive(Debug)]
struct Last {
    tool: Option<Tool>,
    seen: Vec<PerceivedItem>,
    /// Whether it made the call itself.
    own: bool,
}

impl Planner {
    /// A planner for what the instruction tells. It draws nothing at random; `seed`
    /// is only written down.
    pub fn new(hints: Vec<GoalHint>, seed: u64) -> Self {
        let (looks, replies) = (BTreeMap::new(), Vec::new());
        Self {
            seed,
            hints,
            belief: None,
            looks,
            replies,
            failures: 0,
            last: None,
        }
    }

    /// What it knows now: takes in what came of the last call.
    pub fn belief(&mut self, context: &PolicyContext<'_>) -> &Belief {
        let last = self.last.take();
        if let Some(Last {
            tool: Some(Tool::Ask { .. }),
            ..
        }) = &last
            && context.observation.error.is_none()
        {
            self.replies.push(context.observation.text.clone());
        }
        for seen in context.perceived {
            if let Some(thing) = seen.object {
                self.looks.insert(thing, seen.clone());
            }
        }
        let view = self.view(context);
        let mut belief = self.belief.take().unwrap_or_else(|| self.at_start(context));
        match last {
            None => belief.see(&view),
            Some(Last { tool, seen, own }) => {
                self.failures += u32::from(own && context.observation.error.is_some());
                let at = belief.at().cloned();
                let deeds =
                    tool.map_or_else(Vec::new, |tool| self.deeds(&tool, at, context, &seen));
                deeds.iter().for_each(|deed| belief.learn(deed, &view));
                if deeds.is_empty() {
                    belief.see(&view);
                }
                for (thing, seen) in &self.looks {
                    belief.fits(*thing, self.fits(seen, context));
                }
            }
        }
        self.belief.insert(belief)
    }

    /// The call it would make now.
    pub fn advice(&mut self, context: &PolicyContext<'_>) -> Tool {
        let next = self.belief(context).next();
        let number = |is_it: &dyn Fn(&PerceivedItem) -> bool| {
            context
                .perceived
                .iter()
                .filter(|seen| is_it(seen))
                .find_map(|seen| seen.marker)
        };
        let of_thing =
            |thing: ObjectIndex| number(&|seen: &PerceivedItem| seen.object == Some(thing));
        let of_place = |id: &ReceptacleId| {
            number(&|seen: &PerceivedItem| {
                seen.furniture && seen.receptacle_hint.as_ref() == Some(id)
            })
        };
        let tool = match &next {
            Move::NavTo(receptacle) => Some(Tool::NavTo {
                receptacle: receptacle.clone(),
            }),
            Move::ShowReceptacles => Some(Tool::ShowReceptacles),
            Move::Find(thing) => self
                .looks
                .get(thing)
                .map(|seen| Tool::ShowObjectByCategory {
                    category: seen.category.clone(),
                }),
            Move::WalkAround => Some(Tool::WalkAround),
            Move::Gaze(thing) => of_thing(*thing).map(|marker| Tool::GazeAt { marker }),
            Move::Pick(thing) => of_thing(*thing).map(|marker| Tool::Pick { marker }),
            Move::Place(receptacle) => of_place(receptacle).map(|marker| Tool::Place { marker }),
            Move::Open(receptacle) => of_place(receptacle).map(|marker| Tool::Open { marker }),
            Move::Close(receptacle) => of_place(receptacle).map(|marker| Tool::Close { marker }),
            Move::Ask(errand) => {
                let category = self.hints.get(*errand).map(|hint| hint.category.as_str());
                Some(Tool::Ask {
                    question: question(context.perceived, category),
                })
            }
            Move::Finish(_) => None,
        };
        tool.filter(|_| self.failures < FAILURES_MAX)
            .unwrap_or(Tool::Finish)
    }

    /// The question that would tell apart what fits now.
    pub fn question(&self, context: &PolicyContext<'_>) -> Tool {
        let vague = self.hints.iter().find(|hint| hint.goal.vague);
        let category = vague.map(|hint| hint.category.as_str());
        Tool::Ask {
            question: question(context.perceived, category),
        }
    }

    /// What speaks against a call that somebody else makes now.
    pub fn objection(&mut self, context: &PolicyContext<'_>, call: &ToolCall) -> Option<Objection> {
        let made = as_move(context, call)?;
        self.belief(context).objection(&made)
    }

    /// What a call that somebody else makes now takes for known.
    pub fn presumption(
        &mut self,
        context: &PolicyContext<'_>,
        call: &ToolCall,
    ) -> Option<Presumption> {
        let made = as_move(context, call)?;
        self.belief(context).presumption(&made)
    }

    fn at_start(&self, context: &PolicyContext<'_>) -> Belief {
        let has_door = |category: &str| {
            CLOSED_PARTS.contains(&category)
                || DOOR_WORDS.iter().any(|word| category.contains(word))
        };
        let doors = context
            .briefing
            .receptacles
            .iter()
            .filter(|(_, category, _)| has_door(category));
        let errands = self.hints.iter().map(|hint| hint.goal.clone()).collect();
        Belief::new(errands, doors.map(|(id, ..)| id.clone()).collect())
    }

    fn fits(&self, seen: &PerceivedItem, context: &PolicyContext<'_>) -> Vec<bool> {
        let object = seen.described();
        // What an answer names is meant, whatever one took the instruction to mean.
        let mut named = self
            .replies
            .iter()
            .filter(|reply| names_it(reply))
            .peekable();
        let told = named
            .peek()
            .is_some()
            .then(|| named.all(|reply| language::fits(reply, &object, None)));
        let instruction = &context.briefing.instruction;
        let fits = |hint: &GoalHint| {
            told.filter(|_| hint.goal.vague)
                .unwrap_or_else(|| hint.fits(seen, instruction))
        };
        self.hints.iter().map(fits).collect()
    }

    fn view(&self, context: &PolicyContext<'_>) -> PerceivedView {
        let mut view = PerceivedView::default();
        for seen in context.perceived {
            let place = seen
                .receptacle_hint
                .clone()
                .filter(|place| place.as_str() != FLOOR);
            match (seen.object, place) {
                (Some(thing), place) => {
                    view.objects.push((thing, place, self.fits(seen, context)));
                    view.numbered.extend(seen.marker.map(|_| thing));
                }
                (None, Some(place)) if seen.marker.is_some() => _ = view.receptacles.insert(place),
                (None, _) => {}
            }
        }
        view
    }

    /// What a call did; `at` is where the robot stood, `seen` what was in view then.
    fn deeds(
        &self,
        tool: &Tool,
        at: Option<ReceptacleId>,
        context: &PolicyContext<'_>,
        seen: &[PerceivedItem],
    ) -> Vec<CallEffect> {
        let (thing, place) = (
            |marker: &u32| thing_at(seen, *marker),
            |marker: &u32| place_at(seen, *marker),
        );
        let deed = match (tool, context.observation.error) {
            (Tool::NavTo { receptacle }, None) => Some(CallEffect::NavTo(receptacle.clone())),
            (Tool::NavTo { receptacle }, Some(_)) => Some(CallEffect::Useless(receptacle.clone())),
            (Tool::ShowReceptacles, error) => {
                let is_here = |seen: &PerceivedItem| seen.furniture && seen.receptacle_hint == at;
                let unseen = at
                    .clone()
                    .filter(|_| !context.perceived.iter().any(is_here))
                    .map(CallEffect::Useless);
                return error
                    .is_none()
                    .then_some(CallEffect::ShowReceptacles)
                    .into_iter()
                    .chain(unseen)
                    .collect();
            }
            (Tool::ShowObjectByCategory { .. }, None | Some(ErrorCode::NothingFound)) => {
                Some(CallEffect::Find)
            }
            (Tool::WalkAround, None | Some(ErrorCode::NothingFound)) => {
                Some(CallEffect::WalkAround)
            }
            (Tool::GazeAt { marker }, None) => thing(marker)
                .map(CallEffect::Gaze)
                .or_else(|| place(marker).map(CallEffect::NavTo)),
            // It may be in reach all the same.
            (Tool::GazeAt { marker }, Some(ErrorCode::NoViewpoint)) => {
                thing(marker).map(CallEffect::Gaze)
            }
            (Tool::Pick { marker }, None) => thing(marker).map(CallEffect::Pick),
            (Tool::Pick { marker }, Some(ErrorCode::MarkerNotInView | ErrorCode::OutOfReach)) => {
                thing(marker).map(CallEffect::Lost)
            }
            (Tool::Place { marker }, None) => place(marker).map(CallEffect::Place),
            (Tool::Place { marker }, Some(ErrorCode::DoorClosed)) => {
                place(marker).map(CallEffect::DoorClosed)
            }
            (Tool::Place { marker }, Some(ErrorCode::NotASurface)) => {
                place(marker).map(CallEffect::Useless)
            }
            (Tool::Open { marker }, None) => place(marker).map(CallEffect::Open),
            (Tool::Close { marker }, None) => place(marker).map(CallEffect::Close),
            (Tool::Open { marker } | Tool::Close { marker }, Some(ErrorCode::NoDoor)) => {
                place(marker).map(CallEffect::NoDoor)
            }
            (Tool::Ask { .. }, None) => Some(CallEffect::Ask(
                self.settles(&context.observation.text, context),
            )),
            _ => None,
        };
        deed.into_iter().collect()
    }

    /// Whether an answer tells the meant object from the others that fit the instruction.
    fn settles(&self, reply: &str, context: &PolicyContext<'_>) -> bool {
        let instruction = &context.briefing.instruction;
        let vague = |seen: &&PerceivedItem| {
            self.hints
                .iter()
                .any(|hint| hint.goal.vague && hint.fits(seen, instruction))
        };
        let fitting: Vec<&PerceivedItem> = self.looks.values().filter(vague).collect();
        let named = fitting
            .iter()
            .filter(|seen| language::fits(reply, &seen.described(), None))
            .count();
        names_it(reply) && (fitting.len() < 2 || named < fitting.len())
    }

    fn remember(&mut self, tool: Option<Tool>, context: &PolicyContext<'_>, own: bool) {
        self.last = Some(Last {
            tool,
            seen: context.perceived.to_vec(),
            own,
        });
    }
}

/// A call in the planner's own terms, where it has any.
fn as_move(context: &PolicyContext<'_>, call: &ToolCall) -> Option<Move> {
    let seen = context.perceived;
    Some(match Tool::parse(call).ok()? {
        Tool::NavTo { receptacle } => Move::NavTo(receptacle),
        Tool::WalkAround | Tool::ShowObjectByCategory { .. } => Move::WalkAround,
        Tool::ShowReceptacles => Move::ShowReceptacles,
        Tool::GazeAt { marker } => Move::Gaze(thing_at(seen, marker)?),
        Tool::Pick { marker } => Move::Pick(thing_at(seen, marker)?),
        Tool::Place { marker } => Move::Place(place_at(seen, marker)?),
        Tool::Ask { .. } => Move::Ask(0),
        Tool::Open { .. } | Tool::Close { .. } | Tool::Finish | Tool::Lifecycle(_) => return None,
    })
}

/// The thing with that number.
fn thing_at(seen: &[PerceivedItem], marker: u32) -> Option<ObjectIndex> {
    seen.iter().find(|seen| seen.marker == Some(marker))?.object
}

/// The receptacle with that number.
fn place_at(seen: &[PerceivedItem], marker: u32) -> Option<ReceptacleId> {
    seen.iter()
        .find(|seen| seen.marker == Some(marker) && seen.furniture)?
        .receptacle_hint
        .clone()
}

/// Whether an answer names the object: not as long as the user only says where to look.
fn names_it(reply: &str) -> bool {
    let reply = reply.to_lowercase();
    !NOT_SEEN.iter().any(|words| reply.contains(words))
}

impl Policy for Planner {
    fn info(&self) -> PolicyInfo {
        let by_words = self.hints.iter().any(|hint| hint.by_words);
        let name = if by_words { "planner-words" } else { "planner" };
        policy::info(name, self.seed)
    }

    fn needs_privileged(&self) -> bool {
        false
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let tool = self.advice(context);
        let call = tool.to_call();
        self.remember(Some(tool), context, true);
        Ok(StepInput::from_call(call))
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.belief(context);
        self.remember(Tool::parse(&input.call).ok(), context, false);
    }
}
