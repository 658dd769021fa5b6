//! A policy that sees only what an agent sees: it searches candidate receptacles, remembers what it saw,
//! compares captions with what it was told, and asks when several things fit. Never the simulator's truth.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::{
    ErrorCode, ReceptacleId, Task, Tool,
    record::{PolicyInfo, StepInput},
};

use crate::{Context, Policy, Seen, oracle::question, policy};

/// Failed calls after which it stops.
const FAILURES_MAX: u32 = 6;
/// A destination is mentioned last in an instruction: at most so many words ("to place it") follow it.
const WORDS_AFTER_DESTINATION: usize = 3;
/// Furniture that one expects to have a closed door.
pub(crate) const DOOR_WORDS: [&str; 6] = ["fridge", "refrigerator", "microwave", "washing", "dishwasher", "electriccooker"];

/// One object to move, as far as the instruction and the list of receptacles tell.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct GoalHint {
    /// What to look for: a category, or a purpose where the instruction is underspecified.
    pub category: String,
    /// How it is described, where the instruction is precise.
    pub caption: Option<String>,
    /// Where it may stand, in identifier order.
    pub sources: Vec<ReceptacleId>,
    /// Where it may have to go, in identifier order.
    pub destinations: Vec<ReceptacleId>,
}

impl GoalHint {
    /// The hints of a task: one for every object that its goal moves, the target first.
    pub fn of_task(task: &Task) -> Vec<GoalHint> {
        let sorted = |one: &ReceptacleId, others: &[ReceptacleId]| {
            let all: BTreeSet<ReceptacleId> = others.iter().chain([one]).cloned().collect();
            all.into_iter().collect::<Vec<_>>()
        };
        let mut moved: Vec<_> = task
            .objects
            .iter()
            .filter(|object| task.initial.place_of(&object.instance) != task.goal.place_of(&object.instance))
            .collect();
        moved.sort_by_key(|object| object.instance != task.target);
        let hint = |object: &&reel_world::ObjectInstance| {
            let is_target = object.instance == task.target;
            let to = task.goal.place_of(&object.instance).unwrap_or(&task.dest);
            let purpose = task.purpose.clone().filter(|_| task.fuzzy && is_target);
            GoalHint {
                caption: object.caption.clone().filter(|_| purpose.is_none()),
                category: purpose.unwrap_or_else(|| object.category.clone()),
                sources: sorted(&object.receptacle, if is_target { &task.src_distractors } else { &[] }),
                destinations: sorted(to, if is_target { &task.dest_distractors } else { &[] }),
            }
        };
        moved.iter().map(hint).collect()
    }
}

/// Searches, remembers, asks.
#[derive(Debug)]
pub struct Planner {
    seed: u64,
    hints: Vec<GoalHint>,
    /// The hint at work.
    current: usize,
    at: Option<ReceptacleId>,
    holding: bool,
    /// Captions of receptacles, as read.
    captions: BTreeMap<ReceptacleId, String>,
    /// Receptacles that are of no use for this hint.
    rejected: BTreeSet<ReceptacleId>,
    /// Doors it opened.
    opened: BTreeSet<ReceptacleId>,
    /// Receptacles that turned out to have no door to open.
    doorless: BTreeSet<ReceptacleId>,
    /// A door that must be opened before the held object can be placed.
    in_the_way: Option<ReceptacleId>,
    /// Where the held object was taken from.
    origin: Option<ReceptacleId>,
    /// Where it looked last for something to pick: what it saw, and how it looked.
    view: Vec<Seen>,
    probed: bool,
    walked: bool,
    gazed: bool,
    /// Whether the receptacles in view have numbers.
    marked: bool,
    asked: bool,
    reply: String,
    failures: u32,
    /// The last call, and the receptacle that a number in it stands for.
    last: Option<(Tool, Option<ReceptacleId>)>,
    /// Whether somebody else made the last call.
    watched: bool,
    /// Whether somebody else took what is in the hand by mistake: it has to go back.
    astray: bool,
}

