//! From the names that files give furniture and rooms to the categories of scenes.

/// What a name ends with or has in it, and the category. Of several that fit the first counts, so
/// the longer stand first.
const FURNITURE: &[(&str, &str)] = &[
    ("chest of drawers", "chest of drawers"),
    ("shelving unit", "shelf"),
    ("washing machine", "washing machine"),
    ("kitchen island", "counter"),
    ("shoe cabinet", "shoe cabinet"),
    ("wine cabinet", "cabinet"),
    ("garbage can", ""),
    ("trash can", ""),
    ("garbage bag", ""),
    ("dog bed", ""),
    ("tv stand", "tv stand"),
    ("tv cabinet", "tv stand"),
    ("tv bench", "tv stand"),
    ("night stand", "nightstand"),
    ("bed side", "nightstand"),
    ("coffee table", "table"),
    ("tea table", "tea table"),
    ("dining table", "table"),
    ("side table", "table"),
    ("end table", "table"),
    ("console table", "table"),
    ("counter top", "counter"),
    ("work top", "counter"),
    ("book case", "shelf"),
    ("book shelf", "shelf"),
    ("arm chair", "couch"),
    ("love seat", "couch"),
    ("coffeetable", "table"),
    ("diningtable", "table"),
    ("sidetable", "table"),
    ("countertop", "counter"),
    ("refrigerator", "refrigerator"),
    ("microwave", "microwave"),
    ("nightstand", "nightstand"),
    ("tvstand", "tv stand"),
    ("bookshelf", "shelf"),
    ("bookcase", "shelf"),
    ("sideboard", "cabinet"),
    ("credenza", "cabinet"),
    ("wardrobe", "cabinet"),
    ("cupboard", "cabinet"),
    ("cabinet", "cabinet"),
    ("closet", "cabinet"),
    ("drawers", "chest of drawers"),
    ("dresser", "chest of drawers"),
    ("counter", "counter"),
    ("armchair", "couch"),
    ("loveseat", "couch"),
    ("ottoman", "bench"),
    ("fridge", "refrigerator"),
    ("freezer", "refrigerator"),
    ("cooker", "electric cooker"),
    ("oven", "electric cooker"),
    ("washer", "washing machine"),
    ("couch", "couch"),
    ("shelves", "shelf"),
    ("shelf", "shelf"),
    ("bench", "bench"),
    ("table", "table"),
    ("sofa", "couch"),
    ("desk", "desk"),
    ("sink", "sink"),
    ("cab", "cabinet"),
    ("bed", "bed"),
];

/// Words that make a name that of something else: a desk lamp is no desk.
const OTHERS: &[&str] = &[
    "lamp", "light", "decor", "chair", "stool", "plant", "curtain", "painting", "mat", "cloth",
    "runner", "pillow", "bedsheet", "linen", "spread", "tennis", "football", "pool", "tray", "leg",
    "wall", "floor", "ceiling", "window", "door", "faucet",
];

/// Kinds of rooms by the letters of a name; the first that fits counts.
const ROOMS: &[(&str, &str)] = &[
    ("livingroom", "living room"),
    ("lounge", "living room"),
    ("familyroom", "living room"),
    ("bedroom", "bedroom"),
    ("diningroom", "dining room"),
    ("kitchen", "kitchen"),
    ("bathroom", "bathroom"),
    ("restroom", "toilet"),
    ("toilet", "toilet"),
    ("washroom", "washroom"),
    ("laundry", "washroom"),
    ("studyroom", "study room"),
    ("study", "study room"),
    ("office", "study room"),
    ("entry", "entry"),
    ("foyer", "entry"),
    ("balcony", "balcony"),
    ("corridor", "corridor"),
    ("hallway", "corridor"),
];

/// The category of furniture of a name, e.g. `Dresser_204_1` or `coffeeTable`; `None` for what
/// holds no objects or is not known.
pub(crate) fn furniture(name: &str) -> Option<&'static str> {
    let words = words(name);
    let joined = words.join(" ");
    // What comes last in a name is what it is: a table with "chair" before it is one for chairs.
    let last = FURNITURE
        .iter()
        .find(|(known, _)| joined == *known || joined.ends_with(&format!(" {known}")));
    let anywhere = || {
        let other = words.iter().any(|word| OTHERS.contains(&word.as_str()));
        let padded = format!(" {joined} ");
        let found = FURNITURE
            .iter()
            .find(|(known, _)| padded.contains(&format!(" {known} ")));
        found.filter(|_| !other)
    };
    let (_, category) = last.or_else(anywhere)?;
    (!category.is_empty()).then_some(category)
}

/// What people call a room of a name, e.g. `LivingRoom`, or `None` if the name does not say.
pub(crate) fn room(name: &str) -> Option<&'static str> {
    let letters: String = name
        .to_lowercase()
        .chars()
        .filter(|letter| letter.is_alphabetic())
        .collect();
    let found = ROOMS.iter().find(|(known, _)| letters.contains(known));
    found.map(|(_, kind)| *kind)
}

/// The name without its numbers: what things of one kind share, in reports.
pub(crate) fn kind_of(name: &str) -> String {
    let words = words(name);
    if words.is_empty() {
        name.to_owned()
    } else {
        words.join(" ")
    }
}

/// The lower-case words of a name, at signs, digits and capitals. Single letters are no words.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = ' ';
    for letter in name.chars() {
        let starts = !letter.is_alphabetic() || (letter.is_uppercase() && before.is_lowercase());
        if starts {
            words.push(String::new());
        }
        if letter.is_alphabetic() {
            words
                .last_mut()
                .expect("starts with one")
                .extend(letter.to_lowercase());
        }
        before = letter;
    }
    words.retain(|word| word.len() > 1);
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_all_sorts_have_a_category() {
        for (name, wanted) in [
            ("Dresser_204_1", Some("chest of drawers")),
            ("RoboTHOR_dresser_aneboda", Some("chest of drawers")),
            ("Coffee_Table_205_1", Some("table")),
            ("CoffeeTable|3|1", Some("table")),
            ("ShelvingUnit_1", Some("shelf")),
            ("TVStand_202_1", Some("tv stand")),
            ("TV_Stand_202_1", Some("tv stand")),
            ("cab_1_main_group", Some("cabinet")),
            ("kitchen_table_0", Some("table")),
            ("Fridge_7", Some("refrigerator")),
            ("SM_Bed_01", Some("bed")),
            ("Desk_Lamp_3", None),
            ("Dining_Chair", None),
            ("Bedroom", None),
            ("GarbageCan_2", None),
            ("", None),
        ] {
            assert_eq!(furniture(name), wanted, "{name}");
        }
        assert_eq!(room("LivingRoom"), Some("living room"));
        assert_eq!(room("room_bedroom_02"), Some("bedroom"));
        assert_eq!(room("Room"), None);
        assert_eq!(kind_of("Floor_Lamp_19"), "floor lamp");
    }
}
