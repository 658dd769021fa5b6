//! A second set of replies of a user that gives things away, in 20 more ways, and honest replies as
//! language models word them. Written without looking at the checker.

use reel_world::{Receptacle, Scene, Task};

/// What is done, and what is said.
pub type Reply = (&'static str, fn(&Task, &Scene) -> String);

/// More ways to give away the exact place or a raw id: name, and what is said.
pub const LEAKS: [Reply; 20] = [
    ("id cut off", |task, _| {
        let id = task.target.as_str().trim_start_matches('_');
        let asset = task.target_object().asset.as_str().trim_start_matches('_');
        let is_hash = asset.len() > 16 && asset.chars().all(|letter| letter.is_ascii_hexdigit());
        let cut = if is_hash {
            &id[..8]
        } else {
            &id[..asset.len() + 3]
        };
        let category = &task.target_object().category;
        format!("I'm looking for the {category} (ID: {cut}...).")
    }),
    ("number sign", |task, scene| {
        let (name, number) = (spoken(&source(task, scene).category), number(task));
        format!("Try {name} #{number}. I'm fairly sure that's where I saw it last.")
    }),
    ("id in camel case", |task, scene| {
        let name = camel(&spoken(&source(task, scene).category));
        format!("Please head to {name}{} first.", number(task))
    }),
    ("possessive of an id, number in words", |task, scene| {
        let name = spoken(&source(task, scene).category).replace(' ', "-");
        let number = in_words(number(task));
        format!("Could you check {name}-{number}'s surface again? You may have missed it.")
    }),
    ("room id", |task, scene| {
        let room = &source(task, scene).room;
        format!("No problem! The room you are looking for is {room}, so please search there.")
    }),
    ("world state in Markdown", |task, scene| {
        let mut lines = vec!["Here's what I know so far:".to_owned()];
        for (room, ids) in scene.rooms_and_furniture() {
            let room = room.split('/').next().unwrap_or_default();
            lines.push(format!("* **{}**", spoken(room)));
            for id in ids {
                let receptacle = scene.receptacle(id).expect("a receptacle of the scene");
                let content = content(task, scene, receptacle);
                lines.push(format!("    * {}: {content}", spoken(&receptacle.category)));
            }
        }
        lines.join("\n")
    }),
    ("percentages", |task, scene| {
        let [across, deep] = fractions(task, scene).map(|part| (part * 100.0).round());
        format!(
            "Imagine you look down on it: go about {across}% of the way across and {deep}% of the \
             way in, and there it is."
        )
    }),
    ("along, and the wall", |task, scene| {
        let (along, wall) = along(task, scene);
        format!("It's lying {along}, {wall}.")
    }),
    ("steps", |task, scene| {
        let other = others(task, scene)[0];
        let paces = (squared_distance(task, other).sqrt() / 0.7).round();
        let steps = match paces {
            ..2.0 => "one step".to_owned(),
            2.0 => "a couple of steps".to_owned(),
            ..6.0 => "a few steps".to_owned(),
            _ => format!("maybe {paces} paces"),
        };
        let name = spoken(&other.category);
        format!("You're so close! It's only {steps} from the {name}.")
    }),
    ("as you enter", |task, scene| {
        let [right, far] = in_room(task, scene);
        let side = if right { "right" } else { "left" };
        let end = if far {
            "at the far end"
        } else {
            "close to the door"
        };
        let room = room_called(source(task, scene));
        format!("As you enter the {room}, turn to your {side}-hand side; it's {end}.")
    }),
    ("company", |task, scene| match company(task).as_slice() {
        [] => {
            let [one, other] = [0, 1].map(|index| spoken(&others(task, scene)[index].category));
            format!("Whatever it sits atop is flanked by the {one} and the {other}.")
        }
        [one] => format!("There's only {one} keeping it company, so it should be easy to spot."),
        [one, other, ..] => format!("It's sitting there, flanked by {one} and {other}."),
    }),
    ("question, by another name", |task, scene| {
        let src = source(task, scene);
        let (name, room) = (called(src), inside(room_called(src)));
        let half = half_if_said(task, scene);
        format!("Hmm, that's odd. Have you tried the {name} {room}{half} yet?")
    }),
    ("what the furniture is for", |task, scene| {
        let src = source(task, scene);
        let (used, room) = (use_of(src), inside(&spoken(src.room_name())));
        let half = half_if_said(task, scene);
        format!("It's on the piece of furniture {room} {used}{half}.")
    }),
    ("passed", |task, scene| {
        let other = spoken(&others(task, scene)[0].category);
        format!("If you have reached the {other}, you have just passed it. Turn around!")
    }),
    ("apology and a clue", |task, scene| {
        format!(
            "I apologize, but I'm not allowed to disclose the exact location. Here's a clue about \
             what it rests upon, though: {}.",
            clue(task, scene)
        )
    }),
    ("elimination", |task, scene| {
        let src = source(task, scene);
        let room = inside(&spoken(src.room_name()));
        let half = half_if_said(task, scene);
        let others: Vec<String> = scene
            .receptacles
            .iter()
            .filter(|other| other.room == src.room && other.id != src.id)
            .map(|other| {
                let alike = other.category == src.category;
                let other_word = if alike { "other " } else { "" };
                format!("not the {other_word}{}", spoken(&other.category))
            })
            .collect();
        if others.is_empty() {
            let name = called(src);
            format!("There's just a single {name} {room}, and you can't go wrong with it{half}.")
        } else {
            let others = others.join(", ");
            format!("Well, {others}. That leaves only one candidate {room}{half}.")
        }
    }),
    ("height", |task, scene| {
        let height = source(task, scene).surface_height();
        let body = match height {
            ..0.55 => "knee",
            ..0.82 => "hip",
            _ => "waist",
        };
        let centimetres = (height * 100.0).round();
        format!("It rests at about {body} height, some {centimetres} cm off the ground.")
    }),
    ("compass", |task, scene| {
        let [east, north] = in_room(task, scene);
        let north = if north { "north" } else { "south" };
        let east = if east { "eastern" } else { "western" };
        let room = room_called(source(task, scene));
        format!("Sure thing. Make your way to the {north}{east} part of the {room}.")
    }),
    ("how to reach it", |task, scene| {
        let [across, deep] = fractions(task, scene);
        let reach = if deep > 0.5 {
            "reach all the way across"
        } else {
            "there's no need to reach far, it's right before you"
        };
        let slide = if across > 0.5 {
            "rightwards"
        } else {
            "leftwards"
        };
        format!("Yes. Once you're standing there, {reach}, then move your gripper {slide}.")
    }),
    ("closer than", |task, scene| {
        let others = others(task, scene);
        let distance = |other: &Receptacle| squared_distance(task, other);
        let far = others
            .iter()
            .max_by(|a, b| distance(a).total_cmp(&distance(b)))
            .expect("a scene has furniture of several kinds");
        let near = others
            .iter()
            .find(|other| distance(other) < distance(far))
            .expect("not all are equally far");
        let [near, far] = [near, far].map(|other| spoken(&other.category));
        format!("I can't tell you the spot, only that it's closer to the {near} than the {far}.")
    }),
];

/// More replies that give nothing away.
pub const HONEST: [Reply; 20] = [
    ("keep looking around", |task, scene| {
        let room = spoken(source(task, scene).room_name());
        format!("Thanks for the update! Please keep looking around the {room}, you're doing great.")
    }),
    ("take your time", |_, _| {
        "Take your time, there's no rush at all. I only need it near the end of the day.".into()
    }),
    ("left as a verb", |_, _| {
        "I'm sorry, I can't recall where exactly I left it. I left the house in a hurry this \
         morning and had a lot on my mind."
            .into()
    }),
    ("over there", |task, scene| {
        let room = inside(&spoken(source(task, scene).room_name()));
        format!(
            "It should be somewhere over there {room}. When you get a second, could you have \
             another look around?"
        )
    }),
    ("second look", |_, _| {
        "I'd give it a second look, just to be on the safe side. I trust your eyes more than my \
         memory!"
            .into()
    }),
    ("room, used last", |task, scene| {
        let room = inside(room_called(source(task, scene)));
        format!(
            "Hmm, if I remember correctly, I last used it {room}. Don't hold me to that, though."
        )
    }),
    ("destination by another name", |task, scene| {
        let name = called(destination(task, scene));
        format!("As soon as you have it, please bring it over to the {name}. Thank you so much!")
    }),
    ("new home", |task, scene| {
        let dest = destination(task, scene);
        let caption = definite(dest.main_caption().unwrap_or(&dest.category));
        format!("Its new home will be {caption}. Any free spot there will do, I'm not picky.")
    }),
    ("looks", |task, _| {
        let target = task.target_object();
        let words = target.attributes.values().flatten();
        let words: Vec<&str> = words.map(String::as_str).collect();
        if words.is_empty() {
            return format!("It's just an ordinary {}, really.", target.category);
        }
        format!(
            "Sure, let me describe it: the one I have in mind is {}. Hopefully that narrows it \
             down a bit!",
            words.join(" and ")
        )
    }),
    ("not that colour", |task, _| {
        let colour = other_colour(task);
        format!("Oh, sorry for the confusion! Not the {colour} one, mine looks different.")
    }),
    ("the rest can stay", |task, _| {
        let wanted = task.purpose.as_deref().unwrap_or("thing");
        let category = &task.target_object().category;
        format!(
            "The {category} is the {wanted} I was talking about earlier; the rest can stay right \
             where they are."
        )
    }),
    ("yes, that is right", |_, _| {
        "Yes, that's right! That's exactly the one I had in mind. Please go ahead and pick it up."
            .into()
    }),
    ("the latter", |_, _| {
        "Good question! Between the two you described, I'd go with the latter. Thanks for \
         double-checking before you grab anything."
            .into()
    }),
    ("doors", |_, _| {
        "Some of our furniture has doors, so remember to open them and check what's inside before \
         you move on."
            .into()
    }),
    ("back at five", |_, _| {
        "I'll be back around five o'clock, so there's plenty of time left. Just let me know once \
         it's done."
            .into()
    }),
    ("just one", |_, _| {
        "Just one will do, there's no need to collect them all. Then again, please make sure it's \
         the right one."
            .into()
    }),
    ("careful", |_, _| {
        "On top of that, please be careful with it: keep it upright, and don't set it down too \
         close to an edge."
            .into()
    }),
    ("as said", |task, _| {
        format!(
            "As I said at the beginning: {} That's really all I can tell you for now.",
            task.instruction
        )
    }),
    ("size", |task, _| {
        let longest = task.target_object().size.into_iter().fold(0.02, f64::max);
        format!(
            "It's about {:.0} centimetres at its longest, so you should be able to carry it \
             without any trouble.",
            longest * 100.0
        )
    }),
    ("before bed", |task, _| {
        let category = &task.target_object().category;
        format!("I'd like to have the {category} tonight before I go to bed, if that's possible.")
    }),
];

/// Words of an instruction that tell the room without naming it.
const HINTS: [(&str, &[&str]); 5] = [
    ("dining room", &["dinner"]),
    ("living room", &["tv", "couch"]),
    ("bedroom", &["bed", "nightstand"]),
    (
        "kitchen",
        &[
            "stove",
            "cooker",
            "fridge",
            "refrigerator",
            "microwave",
            "counter",
        ],
    ),
    ("washing room", &["washing"]),
];

/// Words in captions that are no clue.
const EMPTY_WORDS: [&str; 11] = [
    "the", "a", "with", "and", "in", "on", "of", "to", "where", "one", "my",
];

fn source<'a>(task: &Task, scene: &'a Scene) -> &'a Receptacle {
    scene
        .receptacle(&task.src)
        .expect("the source is in the scene")
}

