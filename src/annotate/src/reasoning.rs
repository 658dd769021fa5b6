//! Why the next call is made, from what is known before it. Where what is known does not justify a
//! call, the reason is said to be a guess.

use reel_world::{ErrorCode, language};

use crate::{
    english,
    history::{last_sentence, why},
    memory::{Memory, appearance, description},
    step::{Call, MarkedItem, ObservedObject},
    task::{PublicReceptacle, ReceptacleRole},
    voice::{PhraseChooser, PhraseVariants},
    wordings::reasoning as say,
};

/// Most things that are compared one by one.
const COMPARED_MAX: usize = 5;

/// The reasoning of a decision.
pub(crate) fn reasoning(memory: &Memory<'_>, call: Call<'_>, voice: PhraseChooser) -> String {
    let reasoner = Reasoner {
        memory,
        call,
        voice,
    };
    let mut said = Vec::new();
    if let Some((failure, again)) = reasoner.failure() {
        said.extend(failure);
        if again {
            said.push(reasoner.tell(say::ONCE_MORE, &[]));
            return said.join(" ");
        }
    }
    match call.tool {
        tool if call.lacks_argument() => {
            said.push(reasoner.tell(say::CALL_OTHER, &[("tool", &english::quoted(tool))]))
        }
        "nav_to" => reasoner.going(&mut said),
        "show_object_by_category" => reasoner.looking(&mut said),
        "walk_around" => said.push(reasoner.walking()),
        "show_receptacles" => said.push(reasoner.marking()),
        "gaze_at" => said.push(reasoner.gazing()),
        "pick" => said.push(reasoner.picking()),
        "place" => said.push(reasoner.placing()),
        "open" => said.push(reasoner.opening()),
        "close" => said.push(reasoner.closing()),
        "ask" => said.push(reasoner.asking()),
        "finish" => said.push(reasoner.finishing()),
        "list_receptacles" => said.push(reasoner.tell(say::LIST_PLACES, &[])),
        tool => said.push(reasoner.tell(say::CALL_OTHER, &[("tool", &english::quoted(tool))])),
    }
    said.join(" ")
}

struct Reasoner<'m> {
    memory: &'m Memory<'m>,
    call: Call<'m>,
    voice: PhraseChooser,
}