impl Planner {
    /// A planner for what the instruction tells. It draws nothing at random; `seed` is only written down.
    pub fn new(hints: Vec<GoalHint>, seed: u64) -> Self {
        Self {
            seed,
            hints,
            current: 0,
            at: None,
            holding: false,
            captions: BTreeMap::new(),
            rejected: BTreeSet::new(),
            opened: BTreeSet::new(),
            doorless: BTreeSet::new(),
            in_the_way: None,
            origin: None,
            view: Vec::new(),
            probed: false,
            walked: false,
            gazed: false,
            marked: false,
            asked: false,
            reply: String::new(),
            failures: 0,
            last: None,
            watched: false,
            astray: false,
        }
    }

    /// Takes in what the last call gave.
    fn learn(&mut self, context: &Context<'_>) {
        let Some((tool, receptacle)) = self.last.take() else { return };
        let error = context.observation.error;
        let watched = std::mem::take(&mut self.watched);
        match error {
            Some(error) if watched => return self.learn_watched_failure(&tool, receptacle, error),
            Some(_) => return self.learn_failure(&tool, receptacle, error),
            None => {}
        }
        match tool {
            Tool::NavTo { receptacle } => {
                self.at = Some(receptacle);
                self.forget_view();
            }
            Tool::ShowReceptacles => {
                self.marked = true;
                let furniture = context.seen.iter().filter(|thing| thing.furniture);
                for thing in furniture {
                    if let Some(id) = &thing.receptacle_hint {
                        self.captions.insert(id.clone(), thing.caption.clone().unwrap_or_default());
                    }
                }
            }
            Tool::ShowObjectByCategory { .. } | Tool::WalkAround => {
                self.probed = true;
                self.walked |= tool == Tool::WalkAround;
                self.marked = false;
                self.view = context.seen.iter().filter(|thing| !thing.furniture).cloned().collect();
            }
            Tool::GazeAt { .. } => self.gazed = true,
            Tool::Pick { .. } => {
                self.holding = true;
                self.origin = self.at.clone();
            }
            Tool::Place { .. } => {
                self.holding = false;
                if std::mem::take(&mut self.astray) {
                    // What was taken by mistake is out of the hand; nothing is gained.
                } else if let Some(wrong) = receptacle.filter(|id| watched && !self.is_destination(id, context)) {
                    if let Some(hint) = self.hints.get_mut(self.current) {
                        hint.sources = vec![wrong];
                    }
                    self.rejected.clear();
                } else if self.in_the_way.is_none() {
                    self.current += 1;
                    self.rejected.clear();
                }
                self.forget_view();
            }
            Tool::Open { .. } => {
                self.opened.extend(receptacle);
                self.in_the_way = None;
            }
            Tool::Close { .. } => {
                receptacle.iter().for_each(|id| _ = self.opened.remove(id));
            }
            Tool::Ask { .. } => self.reply = context.observation.text.clone(),
            Tool::Finish | Tool::Lifecycle(_) => {}
        }
    }

    fn learn_failure(&mut self, tool: &Tool, receptacle: Option<ReceptacleId>, error: Option<ErrorCode>) {
        match tool {
            Tool::ShowObjectByCategory { .. } => self.probed = true,
            Tool::WalkAround => self.walked = true,
            Tool::GazeAt { .. } => self.gazed = true,
            Tool::Ask { .. } => {}
            Tool::NavTo { receptacle } => {
                self.rejected.insert(receptacle.clone());
                self.opened.remove(receptacle);
                self.failures += 1;
            }
            Tool::Place { .. } if error == Some(ErrorCode::DoorClosed) => {
                self.in_the_way = receptacle;
                self.failures += 1;
            }
            Tool::Open { .. } => {
                self.doorless.extend(receptacle);
                self.in_the_way = None;
            }
            Tool::Close { .. } => {
                receptacle.iter().for_each(|id| _ = self.opened.remove(id));
            }
            _ => {
                self.rejected.extend(self.at.take());
                self.failures += 1;
            }
        }
    }

    /// What fails for somebody else says something of doors only.
    fn learn_watched_failure(&mut self, tool: &Tool, receptacle: Option<ReceptacleId>, error: ErrorCode) {
        match tool {
            Tool::Place { .. } if error == ErrorCode::DoorClosed => self.in_the_way = receptacle,
            Tool::Open { .. } if error != ErrorCode::HandNotFree => self.doorless.extend(receptacle),
            Tool::Pick { .. } if !self.holding => self.astray = false,
            _ => {}
        }
    }

