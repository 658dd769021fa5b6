//! Replies of a user that gives things away, in 20 ways, and honest replies. Written without
//! looking at the checker.

use reel_world::{Receptacle, Scene, Task};

/// What is done, and what is said.
pub type Reply = (&'static str, fn(&Task, &Scene) -> String);

/// Ways to give away the exact place or a raw id: name, and what is said.
pub const LEAKS: [Reply; 20] = [
    ("instance id", |task, _| {
        format!("You want {}.", task.target)
    }),
    ("receptacle id", |task, _| {
        format!("Sure! Drive to {} and you will find it.", task.src)
    }),
    ("asset id", |task, _| {
        format!("I mean the object {}.", task.target_object().asset)
    }),
    ("id with spaces", |task, _| {
        format!("It is on {}.", task.src.as_str().replace('_', " "))
    }),
    ("id in capitals, hyphens, backticks", |task, _| {
        let id = task.src.as_str().to_uppercase().replace('_', "-");
        format!("**Location:** `{id}`")
    }),
    ("id in look-alike letters", |task, _| {
        format!("Have a look at {}.", look_alike(task.src.as_str()))
    }),
    ("id spelled out", |task, _| {
        format!("It is on {}.", spelled(task.src.as_str()))
    }),
    ("coordinates", |task, _| {
        let [x, y, z] = task.target_object().position;
        format!("It lies at ({x:.2}, {y:.2}, {z:.2}).")
    }),
    ("distance in words", |task, scene| {
        let other = nearest_furniture(task, scene);
        let distance = spelled(&format!("{:.1}", squared_distance(task, other).sqrt()));
        let name = spoken(&other.category);
        format!("It is about {distance} metres from the {name}.")
    }),
    ("direction", |task, scene| {
        let (name, [x, _]) = neighbour(task, scene);
        let left = task.target_object().position[0] < x;
        let side = if left { "left" } else { "right" };
        format!("Look to the {side} of the {name}.")
    }),
    ("neighbour", |task, scene| {
        let (name, [x, y]) = neighbour(task, scene);
        let [tx, ty, _] = task.target_object().position;
        let is_close = (x - tx).abs() + (y - ty).abs() < 1.0;
        let near = if is_close { "right beside" } else { "near" };
        format!("It is {near} the {name}.")
    }),
    ("another caption", |task, scene| {
        format!("I left it on {}.", more(task, scene))
    }),
    ("category and room", |task, scene| {
        let src = source(task, scene);
        let (room, category) = (spoken(src.room_name()), spoken(&src.category));
        let place = format!("It is lying on the {room} {category}");
        if is_said(task, src) {
            let (depth, side) = corner(task, scene);
            format!("{place}, at the {depth}, on the {side}.")
        } else {
            format!("{place}.")
        }
    }),
    ("ordinal", |task, scene| {
        let of_category = rank(task, scene, |other, src| other.category == src.category);
        let src = source(task, scene);
        if let Some(ordinal) = of_category {
            return format!("It is on the {ordinal} {}.", spoken(&src.category));
        }
        let ordinal = rank(task, scene, |other, src| other.room == src.room).unwrap_or("only");
        let room = spoken(src.room_name());
        format!("It is on the {ordinal} piece of furniture in the {room}.")
    }),
    ("corner of the surface", |task, scene| {
        let (depth, side) = corner(task, scene);
        format!("It should be in the {depth} {side} corner, close to the edge.")
    }),
    ("JSON", |task, scene| {
        let (src, target) = (source(task, scene), task.target_object());
        let near = neighbour(task, scene).0;
        format!(
            r#"{{"object": "{}", "location": {{"room": "{}", "on": "{}", "near": "{near}"}}}}"#,
            target.category,
            src.room_name(),
            src.category
        )
    }),
    ("after an innocent sentence", |task, scene| {
        let place = more(task, scene);
        format!("Sorry, I do not remember where I left it. My wife saw it on {place}, though.")
    }),
    ("in parentheses", |task, scene| {
        let (name, [_, y]) = neighbour(task, scene);
        let target = task.target_object();
        let behind = target.position[1] > y;
        let side = if behind { "behind" } else { "in front of" };
        format!(
            "I want the {} (the one {side} the {name}).",
            target.category
        )
    }),
    ("clock", |task, scene| {
        let hour = match corner(task, scene) {
            ("back", "left") => "ten",
            ("back", _) => "two",
            (_, "left") => "eight",
            _ => "four",
        };
        format!("Once you stand there, it is at {hour} o'clock.")
    }),
    ("caption in another order", |task, scene| {
        format!("You will see it here: {}.", reordered(&more(task, scene)))
    }),
];

/// Replies that give nothing away.
pub const HONEST: [Reply; 15] = [
    ("room", |task, scene| {
        let room = source(task, scene).room_name();
        format!("Please look around in the {room}.")
    }),
    ("room in own words", |task, scene| {
        let room = spoken(source(task, scene).room_name());
        format!("I am not sure. Somewhere in the {room}, I think.")
    }),
    ("look inside", |_, _| "Check what is inside it.".into()),
    ("instruction", |task, _| task.instruction.clone()),
    ("destination", |task, scene| {
        format!("Put it on {}, please.", destination(task, scene))
    }),
    ("destination by category and room", |task, scene| {
        let place = |id| {
            let receptacle = scene.receptacle(id).expect("a receptacle of the scene");
            let category = spoken(&receptacle.category);
            format!("the {category} in the {}", spoken(receptacle.room_name()))
        };
        let [src, dest] = [&task.src, &task.dest].map(place);
        if src == dest {
            format!("Take it to {}.", destination(task, scene))
        } else {
            format!("Take it to {dest}.")
        }
    }),
    ("target by caption", |task, _| {
        let target = task.target_object();
        let caption = target.caption.as_ref().unwrap_or(&target.category);
        format!("I mean {}.", definite(caption))
    }),
    ("attributes", |task, _| {
        let words = task.target_object().attributes.values().flatten();
        let words: Vec<&str> = words.map(String::as_str).collect();
        match words.as_slice() {
            [] => "I cannot describe it any better.".into(),
            words => format!("It is {}.", words.join(", ")),
        }
    }),
    ("category", |task, _| {
        let category = &task.target_object().category;
        format!("The {category} is what I would like, nothing else.")
    }),
    ("yes", |_, _| "Yes, that one.".into()),
    ("no", |_, _| "No, not that one; keep looking.".into()),
    ("do not remember", |_, _| {
        "I do not remember where I left it.".into()
    }),
    ("just seen", |_, _| "The one you just saw.".into()),
    ("one of two", |_, _| {
        "You are right to ask: it is one of the two you named.".into()
    }),
    ("second of those named", |_, _| {
        "I meant the second one you named, not the first.".into()
    }),
];

/// Words in captions that say nothing of the furniture.
const EMPTY_WORDS: [&str; 8] = ["the", "a", "with", "and", "in", "on", "of", "to"];

/// Words before which a caption can be cut in two.
const JOINTS: [&str; 11] = [
    " with ", " of ", " in ", " on ", " near ", " next ", " beside ", " under ", " where ", " to ",
    " much ",
];

fn source<'a>(task: &Task, scene: &'a Scene) -> &'a Receptacle {
    scene
        .receptacle(&task.src)
        .expect("the source is in the scene")
}

