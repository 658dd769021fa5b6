//! What the language module promises, on small cases.

use proptest::prelude::*;

use super::*;

fn categories(query: &str, present: &[&str]) -> (MatchKind, Vec<String>) {
    let found = match_category(query, &present.iter().copied().collect());
    (found.kind, found.categories)
}

fn object(category: &str, caption: &str) -> ObjectInstance {
    ObjectInstance {
        instance: "a_on_table_1_at_t".into(),
        asset: "a".into(),
        category: category.into(),
        caption: (!caption.is_empty()).then(|| caption.to_owned()),
        attributes: attribute_words(caption),
        size: [0.1; 3],
        position: [0.0; 3],
        yaw: 0.0,
        receptacle: "table_1".into(),
        reference_rest: None,
    }
}

#[test]
fn the_best_kind_of_match_wins() {
    use MatchKind::{Exact, Hypernym, Lemma, None, Synonym};
    let kitchen = [
        "apple",
        "pear",
        "mug",
        "alarm clock",
        "clock",
        "cell phone",
        "remote control",
        "bowl",
    ];
    let cases: &[(&str, MatchKind, &[&str])] = &[
        ("clock", Exact, &["clock"]),
        ("alarm clock", Exact, &["alarm clock"]),
        ("The Apples", Lemma, &["apple"]),
        ("cellphone", Lemma, &["cell phone"]),
        ("smartphone", Synonym, &["cell phone"]),
        ("remote", Synonym, &["remote control"]),
        ("fruit", Hypernym, &["apple", "pear"]),
        ("food", Hypernym, &["apple", "pear"]),
        ("cup", Hypernym, &["mug"]),
        ("timekeeping devices", Hypernym, &["alarm clock", "clock"]),
        ("electronics", Hypernym, &["cell phone", "remote control"]),
        ("shiny red apple", Hypernym, &["apple"]),
        ("something to serve food", Hypernym, &["bowl"]),
        ("elephant", None, &[]),
        ("", None, &[]),
    ];
    for (query, kind, expected) in cases {
        let expected = (*kind, expected.iter().map(ToString::to_string).collect());
        assert_eq!(categories(query, &kitchen), expected, "{query}");
    }
    assert_eq!(
        categories("alarm clock", &["clock", "apple"]),
        (Hypernym, vec!["clock".into()])
    );
    assert_eq!(
        categories("washing machine", &["washingmachine"]),
        (Lemma, vec!["washingmachine".into()])
    );
    assert_eq!(
        categories("fridge", &["refrigerator"]),
        (Synonym, vec!["refrigerator".into()])
    );
    assert_eq!(
        categories("sofa", &["couch"]),
        (Synonym, vec!["couch".into()])
    );
    assert_eq!(
        categories("gizmo", &["gizmos"]),
        (Lemma, vec!["gizmos".into()])
    );
}

#[test]
fn every_category_of_the_benchmark_has_a_hypernym() {
    let categories = "alarm clock, apple, avocado, banana, basket, bell pepper, binder, book, bowl, bowl plate, broccoli, bun, cake, \
        calculator, cara, cleaning spray, clock, coffee maker, cookie, decorative ball, decorative bowl, decorative box, \
        decorative figure, desk clock, dessert, egg, figurine, fruit, hand soap, hand wash, headphones, hourglass, ice cream, \
        keyboard, laptop, lemon, lettuce, magazine, marker, meat, mouse, muffin, notebook, notepad, nut, orange, orange apple, \
        peanut, pear, pen, pencil, pepper, pie, plate, remote, remote control, saucer, soap, soap dispenser, soup, stylus, sushi, \
        teddy bear, timer, tomato, towel, tray, vegetable, watch";
    for category in categories.split(", ") {
        assert!(vocabulary().known(&normal(category)), "{category}");
        assert!(
            vocabulary().lineage(&normal(category)).len() > 1,
            "{category}"
        );
    }
}