fn destination<'a>(task: &Task, scene: &'a Scene) -> &'a Receptacle {
    scene
        .receptacle(&task.dest)
        .expect("the destination is in the scene")
}

/// The number at the end of an id: `2` of `couch_2`.
fn number(task: &Task) -> &str {
    let id = task.src.as_str();
    id.rsplit_once('_').map_or(id, |(_, number)| number)
}

fn in_words(number: &str) -> &str {
    const NUMBERS: [&str; 13] = [
        "zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten",
        "eleven", "twelve",
    ];
    let value: Option<usize> = number.parse().ok();
    value
        .and_then(|value| NUMBERS.get(value).copied())
        .unwrap_or(number)
}

/// `chestOfDrawers` for `chest of drawers`.
fn camel(name: &str) -> String {
    let mut words = name.split(' ');
    let mut camel = words.next().unwrap_or_default().to_owned();
    for word in words {
        let (first, rest) = word.split_at(1);
        camel += &format!("{}{rest}", first.to_uppercase());
    }
    camel
}

/// What lies on a receptacle, as a line of a list.
fn content(task: &Task, scene: &Scene, receptacle: &Receptacle) -> String {
    let there = task
        .objects
        .iter()
        .filter(|object| object.receptacle == receptacle.id);
    let names: Vec<String> = there
        .map(|object| {
            let is_target = object.instance == task.target;
            let half = if is_target {
                half_if_said(task, scene)
            } else {
                String::new()
            };
            format!("{}{half}", object.category)
        })
        .collect();
    if names.is_empty() {
        "nothing".to_owned()
    } else {
        names.join(" + ")
    }
}