    /// Whether somebody else's place for the held object may be right, as far as it can tell.
    fn is_destination(&self, id: &ReceptacleId, context: &Context<'_>) -> bool {
        let Some(hint) = self.hints.get(self.current) else { return true };
        let chosen = || self.choose(&hint.destinations, context, |after| after <= WORDS_AFTER_DESTINATION);
        hint.destinations.contains(id) && (!self.captions.contains_key(id) || chosen().as_ref() == Some(id))
    }

    /// Whether somebody else takes what it would take, for the object at work or a later one, which then comes first.
    fn is_wanted(&mut self, marker: u32, context: &Context<'_>) -> bool {
        let Some(here) = self.at.clone() else { return false };
        let is_source = |hint: &GoalHint| {
            let chosen = || self.choose(&hint.sources, context, |after| after > WORDS_AFTER_DESTINATION);
            hint.sources.contains(&here) && (!self.captions.contains_key(&here) || chosen().as_ref() == Some(&here))
        };
        // Where the thing itself is not in view, what fits best is still another thing.
        let is_kind = |hint: &GoalHint, thing: &Seen| hint.caption.is_none() || thing.category == hint.category;
        let takes = |hint: &GoalHint| {
            let is_it = |thing: &&Seen| thing.marker == Some(marker) && is_kind(hint, thing);
            is_source(hint) && self.fitting(hint, &here).iter().any(is_it)
        };
        let Some(wanted) = (self.current..self.hints.len()).find(|index| takes(&self.hints[*index])) else { return false };
        self.hints.swap(self.current, wanted);
        true
    }

    fn forget_view(&mut self) {
        self.view.clear();
        (self.probed, self.walked, self.gazed, self.marked) = (false, false, false, false);
    }

    fn decide(&mut self, context: &Context<'_>) -> (Tool, Option<ReceptacleId>) {
        if self.failures >= FAILURES_MAX {
            return (Tool::Finish, None);
        }
        let Some(hint) = self.hints.get(self.current).cloned() else { return self.wrap_up(context) };
        if self.holding {
            let goal = match (&self.in_the_way, &self.origin) {
                (Some(_), Some(origin)) => Some(origin.clone()),
                (None, Some(origin)) if self.astray => Some(origin.clone()),
                _ => self.choose(&hint.destinations, context, |after| after <= WORDS_AFTER_DESTINATION),
            };
            let Some(receptacle) = goal else { return (Tool::Finish, None) };
            return self.at_number(&receptacle, context, |marker| Tool::Place { marker });
        }
        // A hand must be free to open a door, so the destination's comes first.
        let only = if hint.destinations.len() == 1 { hint.destinations.first() } else { None };
        if let Some(door) = self.in_the_way.clone().or_else(|| only.filter(|id| self.is_shut(id, context)).cloned()) {
            return self.at_number(&door, context, |marker| Tool::Open { marker });
        }
        match self.choose(&hint.sources, context, |after| after > WORDS_AFTER_DESTINATION) {
            Some(source) => self.take_from(&source, &hint, context),
            None => (Tool::Finish, None),
        }
    }

    /// The candidate whose caption stands at the right place of the instruction; else one it knows nothing of;
    /// else the one that has most words in common with the instruction.
    fn choose(
        &self,
        candidates: &[ReceptacleId],
        context: &Context<'_>,
        is_right: impl Fn(usize) -> bool,
    ) -> Option<ReceptacleId> {
        let pool: Vec<&ReceptacleId> = candidates.iter().filter(|id| !self.rejected.contains(*id)).collect();
        let instruction = words(&context.briefing.instruction);
        let fits = |id: &ReceptacleId| {
            self.captions.get(id).is_some_and(|caption| words_after(&instruction, &words(caption)).is_some_and(&is_right))
        };
        let overlap = |id: &ReceptacleId| self.captions.get(id).map_or(0, |caption| share(&words(caption), &instruction));
        let known = pool.iter().find(|id| fits(id));
        let unknown = || pool.iter().find(|id| !self.captions.contains_key(**id));
        // `max_by_key` takes the last of equals; candidates come in order, so look from the back.
        let best = || pool.iter().rev().max_by_key(|id| overlap(id));
        known.or_else(unknown).or_else(best).map(|id| (*id).clone())
    }