#[test]
fn captions_give_their_attribute_words_in_order() {
    let found = attribute_words(
        "Semi-transparent glass bowl, round and shallow, with a grey, light-blue rim; spiral-bound.",
    );
    assert_eq!(
        found["colour"],
        ["semi-transparent", "grey", "light", "blue"]
    );
    assert_eq!(found["material"], ["glass"]);
    assert_eq!(found["shape"], ["round", "shallow", "spiral-bound"]);
    assert_eq!(found["size"], ["shallow"]);
    assert!(attribute_words("a thing").is_empty());
}

#[test]
fn a_precise_instruction_fits_only_its_object() {
    let text = "Head over to white desk in front of a picture, fetch the slender yellow hexagonal pencil with a sharpened tip and \
        pink eraser at the end, and bring it back to the table where we have dinner.";
    let target = object(
        "pencil",
        "Slender yellow hexagonal pencil with a sharpened tip and pink eraser at the end.",
    );
    assert!(fits(text, &target, None));
    assert!(!fits(
        text,
        &object(
            "pencil",
            "Cylindrical wooden pencil with a sharp tip, smooth finish, and visible graphite core."
        ),
        None
    ));
    assert!(!fits(
        text,
        &object("pen", "Slender yellow pen with a pink cap."),
        None
    ));
    let orange = "Take a pen from wide desk with orange drawer pulls and put it on the table.";
    assert!(
        !fits(orange, &object("orange", "A ripe orange."), None),
        "an orange drawer is no orange"
    );
}

#[test]
fn a_fuzzy_instruction_fits_all_that_serve_the_purpose() {
    let text = "Take a fruit from the couch in front of the TV and put it on the red table.";
    let green = object("apple", "Round green apple.");
    assert!(fits(text, &green, Some("fruit")));
    assert!(fits(text, &object("banana", "Curved yellow banana."), None));
    assert!(!fits(text, &object("pen", "Blue pen."), Some("fruit")));
    let vague = "I need something to write with.";
    assert!(fits(
        vague,
        &object("pencil", "Yellow pencil."),
        Some("writing instrument")
    ));
}

#[test]
fn replies_narrow_down() {
    let red = object("apple", "Round, glossy red apple with a slender stem.");
    let green = object("apple", "Green apple with small speckles.");
    let pear = object("pear", "Yellow pear.");
    let unknown = object("apple", "");
    #[rustfmt::skip]
    let cases = [
        ("I mean the red one.", [true, false, false, true]),
        ("Yes, the crimson apple.", [true, false, false, true]),
        ("No, not the pear.", [true, true, false, true]),
        ("Not the red one, the green one.", [false, true, false, false]),
        ("Please bring it to the table where we have dinner.", [true, true, true, true]),
        ("Do you mean the wooden apple?", [true, true, false, true]),
        ("Is it the apple with small speckles?", [false, true, false, true]),
    ];
    for (text, expected) in cases {
        let found = [&red, &green, &pear, &unknown].map(|object| fits(text, object, None));
        assert_eq!(found, expected, "{text}");
    }
}

#[test]
fn a_quoted_caption_settles_it() {
    let bear = object(
        "teddy bear",
        "A teddy bear figure with a round body, outstretched arms.",
    );
    assert!(fits(
        "Transport the a teddy bear figure with a round body, outstretched arms at bed to the table.",
        &bear,
        None
    ));
    assert!(quotes(
        "put it on The Rounded, rectangular table!",
        "the rounded rectangular table"
    ));
    assert!(!quotes(
        "the rounded table",
        "the rounded rectangular table"
    ));
}

proptest! {
    #[test]
    fn any_text_gets_an_answer(text in ".{0,200}", caption in ".{0,80}", category in ".{0,20}") {
        let _ = fits(&text, &object(&category, &caption), Some(&text));
        let _ = match_category(&text, &[category.as_str(), caption.as_str()].into_iter().collect());
    }

    #[test]
    fn a_category_matches_itself_in_either_number(index in 0..6usize) {
        let name = ["apple", "teddy bear", "box", "knife", "strawberry", "potato"][index];
        let plural = ["apples", "teddy bears", "boxes", "knives", "strawberries", "potatoes"][index];
        prop_assert_eq!(categories(plural, &[name]), (MatchKind::Lemma, vec![name.to_owned()]));
    }
}