impl Reasoner<'_> {
    fn tell(&self, wording: PhraseVariants, gaps: &[(&str, &str)]) -> String {
        self.voice.phrase(wording, self.memory.step, gaps)
    }

    /// What shall be moved, where a thing is described in the same sentence: not in
    /// the same words twice.
    fn object_beside(&self, thing: &ObservedObject<'_>) -> &str {
        let object = &self.memory.task.object;
        let said_already = language::quotes(object, &appearance(thing))
            || language::quotes(&appearance(thing), object.trim_start_matches("the "));
        if said_already {
            "what the task asks for"
        } else {
            object
        }
    }

    /// What went wrong before, and whether the same is tried again. An object that was not
    /// found is no surprise.
    fn failure(&self) -> Option<(Option<String>, bool)> {
        let last = self.memory.last?;
        let code = last.error?;
        let why = why(code, last.call);
        let times = self.memory.failures_in_a_row;
        let told = match code {
            _ if times > 1 => Some(self.tell(
                say::FAILED_REPEATEDLY,
                &[("times", &times.to_string()), ("why", &why)],
            )),
            ErrorCode::NothingFound if self.call.tool == "walk_around" => None,
            ErrorCode::NothingFound if self.memory.at.is_some() => Some(self.tell(
                say::SAW_NOTHING,
                &[("place", self.memory.at.unwrap_or_default())],
            )),
            _ => Some(self.tell(say::LAST_FAILED, &[("why", &why)])),
        };
        Some((told, last.call == self.call))
    }

    fn going(&self, said: &mut Vec<String>) {
        let (memory, task, id) = (self.memory, self.memory.task, self.call.argument);
        let Some(place) = task.receptacle(id) else {
            said.push(self.tell(say::UNKNOWN_PLACE, &[("place", id)]));
            return;
        };
        if let Some(held) = memory.held {
            let it = english::definite(&description(&held));
            let came_from = memory.held_from == Some(id);
            if memory.holds_it() || (task.destination.may_be(id) && !came_from) {
                said.push(self.tell(
                    say::CARRY,
                    &[("it", &it), ("phrase", &task.destination.phrase)],
                ));
                said.push(self.choice(&task.destination, place));
            } else {
                said.push(self.tell(say::RETURN_IT, &[("it", &it)]));
                said.push(self.tell(
                    if came_from {
                        say::CAME_FROM
                    } else {
                        say::HAVE_A_LOOK
                    },
                    &[("place", id)],
                ));
            }
        } else if let Some((thing, _)) = memory.placed.last().filter(|_| memory.is_done()) {
            let it = english::definite(&english::noun(thing.category));
            let open = memory.doors.get(id) == Some(&true);
            let purpose = if open { say::SHUT_IT } else { say::DELIVERED };
            said.push(self.tell(purpose, &[("it", &it), ("place", id)]));
            said.push(self.tell(say::HAVE_A_LOOK, &[("place", id)]));
        } else if !task.source.may_be(id)
            && task.destination.may_be(id)
            && memory.may_have_a_door(id)
        {
            said.push(self.tell(
                say::DOOR_FIRST,
                &[
                    ("object", task.object.as_str()),
                    ("phrase", &task.destination.phrase),
                ],
            ));
            said.push(self.choice(&task.destination, place));
        } else {
            said.push(self.tell(
                say::FETCH,
                &[
                    ("object", task.object.as_str()),
                    ("phrase", &task.source.phrase),
                ],
            ));
            said.push(self.choice(&task.source, place));
        }
    }

    /// Why this of all receptacles.
    fn choice(&self, role: &ReceptacleRole, place: &PublicReceptacle) -> String {
        let (memory, id) = (self.memory, place.id.as_str());
        let gap = [("place", id)];
        let seen_before = memory.visited.contains(&id);
        let Some(at) = memory.at.and_then(|at| memory.task.receptacle(at)) else {
            return self.first_choice(role, place);
        };
        if at.id == id {
            self.tell(say::STAY_CLOSE, &gap)
        } else if role.may_be(id) && seen_before {
            self.tell(say::BACK_TO_IT, &gap)
        } else if role.may_be(id) && role.may_be(&at.id) {
            let doubtful = role.is_description(memory.task) && !role.describes(at);
            let wording = if doubtful {
                say::NEXT_OF_SEVERAL
            } else {
                say::ALSO_POSSIBLE
            };
            self.tell(wording, &[gap[0], ("at", &at.id)])
        } else {
            self.first_choice(role, place)
        }
    }

    fn first_choice(&self, role: &ReceptacleRole, place: &PublicReceptacle) -> String {
        let id = place.id.as_str();
        let kind = place.kind();
        let (place_gap, kind_gap) = (("place", id), ("kind", kind.as_str()));
        let possible = role.possible(self.memory.task);
        if !possible.contains(&id) {
            self.tell(
                say::GUESS_PLACE,
                &[place_gap, ("kind", &english::indefinite(&kind))],
            )
        } else if possible.len() > 1 {
            let places = english::list(&possible, "and");
            self.tell(
                say::ONE_OF_SEVERAL,
                &[
                    ("count", &possible.len().to_string()),
                    ("places", &places),
                    place_gap,
                ],
            )
        } else if role.alike.len() == 1 {
            self.tell(say::ONLY_ONE, &[place_gap, kind_gap])
        } else {
            self.tell(
                say::THE_ONE_IN_ROOM,
                &[place_gap, kind_gap, ("room", &place.room)],
            )
        }
    }

    fn looking(&self, said: &mut Vec<String>) {
        let (memory, task, query) = (self.memory, self.memory.task, self.call.argument);
        let arrived = memory
            .last
            .is_some_and(|last| last.call.tool == "nav_to" && last.error.is_none());
        if let Some(place) = memory
            .at
            .and_then(|at| task.receptacle(at))
            .filter(|_| arrived)
        {
            let gap = ("place", place.id.as_str());
            let phrase = ("phrase", task.source.phrase.as_str());
            said.push(match () {
                () if memory.held.is_some() || !task.source.may_be(&place.id) => {
                    self.tell(say::HERE, &[gap])
                }
                () if task.source.describes(place) => self.tell(say::HERE_IT_IS, &[gap, phrase]),
                () => self.tell(say::HERE_MAYBE, &[gap, phrase]),
            });
        }
        let what = english::sought(query);
        let matches = |thing: &&ObservedObject<'_>| {
            language::is_a(thing.category, query) && memory.may_be_meant(thing)
        };
        said.push(if let Some(thing) = memory.in_view.iter().find(matches) {
            let object = self.object_beside(thing);
            let thing = english::indefinite(&description(thing));
            self.tell(
                say::LOOK_AT_SEEN,
                &[("thing", &thing), ("what", &what), ("object", object)],
            )
        } else if let Some(purpose) = task
            .purpose
            .as_deref()
            .filter(|purpose| language::is_a(query, purpose))
        {
            self.tell(
                say::LOOK_FOR_KIND,
                &[("what", &what), ("kind", &english::indefinite(purpose))],
            )
        } else if language::quotes(&task.instruction, query) && memory.held.is_none() {
            self.tell(
                say::LOOK_FOR_IT,
                &[("what", &what), ("object", &task.object)],
            )
        } else {
            self.tell(say::LOOK_FOR_OTHER, &[("what", &what)])
        });
    }

    fn walking(&self) -> String {
        let memory = self.memory;
        let place = ("place", memory.at.unwrap_or("the place where I am"));
        let looked = memory
            .last
            .filter(|last| last.call.tool == "show_object_by_category");
        match looked {
            Some(last) if last.error == Some(ErrorCode::NothingFound) => self.tell(
                say::WALK_TO_FIND,
                &[place, ("what", &english::sought(last.call.argument))],
            ),
            Some(_) => self.tell(
                say::WALK_TO_COMPARE,
                &[place, ("object", &memory.task.object)],
            ),
            None => self.tell(say::WALK_AROUND, &[place]),
        }
    }

    fn marking(&self) -> String {
        let (memory, task) = (self.memory, self.memory.task);
        if let Some(held) = memory.held {
            let it = english::definite(&english::noun(held.category));
            let back = memory
                .held_from
                .filter(|from| !memory.holds_it() && memory.at == Some(from));
            let phrase = back.unwrap_or(&task.destination.phrase);
            return self.tell(say::MARK_TO_PLACE, &[("it", &it), ("phrase", phrase)]);
        }
        match memory.at {
            Some(at) if memory.doors.get(at) == Some(&true) => {
                self.tell(say::MARK_TO_CLOSE, &[("place", at)])
            }
            Some(at)
                if memory.wants_opening(at)
                    && (task.source.may_be(at) || task.destination.may_be(at)) =>
            {
                self.tell(say::MARK_TO_OPEN, &[("place", at)])
            }
            _ => self.tell(say::MARK_TO_SEE, &[]),
        }
    }

    fn gazing(&self) -> String {
        let (memory, marker) = (self.memory, ("marker", self.call.argument));
        let thing = match memory.marked(self.call) {
            Some(MarkedItem::Object(_)) if memory.held.is_some() => {
                return self.tell(say::GAZE_BLIND, &[marker]);
            }
            Some(MarkedItem::Object(thing)) => thing,
            Some(MarkedItem::Receptacle(id)) => {
                return self.tell(say::GAZE_PLACE, &[marker, ("place", id)]);
            }
            None => return self.tell(say::GAZE_BLIND, &[marker]),
        };
        let looks = english::indefinite(&description(&thing));
        let (looks, object) = (
            ("looks", looks.as_str()),
            ("object", self.object_beside(&thing)),
        );
        if !memory.may_be_meant(&thing) {
            return self.tell(say::GAZE_UNSURE, &[marker, looks, object]);
        }
        if let Some(reply) = memory
            .replies
            .last()
            .filter(|reply| language::names_object(reply))
        {
            return self.tell(
                say::GAZE_ANSWERED,
                &[("reply", &english::quoted(reply)), marker, looks],
            );
        }
        let others: Vec<(u32, ObservedObject<'_>)> = memory
            .numbered()
            .filter(|(_, other)| other.key != thing.key)
            .collect();
        let unlike = others.iter().all(|(_, other)| !memory.may_be_meant(other));
        if others.is_empty() || !unlike || others.len() > COMPARED_MAX {
            return self.tell(say::GAZE_FITS, &[marker, looks, object]);
        }
        let others: Vec<String> = others
            .iter()
            .map(|(number, other)| {
                format!(
                    "marker {number} is {}",
                    english::indefinite(&description(other))
                )
            })
            .collect();
        self.tell(
            say::GAZE_AMONG,
            &[
                marker,
                looks,
                object,
                ("others", &english::list(&others, "and")),
            ],
        )
    }

    fn picking(&self) -> String {
        let (memory, marker) = (self.memory, ("marker", self.call.argument));
        let Some(MarkedItem::Object(thing)) =
            memory.marked(self.call).filter(|_| memory.held.is_none())
        else {
            return self.tell(say::PICK_BLIND, &[marker]);
        };
        let looks = english::indefinite(&description(&thing));
        let gaps = [
            marker,
            ("looks", looks.as_str()),
            ("object", self.object_beside(&thing)),
        ];
        let close = memory.last.is_some_and(|last| {
            last.call.tool == "gaze_at"
                && last.error.is_none()
                && last.call.marker() == self.call.marker()
        });
        match (memory.may_be_meant(&thing), close) {
            (true, true) => self.tell(say::PICK_READY, &gaps),
            (true, false) => self.tell(say::PICK_NOW, &gaps),
            (false, _) => self.tell(say::PICK_UNSURE, &gaps),
        }
    }

    fn placing(&self) -> String {
        let (memory, task) = (self.memory, self.memory.task);
        let marker = ("marker", self.call.argument);
        let it = memory.held.map_or("what I should have".to_owned(), |held| {
            english::definite(&english::noun(held.category))
        });
        let it = ("it", it.as_str());
        let (Some(_), Some(MarkedItem::Receptacle(id))) = (memory.held, memory.marked(self.call))
        else {
            return self.tell(say::PLACE_BLIND, &[marker, it]);
        };
        let place = ("place", id);
        let destination = task.destination.may_be(id) && memory.held_from != Some(id);
        match (memory.holds_it(), destination) {
            (true, true) => self.tell(
                say::PLACE_HERE,
                &[marker, it, place, ("phrase", &task.destination.phrase)],
            ),
            (false, false) => self.tell(say::PLACE_BACK, &[marker, it, place]),
            _ => self.tell(say::PLACE_GUESS, &[marker, it, place]),
        }
    }

    fn opening(&self) -> String {
        let (memory, task) = (self.memory, self.memory.task);
        let marker = ("marker", self.call.argument);
        let Some(MarkedItem::Receptacle(id)) =
            memory.marked(self.call).filter(|_| memory.held.is_none())
        else {
            return self.tell(say::OPEN_BLIND, &[marker]);
        };
        let source = task.source.may_be(id)
            && task
                .receptacle(id)
                .is_some_and(|place| task.source.describes(place));
        let wording = if task.destination.may_be(id) && !source {
            say::OPEN_FOR_IT
        } else {
            say::OPEN_TO_SEE
        };
        self.tell(wording, &[marker, ("place", id), ("object", &task.object)])
    }

    fn closing(&self) -> String {
        let marker = ("marker", self.call.argument);
        match self.memory.marked(self.call) {
            Some(MarkedItem::Receptacle(id)) => self.tell(say::CLOSE_IT, &[marker, ("place", id)]),
            _ => self.tell(say::CLOSE_BLIND, &[marker]),
        }
    }

    fn asking(&self) -> String {
        let (memory, task) = (self.memory, self.memory.task);
        let role = if memory.held.is_some() {
            &task.destination
        } else {
            &task.source
        };
        if asks_where(
            self.call.argument,
            task.receptacles.iter().map(|place| place.category.as_str()),
        ) {
            return self.tell(say::ASK_WHERE, &[("phrase", &role.phrase)]);
        }
        let candidates = memory.candidates();
        let object = ("object", task.object.as_str());
        if memory.asked || candidates.len() < 2 || candidates.len() > COMPARED_MAX {
            return self.tell(say::ASK_UNCLEAR, &[object]);
        }
        let things: Vec<String> = candidates
            .iter()
            .map(|thing| english::indefinite(&description(thing)))
            .collect();
        self.tell(
            say::ASK_AMONG,
            &[
                object,
                ("count", &things.len().to_string()),
                ("list", &english::list(&things, "and")),
            ],
        )
    }

    fn finishing(&self) -> String {
        let memory = self.memory;
        let name = |thing: &ObservedObject<'_>| english::definite(&english::noun(thing.category));
        match (memory.held, memory.placed.last()) {
            (Some(held), _) => self.tell(say::FINISH_HOLDING, &[("it", &name(&held))]),
            (None, Some((thing, place))) if memory.is_done() => {
                self.tell(say::FINISH_DONE, &[("it", &name(thing)), ("place", place)])
            }
            _ => self.tell(say::FINISH_STUCK, &[("object", &memory.task.object)]),
        }
    }
}

/// Whether a question is about a place: `where`, or `which table` that no other noun follows.
fn asks_where<'a>(question: &str, mut furniture: impl Iterator<Item = &'a str>) -> bool {
    let words = language::words(last_sentence(question));
    let verb =
        |word: &String| ["should", "shall", "do", "is", "are", "can"].contains(&word.as_str());
    let mut which = words
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| pair[0] == "which");
    words.iter().any(|word| word == "where")
        || which.any(|(at, pair)| {
            furniture.any(|kind| kind == pair[1]) && words.get(at + 2).is_none_or(verb)
        })
}