    /// Looks for the object on a receptacle, and takes it.
    fn take_from(&mut self, source: &ReceptacleId, hint: &GoalHint, context: &Context<'_>) -> (Tool, Option<ReceptacleId>) {
        if self.at.as_ref() != Some(source) {
            return (Tool::NavTo { receptacle: source.clone() }, None);
        }
        if hint.sources.len() > 1 && !self.captions.contains_key(source) {
            if !self.marked {
                return (Tool::ShowReceptacles, None);
            }
            // It is not in view from its own viewpoint: nothing is known of it, which is something to know.
            self.captions.insert(source.clone(), String::new());
            return self.decide(context);
        }
        if self.is_shut(source, context) {
            return self.at_number(source, context, |marker| Tool::Open { marker });
        }
        if !self.probed {
            return (Tool::ShowObjectByCategory { category: hint.category.clone() }, None);
        }
        let fitting = self.fitting(hint, source);
        let underspecified = hint.caption.is_none() && self.reply.is_empty();
        if !self.asked && underspecified && (2..).contains(&fitting.len()) {
            self.asked = true;
            return (Tool::Ask { question: question(&self.view, Some(&hint.category)) }, None);
        }
        match fitting.first().map(|thing| thing.marker) {
            Some(Some(marker)) if !self.gazed => (Tool::GazeAt { marker }, None),
            Some(Some(marker)) => (Tool::Pick { marker }, None),
            _ if !self.walked => (Tool::WalkAround, None),
            _ => {
                self.rejected.insert(source.clone());
                self.decide(context)
            }
        }
    }

    /// What fits best of what was seen here: several where it cannot tell them apart.
    fn fitting(&self, hint: &GoalHint, source: &ReceptacleId) -> Vec<&Seen> {
        let told = words(&[&hint.category, hint.caption.as_deref().unwrap_or(""), &self.reply].join(" "));
        let here = |thing: &&Seen| thing.receptacle_hint.as_ref().is_none_or(|id| id == source);
        let mut things: Vec<(&Seen, usize)> = Vec::new();
        for thing in self.view.iter().filter(here) {
            let described = words(&[&thing.category, thing.caption.as_deref().unwrap_or("")].join(" "));
            things.push((thing, share(&described, &told)));
        }
        let of_category = things.iter().any(|(thing, _)| thing.category == hint.category);
        if of_category {
            things.retain(|(thing, _)| thing.category == hint.category);
        }
        let numbered = things.iter().any(|(thing, _)| thing.marker.is_some());
        let told_apart = hint.caption.is_some() || !self.reply.is_empty();
        let best = things.iter().map(|(_, share)| *share).max().filter(|_| told_apart);
        things.retain(|(_, share)| best.is_none_or(|best| *share == best));
        // Numbered ones first: only they can be taken.
        things.sort_by_key(|(thing, _)| thing.marker.is_none());
        if numbered || self.walked { things.into_iter().map(|(thing, _)| thing).collect() } else { Vec::new() }
    }

    /// Closes what it opened, then finishes.
    fn wrap_up(&mut self, context: &Context<'_>) -> (Tool, Option<ReceptacleId>) {
        let here = self.opened.iter().find(|id| self.at.as_ref() == Some(id));
        match here.or_else(|| self.opened.first()).cloned() {
            Some(door) => self.at_number(&door, context, |marker| Tool::Close { marker }),
            None => (Tool::Finish, None),
        }
    }