/// Up to two things on the same receptacle, the nearest first.
fn company(task: &Task) -> Vec<String> {
    let target = task.target_object();
    let [x, y, _] = target.position;
    let distance = |[ox, oy, _]: [f64; 3]| (ox - x) * (ox - x) + (oy - y) * (oy - y);
    let mut there: Vec<_> = task
        .objects
        .iter()
        .filter(|other| other.receptacle == target.receptacle && other.instance != target.instance)
        .collect();
    there.sort_by(|a, b| distance(a.position).total_cmp(&distance(b.position)));
    let mut names: Vec<String> = there
        .iter()
        .map(|other| {
            if other.category == target.category {
                format!("another {}", other.category)
            } else {
                format!("the {}", other.category)
            }
        })
        .collect();
    names.dedup();
    names.truncate(2);
    names
}

/// Furniture of other categories than the source, each category once: first what the instruction
/// does not name, in the same room, and near.
fn others<'a>(task: &Task, scene: &'a Scene) -> Vec<&'a Receptacle> {
    let src = source(task, scene);
    let order = |other: &Receptacle| {
        let is_elsewhere = other.room != src.room;
        (is_elsewhere, says(task, &other.category))
    };
    let mut others: Vec<&Receptacle> = scene
        .receptacles
        .iter()
        .filter(|other| spoken(&other.category) != spoken(&src.category))
        .collect();
    others.sort_by(|a, b| {
        let [far, farther] = [a, b].map(|other| squared_distance(task, other));
        order(a).cmp(&order(b)).then(far.total_cmp(&farther))
    });
    let mut seen: Vec<&str> = Vec::new();
    others.retain(|other| {
        let is_new = !seen.contains(&other.category.as_str());
        seen.push(&other.category);
        is_new
    });
    others
}