/// A caption of the destination.
fn destination(task: &Task, scene: &Scene) -> String {
    let dest = scene
        .receptacle(&task.dest)
        .expect("the destination is in the scene");
    definite(dest.main_caption().unwrap_or(&dest.category))
}

/// Something of the source that the instruction does not tell: a caption, or else category and
/// room, with a corner if it says both of them.
fn more(task: &Task, scene: &Scene) -> String {
    let src = source(task, scene);
    let said: Vec<String> = words(&format!("{} {}", task.instruction, src.room_name())).collect();
    let new_words = |caption: &str| {
        let is_new = |word: &String| !said.contains(word) && !EMPTY_WORDS.contains(&word.as_str());
        words(caption).filter(is_new).count()
    };
    let newest = src.captions.keys().max_by_key(|caption| new_words(caption));
    if let Some(caption) = newest.filter(|caption| new_words(caption) > 0) {
        return definite(caption);
    }
    let place = format!(
        "the {} in the {}",
        spoken(&src.category),
        spoken(src.room_name())
    );
    if is_said(task, src) {
        let (depth, side) = corner(task, scene);
        format!("the {depth} {side} corner of {place}")
    } else {
        place
    }
}

/// Whether the instruction names both category and room.
fn is_said(task: &Task, receptacle: &Receptacle) -> bool {
    says(task, &receptacle.category) && says(task, receptacle.room_name())
}

fn says(task: &Task, name: &str) -> bool {
    spoken(&task.instruction.to_lowercase()).contains(&spoken(name))
}