    /// Goes to the receptacle, gets it numbered, and uses the number.
    fn at_number(
        &mut self,
        receptacle: &ReceptacleId,
        context: &Context<'_>,
        call: impl Fn(u32) -> Tool,
    ) -> (Tool, Option<ReceptacleId>) {
        if self.at.as_ref() != Some(receptacle) {
            return (Tool::NavTo { receptacle: receptacle.clone() }, None);
        }
        if !self.marked {
            return (Tool::ShowReceptacles, None);
        }
        let is_it = |thing: &&Seen| thing.furniture && thing.receptacle_hint.as_ref() == Some(receptacle);
        let marker = context.seen.iter().filter(is_it).find_map(|thing| thing.marker);
        // The numbers hold for one use; the next one looks again.
        self.marked = false;
        match marker {
            Some(marker) => (call(marker), Some(receptacle.clone())),
            None => {
                self.failures += 1;
                self.rejected.insert(receptacle.clone());
                self.opened.remove(receptacle);
                self.doorless.insert(receptacle.clone());
                self.in_the_way = None;
                self.decide(context)
            }
        }
    }

    fn is_shut(&self, id: &ReceptacleId, context: &Context<'_>) -> bool {
        let category =
            context.briefing.receptacles.iter().find(|(known, ..)| known == id).map_or("", |(_, category, _)| category);
        let has_door = DOOR_WORDS.iter().any(|word| category.contains(word));
        has_door && !self.opened.contains(id) && !self.doorless.contains(id) && !self.rejected.contains(id)
    }
}

impl Policy for Planner {
    fn info(&self) -> PolicyInfo {
        policy::info("planner", self.seed)
    }

    fn wants_truth(&self) -> bool {
        false
    }

    fn act(&mut self, context: &Context<'_>) -> StepInput {
        self.learn(context);
        let (tool, receptacle) = self.decide(context);
        self.last = Some((tool.clone(), receptacle));
        StepInput { call: tool.to_call(), policy: None, user_reply: None }
    }

    fn watch(&mut self, context: &Context<'_>, input: &StepInput) {
        self.learn(context);
        let Ok(tool) = Tool::parse(&input.call) else { return };
        let numbered = |marker: u32| context.seen.iter().find(|thing| thing.marker == Some(marker));
        let mut receptacle = None;
        match &tool {
            Tool::Place { marker } | Tool::Open { marker } | Tool::Close { marker } => {
                receptacle = numbered(*marker).filter(|thing| thing.furniture).and_then(|thing| thing.receptacle_hint.clone());
                self.marked = false;
            }
            Tool::Pick { marker } if !self.holding => self.astray = !self.is_wanted(*marker, context),
            Tool::GazeAt { marker } => {
                // It has looked only where it looked at the thing it would take.
                self.gazed = false;
                if !self.is_wanted(*marker, context) {
                    return;
                }
            }
            Tool::ShowReceptacles => self.forget_view(),
            Tool::Ask { .. } => self.asked = true,
            _ => {}
        }
        self.last = Some((tool, receptacle));
        self.watched = true;
    }
}

/// Lower-case words without articles.
fn words(text: &str) -> Vec<String> {
    let parts = text.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    parts.map(str::to_lowercase).filter(|word| !["the", "a", "an"].contains(&word.as_str())).collect()
}

/// How many words of the text follow the last mention of the phrase; none where it is not mentioned.
fn words_after(text: &[String], phrase: &[String]) -> Option<usize> {
    if phrase.is_empty() {
        return None;
    }
    let start = text.windows(phrase.len()).rposition(|window| window == phrase)?;
    Some(text.len() - start - phrase.len())
}

/// Per mille of the words that stand among the others.
fn share(of: &[String], among: &[String]) -> usize {
    let common = of.iter().filter(|word| among.contains(word)).count();
    if of.is_empty() { 0 } else { common * 1000 / of.len() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mention_is_found_without_articles_and_case() {
        let text = words("Navigate to the table to place my snack, grasp it, and carry it to the Table much larger.");
        assert_eq!(words_after(&text, &words("the table much larger")), Some(0));
        assert!(words_after(&text, &words("table to place my snack")).unwrap() > WORDS_AFTER_DESTINATION);
        assert_eq!(words_after(&text, &words("the bed")), None);
        assert_eq!(words_after(&text, &[]), None);
    }

    #[test]
    fn a_share_is_of_the_first() {
        assert_eq!(share(&words("round green apple"), &words("the green one, an apple")), 666);
        assert_eq!(share(&[], &words("apple")), 0);
    }
}