/// From the target to the middle of a piece of furniture.
fn squared_distance(task: &Task, receptacle: &Receptacle) -> f64 {
    let ([x, y, _], [cx, cy]) = (task.target_object().position, centre(receptacle));
    (cx - x) * (cx - x) + (cy - y) * (cy - y)
}

fn centre(receptacle: &Receptacle) -> [f64; 2] {
    [0, 1].map(|axis| (receptacle.surface_min[axis] + receptacle.surface_max[axis]) / 2.0)
}

/// Where the target is on the surface: 0 to 1 on both axes.
fn fractions(task: &Task, scene: &Scene) -> [f64; 2] {
    let (src, position) = (source(task, scene), task.target_object().position);
    [0, 1].map(|axis| {
        let [low, high] = [src.surface_min[axis], src.surface_max[axis]];
        ((position[axis] - low) / (high - low)).clamp(0.0, 1.0)
    })
}

/// Where the target is along the surface, and how it is to the nearest wall.
fn along(task: &Task, scene: &Scene) -> (&'static str, &'static str) {
    let src = source(task, scene);
    let width = |axis: usize| src.surface_max[axis] - src.surface_min[axis];
    let parts = fractions(task, scene);
    let along = match parts[usize::from(width(1) > width(0))] {
        ..0.35 => "near one end",
        ..0.65 => "halfway along",
        _ => "towards the far end",
    };
    let room = scene.rooms.iter().find(|room| room.name == src.room);
    let walls = room.into_iter().flat_map(|room| {
        [0, 1].into_iter().flat_map(move |axis| {
            let low = src.surface_min[axis] - room.min[axis];
            let high = room.max[axis] - src.surface_max[axis];
            [(low, axis, false), (high, axis, true)]
        })
    });
    let nearest = walls.min_by(|(gap, ..), (other, ..)| gap.total_cmp(other));
    let (_, axis, is_high) = nearest.unwrap_or((0.0, 1, true));
    let wall = if (parts[axis] > 0.5) == is_high {
        "pushed back towards the wall"
    } else {
        "away from the wall"
    };
    (along, wall)
}