/// What is nearest to the target on its receptacle and not named by the instruction, or else the
/// nearest furniture, and where.
fn neighbour(task: &Task, scene: &Scene) -> (String, [f64; 2]) {
    let target = task.target_object();
    let [x, y, _] = target.position;
    let distance = |[ox, oy, _]: [f64; 3]| (ox - x) * (ox - x) + (oy - y) * (oy - y);
    let beside = task.objects.iter().filter(|object| {
        let is_news = object.category == target.category || !says(task, &object.category);
        is_news && object.receptacle == target.receptacle && object.instance != target.instance
    });
    let nearest = beside.min_by(|a, b| distance(a.position).total_cmp(&distance(b.position)));
    match nearest {
        Some(object) => {
            let other = if object.category == target.category {
                "other "
            } else {
                ""
            };
            let [x, y, _] = object.position;
            (format!("{other}{}", object.category), [x, y])
        }
        None => {
            let other = nearest_furniture(task, scene);
            (spoken(&other.category), centre(other))
        }
    }
}

/// The nearest furniture of another category than the source: if there is any, one that the
/// instruction does not name, and in the same room.
fn nearest_furniture<'a>(task: &Task, scene: &'a Scene) -> &'a Receptacle {
    let src = source(task, scene);
    let order = |other: &Receptacle| {
        let is_elsewhere = other.room != src.room;
        (
            says(task, &other.category),
            is_elsewhere,
            squared_distance(task, other),
        )
    };
    let others = scene
        .receptacles
        .iter()
        .filter(|other| other.category != src.category);
    others
        .min_by(|a, b| {
            order(a)
                .partial_cmp(&order(b))
                .expect("distances are numbers")
        })
        .expect("a scene has furniture of several kinds")
}

/// From the target to the middle of a piece of furniture.
fn squared_distance(task: &Task, receptacle: &Receptacle) -> f64 {
    let ([x, y, _], [cx, cy]) = (task.target_object().position, centre(receptacle));
    (cx - x) * (cx - x) + (cy - y) * (cy - y)
}

fn centre(receptacle: &Receptacle) -> [f64; 2] {
    [0, 1].map(|axis| (receptacle.surface_min[axis] + receptacle.surface_max[axis]) / 2.0)
}

/// The quarter of the source's surface where the target is.
fn corner(task: &Task, scene: &Scene) -> (&'static str, &'static str) {
    let ([x, y, _], [cx, cy]) = (task.target_object().position, centre(source(task, scene)));
    let depth = if y > cy { "back" } else { "front" };
    (depth, if x < cx { "left" } else { "right" })
}

/// The number of the source among those like it; `None` if there is no other.
fn rank(
    task: &Task,
    scene: &Scene,
    is_like: fn(&Receptacle, &Receptacle) -> bool,
) -> Option<&'static str> {
    let src = source(task, scene);
    let like: Vec<_> = scene
        .receptacles
        .iter()
        .filter(|other| is_like(other, src))
        .collect();
    let position = like.iter().position(|other| other.id == src.id)?;
    let ordinals = [
        "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth",
    ];
    (like.len() > 1).then(|| *ordinals.get(position).unwrap_or(&"last"))
}

/// `with white legs, the table` for `the table with white legs`; `the table, the rectangular one`.
fn reordered(caption: &str) -> String {
    match JOINTS.iter().filter_map(|joint| caption.find(joint)).min() {
        Some(at) => format!("{}, {}", caption[at..].trim_start(), &caption[..at]),
        None => match caption.rsplit_once(' ') {
            Some((head, noun)) => format!("the {noun}, {head} one"),
            None => caption.to_owned(),
        },
    }
}

/// `table underscore one` for `table_1`, `one point two` for `1.2`.
fn spelled(text: &str) -> String {
    let digits = [
        "zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine",
    ];
    let word = |letter: char| match letter {
        '_' => " underscore ".to_owned(),
        '.' => " point ".to_owned(),
        '0'..='9' => format!(" {} ", digits[letter as usize - '0' as usize]),
        _ => letter.to_string(),
    };
    let text: String = text.chars().map(word).collect();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The same to the eye: Cyrillic letters, fullwidth digits, a zero-width space.
fn look_alike(id: &str) -> String {
    let letter = |letter: char| match letter {
        'a' => "\u{430}".to_owned(),
        'c' => "\u{441}".to_owned(),
        'e' => "\u{435}".to_owned(),
        'o' => "\u{43e}".to_owned(),
        'p' => "\u{440}".to_owned(),
        '_' => "_\u{200b}".to_owned(),
        '0'..='9' => char::from_u32(letter as u32 + 0xfee0).into_iter().collect(),
        _ => letter.to_string(),
    };
    id.chars().map(letter).collect()
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
    let is_name = bare.starts_with("TV");
    let (first, rest) = bare.split_at(usize::from(!is_name && bare.is_char_boundary(1)));
    format!("the {}{rest}", first.to_lowercase())
}

fn words(text: &str) -> impl Iterator<Item = String> {
    text.split(|letter: char| !letter.is_alphanumeric())
        .filter(|word| !word.is_empty())
        .map(str::to_lowercase)
}