/// Whether the target is in the upper half of its room, on both axes.
fn in_room(task: &Task, scene: &Scene) -> [bool; 2] {
    let (src, position) = (source(task, scene), task.target_object().position);
    let room = scene.rooms.iter().find(|room| room.name == src.room);
    [0, 1].map(|axis| {
        let middle = room.map_or(0.0, |room| (room.min[axis] + room.max[axis]) / 2.0);
        position[axis] > middle
    })
}

/// What the captions of the source say and the instruction does not; or else furniture and room,
/// and the half if it says them too.
fn clue(task: &Task, scene: &Scene) -> String {
    let src = source(task, scene);
    let said = format!(
        "{} {} {} {}",
        task.instruction,
        src.room_name(),
        spoken(src.room_name()),
        src.category
    );
    let said: Vec<String> = words(&said).collect();
    let is_new = |word: &String| !said.contains(word) && !EMPTY_WORDS.contains(&word.as_str());
    let new_words = |caption: &&String| words(caption).filter(is_new).count();
    let newest = src.captions.keys().max_by_key(new_words);
    match newest {
        Some(caption) if new_words(&caption) > 0 => {
            let caption: Vec<String> = words(caption).collect();
            let first = caption.iter().position(is_new).unwrap_or_default();
            let last = caption.iter().rposition(is_new).unwrap_or_default();
            caption[first..=last].join(" ")
        }
        _ => {
            let (name, room) = (called(src), inside(&spoken(src.room_name())));
            format!("{name}, {room}{}", half_if_said(task, scene))
        }
    }
}

/// The half of the surface where the target is, if the instruction says both furniture and room.
fn half_if_said(task: &Task, scene: &Scene) -> String {
    let src = source(task, scene);
    let room = spoken(src.room_name());
    let hints = HINTS
        .iter()
        .find(|(name, _)| *name == room)
        .map_or(&[] as &[&str], |(_, hints)| hints);
    let is_room_said = says(task, &room) || hints.iter().any(|hint| says(task, hint));
    let is_name_said = says(task, &src.category) || says(task, called(src));
    if !(is_room_said && is_name_said) {
        return String::new();
    }
    let side = if fractions(task, scene)[0] > 0.5 {
        "right"
    } else {
        "left"
    };
    format!(" (the {side}-hand half of it)")
}

fn says(task: &Task, name: &str) -> bool {
    spoken(&task.instruction.to_lowercase()).contains(&spoken(name))
}

/// Another name of a piece of furniture.
fn called(receptacle: &Receptacle) -> &str {
    match (receptacle.category.as_str(), receptacle.room_name()) {
        ("table", "dining room" | "dinning room") => "dining table",
        ("table", "living room") | ("tea table", _) => "coffee table",
        ("table", "balcony") => "patio table",
        ("table", _) => "small table",
        ("desk", _) => "workstation",
        ("cabinet", _) => "cupboard",
        ("bed", _) => "mattress",
        ("couch", _) => "sofa",
        ("shelf", _) => "bookcase",
        ("shoe cabinet", _) => "shoe rack",
        ("chest of drawers", _) => "dresser",
        ("nightstand", _) => "bedside table",
        ("tv stand", _) => "media console",
        ("counter", _) => "worktop",
        ("sink", _) => "washbasin",
        ("refrigerator", _) => "fridge",
        ("fridge", _) => "refrigerator",
        ("microwave", _) => "microwave oven",
        ("electric cooker" | "electriccooker", _) => "stove",
        ("washing machine" | "washingmachine", _) => "washer",
        ("pot", _) => "saucepan",
        ("potlid", _) => "lid of the saucepan",
        (category, _) => category,
    }
}

/// What one does with a piece of furniture.
fn use_of(receptacle: &Receptacle) -> &'static str {
    match (receptacle.category.as_str(), receptacle.room_name()) {
        ("table", "living room") => "where the snacks go during a film",
        ("table", "balcony") => "where we have coffee outdoors",
        ("table", _) => "where we eat",
        ("tea table", _) => "where the teapot goes",
        ("desk", _) => "where somebody works on a computer",
        ("cabinet", _) => "where odds and ends get stored",
        ("bed", _) => "where people sleep",
        ("couch", _) => "where we sit down together",
        ("shelf", _) => "where the books are kept",
        ("shoe cabinet", _) => "where the shoes are kept",
        ("chest of drawers", _) => "where the socks are kept",
        ("nightstand", _) => "where one's glasses go at night",
        ("tv stand", _) => "where the television belongs",
        ("counter", _) => "where we chop vegetables",
        ("sink", _) => "where we wash our hands",
        ("refrigerator" | "fridge", _) => "where the milk stays cold",
        ("microwave", _) => "where leftovers get warm",
        ("electric cooker" | "electriccooker", _) => "where the cooking happens",
        ("washing machine" | "washingmachine", _) => "where dirty clothes go",
        ("pot", _) => "where soup simmers",
        ("potlid", _) => "that covers the soup",
        _ => "where such things are kept",
    }
}

/// Another name of its room.
fn room_called(receptacle: &Receptacle) -> &str {
    match receptacle.room_name() {
        "living room" => "lounge",
        "dining room" | "dinning room" => "dining area",
        "study room" => "study",
        "washroom" | "washingroom" => "laundry room",
        "corridor" => "hallway",
        "entry" => "entrance hall",
        room => room,
    }
}

fn inside(room: &str) -> String {
    let at = if room == "balcony" { "on" } else { "in" };
    format!("{at} the {room}")
}

/// A colour that the target does not have, if possible that of another object.
fn other_colour(task: &Task) -> &str {
    let target = task.target_object();
    let caption = target.caption.as_deref().unwrap_or_default().to_lowercase();
    let own: Vec<&String> = target.attributes.values().flatten().collect();
    let others = task
        .objects
        .iter()
        .filter_map(|object| object.attributes.get("colour"));
    others
        .flatten()
        .map(String::as_str)
        .chain(["green", "purple", "orange"])
        .find(|colour| {
            let is_own = own.iter().any(|word| word.as_str() == *colour);
            !is_own && !caption.contains(colour)
        })
        .unwrap_or("other")
}

/// As people write it: some published names are misspelled or written together.
fn spoken(name: &str) -> String {
    name.replace("dinning", "dining")
        .replace("washingroom", "washing room")
        .replace("washingmachine", "washing machine")
        .replace("electriccooker", "electric cooker")
        .replace("potlid", "pot lid")
}

/// `the small red mug` for `A small red mug.`
fn definite(caption: &str) -> String {
    let caption = caption.trim().trim_end_matches('.');
    let bare = ["A ", "An ", "The ", "a ", "an ", "the "]
        .iter()
        .find_map(|article| caption.strip_prefix(article))
        .unwrap_or(caption);
    format!("the {bare}")
}

fn words(text: &str) -> impl Iterator<Item = String> {
    text.split(|letter: char| !letter.is_alphanumeric())
        .filter(|word| !word.is_empty())
        .map(str::to_lowercase)
}
