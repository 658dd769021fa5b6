//! The classes of English words that a History is made of: what a verb means, and the small words
//! around it. Knows no episode and no sentence.

use std::{collections::BTreeMap, sync::LazyLock};

/// What a verb says was done, or is so.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub(crate) enum Act {
    Go,
    /// Taking something somewhere, as in `bring` or `deliver`.
    Carry,
    /// Walking around a receptacle.
    Explore,
    /// Looking at a place in any way.
    Check,
    /// Looking for a thing.
    Search,
    /// Seeing or finding something, as in `spot` or `notice`.
    See,
    /// Marking things or receptacles with numbers.
    Mark,
    Gaze,
    Pick,
    Hold,
    /// `get`: picking, holding or going.
    Get,
    Place,
    Open,
    Close,
    Ask,
    /// The user says something, as in `answer` or `prefer`.
    Say,
    Finish,
    /// Leaving a thing somewhere.
    Leave,
    /// A place has a thing.
    Contain,
    /// Attempting what follows, as in `try to`.
    Try,
    /// `fail to`; `it failed`
    Fail,
    /// Success of an action, as in `it succeeded` or `it worked`.
    Succeed,
    /// `manage to`, `proceed to`: what follows was done.
    Manage,
    /// A copula: is, remains.
    Be,
    /// Holding or containing, by its subject.
    Have,
    /// Any other call: `throw`.
    Call,
}

/// The form of a verb.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Form {
    Base,
    /// Third person of the present: `holds`.
    Present,
    Past,
    Participle,
    /// Past or participle: `visited`.
    PastOrParticiple,
    /// Base, past and participle in one form, as in `put`.
    Any,
    Gerund,
}

/// A verb in a form.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Verb {
    pub(crate) act: Act,
    pub(crate) form: Form,
    /// Base form of the verb, e.g. `pick`.
    pub(crate) base: &'static str,
    /// Past form, e.g. `picked`; the base form if `form` is `Present`.
    pub(crate) past: &'static str,
}

/// Verbs by act: base, past, participle, gerund.
#[rustfmt::skip]
const VERBS: &[(Act, &str)] = &[
    (
        Act::Go,
        "go went gone going,navigate navigated navigated navigating,visit visited visited visiting,reach reached reached reaching,\
         arrive arrived arrived arriving,travel traveled traveled traveling,travel travelled travelled travelling,\
         drive drove driven driving,come came come coming,return returned returned returning,head headed headed heading,\
         walk walked walked walking,step stepped stepped stepping,approach approached approached approaching,\
         move moved moved moving,relocate relocated relocated relocating,enter entered entered entering",
    ),
    (
        Act::Carry,
        "bring brought brought bringing,transport transported transported transporting,deliver delivered delivered delivering,\
         transfer transferred transferred transferring",
    ),
    (
        Act::Explore,
        "explore explored explored exploring,circle circled circled circling,tour toured toured touring",
    ),
    (
        Act::Check,
        "check checked checked checking,inspect inspected inspected inspecting,examine examined examined examining,\
         scan scanned scanned scanning,investigate investigated investigated investigating,survey surveyed surveyed surveying",
    ),
    (
        Act::Search,
        "search searched searched searching,look looked looked looking,seek sought sought seeking,hunt hunted hunted hunting",
    ),
    (
        Act::See,
        "see saw seen seeing,find found found finding,spot spotted spotted spotting,notice noticed noticed noticing,\
         detect detected detected detecting,observe observed observed observing,discover discovered discovered discovering,\
         identify identified identified identifying,locate located located locating",
    ),
    (
        Act::Mark,
        "mark marked marked marking,highlight highlighted highlighted highlighting,show showed shown showing,\
         display displayed displayed displaying,label labeled labeled labeling,list listed listed listing",
    ),
    (
        Act::Gaze,
        "gaze gazed gazed gazing,focus focused focused focusing,focus focussed focussed focussing,stare stared stared staring",
    ),
    (
        Act::Pick,
        "pick picked picked picking,grab grabbed grabbed grabbing,grasp grasped grasped grasping,take took taken taking,\
         lift lifted lifted lifting,collect collected collected collecting,retrieve retrieved retrieved retrieving,\
         fetch fetched fetched fetching,remove removed removed removing,acquire acquired acquired acquiring",
    ),
    (Act::Hold, "hold held held holding,carry carried carried carrying"),
    (Act::Get, "get got got getting,get got gotten getting,obtain obtained obtained obtaining"),
    (
        Act::Place,
        "place placed placed placing,put put put putting,set set set setting,drop dropped dropped dropping,\
         deposit deposited deposited depositing,store stored stored storing,lay laid laid laying,release released released releasing",
    ),
    (Act::Open, "open opened opened opening"),
    (Act::Close, "close closed closed closing,shut shut shut shutting"),
    (
        Act::Ask,
        "ask asked asked asking,consult consulted consulted consulting,inquire inquired inquired inquiring,query queried queried querying",
    ),
    (
        Act::Say,
        "say said said saying,answer answered answered answering,reply replied replied replying,respond responded responded responding,\
         tell told told telling,confirm confirmed confirmed confirming,clarify clarified clarified clarifying,\
         specify specified specified specifying,explain explained explained explaining,indicate indicated indicated indicating,\
         state stated stated stating,mention mentioned mentioned mentioning,mean meant meant meaning,want wanted wanted wanting,\
         choose chose chosen choosing,select selected selected selecting,prefer preferred preferred preferring",
    ),
    (
        Act::Finish,
        "finish finished finished finishing,end ended ended ending,terminate terminated terminated terminating",
    ),
    (Act::Leave, "leave left left leaving"),
    (Act::Contain, "contain contained contained containing"),
    (Act::Try, "try tried tried trying,attempt attempted attempted attempting"),
    (Act::Fail, "fail failed failed failing"),
    (Act::Succeed, "succeed succeeded succeeded succeeding,work worked worked working"),
    (
        Act::Manage,
        "manage managed managed managing,proceed proceeded proceeded proceeding,continue continued continued continuing",
    ),
    (
        Act::Be,
        "remain remained remained remaining,stay stayed stayed staying,stand stood stood standing",
    ),
    (Act::Call, "throw threw thrown throwing,push pushed pushed pushing"),
];

/// Third persons of the present that state how things are.
const PRESENTS: &[(&str, Act, &str)] = &[
    ("holds", Act::Hold, "hold"),
    ("contains", Act::Contain, "contain"),
    ("remains", Act::Be, "remain"),
    ("stays", Act::Be, "stay"),
    ("stands", Act::Be, "stand"),
    ("lies", Act::Be, "lie"),
    ("sits", Act::Be, "sit"),
    ("says", Act::Say, "say"),
    ("wants", Act::Say, "want"),
    ("means", Act::Say, "mean"),
    ("fails", Act::Fail, "fail"),
    ("carries", Act::Hold, "carry"),
];

static TABLE: LazyLock<BTreeMap<&'static str, Verb>> = LazyLock::new(|| {
    let mut table = BTreeMap::new();
    for (act, rows) in VERBS {
        for row in rows.split(',') {
            let forms: Vec<&'static str> = row.split_whitespace().collect();
            let [base, past, participle, gerund] = forms[..] else {
                unreachable!("a verb has four forms: {row}")
            };
            let mut add = |word, form| {
                table.entry(word).or_insert(Verb {
                    act: *act,
                    form,
                    base,
                    past,
                });
            };
            if base == past {
                add(base, Form::Any);
            }
            add(base, Form::Base);
            if past == participle {
                add(past, Form::PastOrParticiple);
            }
            add(past, Form::Past);
            add(participle, Form::Participle);
            add(gerund, Form::Gerund);
        }
    }
    for (word, act, base) in PRESENTS {
        table.insert(
            word,
            Verb {
                act: *act,
                form: Form::Present,
                base,
                past: base,
            },
        );
    }
    table
});

/// How a phrase stands to its verb.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Prep {
    /// The object of the verb.
    Direct,
    From,
    To,
    /// At, on, in, inside or into a place.
    At,
    /// Near, next to: no claim about the place itself.
    Near,
    For,
    With,
    About,
    Of,
    /// By, as, like: nothing a claim needs.
    Other,
}

/// What joins two clauses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Link {
    And,
    Or,
    But,
    /// `then`, `afterwards`: in this order.
    Then,
    After,
    Before,
    /// `because`, `since`: the reason of what stands before.
    Because,
    /// `while`, `when`, `which`, `that`: begins a clause.
    Sub,
}

/// The class of a lower-case word in a sentence.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Class {
    Determiner,
    /// Negation of a noun: `no`, `nothing`, `none`.
    No,
    /// Negation of a verb: `not`, `never`.
    Not,
    /// `without`: what follows was not done.
    Without,
    /// Word for all of a kind: `all`, `both`, `every`.
    All,
    /// Word for something else or more: `other`, `else`, `another`.
    Other,
    Only,
    Have,
    /// The bool: present tense.
    Be(bool),
    Been,
    Did,
    /// `could`, `can`: with a negation, a failure.
    Can,
    /// `will`, `should`, `need`: an intention.
    Will,
    /// `maybe`, `if`, `think`: nothing is claimed from here on.
    Hedge,
    To,
    Prep(Prep),
    Link(Link),
    /// `I`, `we`, `the robot`.
    Agent,
    /// Pronoun for things named before: `it`, `them`.
    It,
    There,
    /// Word for the user: `user`, `they`.
    User,
    /// Word for the robot's gripper: `hand`, `gripper`.
    Hand,
    Number(u32),
    /// Number of repetitions: 1 for `once`, 2 for `twice`.
    Times(u32),
    /// `marker`, `number`: a marker's number follows.
    Marker,
    /// Ability: true for `able`, false for `unable`.
    Able(bool),
    /// State that a copula gives its subject: `empty`, `bare`.
    Empty,
    /// State that a copula gives its subject: `free`.
    Free,
    /// State of being seen: `visible`, `view`.
    Visible,
    Door,
    /// Word for the most recent action: `last`, `latest`.
    Last,
    /// Noun for something that the agent did: `action`, `call`, `attempt`.
    Doing,
    /// Outcome: true for `successfully` and `success`, false for `unsuccessful`.
    Success(bool),
    /// `there`, `again`: says nothing.
    Adverb,
    Verb,
    Noun,
}

/// What a lower-case word is.
pub(crate) fn class(word: &str) -> Class {
    match word {
        "a" | "an" | "the" | "my" | "your" | "our" | "its" | "their" | "this" | "these"
        | "those" | "some" | "any" | "his" | "her" => Class::Determiner,
        "no" | "nothing" | "none" | "neither" => Class::No,
        "not" | "never" | "hardly" => Class::Not,
        "without" => Class::Without,
        "all" | "both" | "every" | "each" => Class::All,
        "other" | "others" | "another" | "else" | "more" | "different" | "further"
        | "additional" | "remaining" | "rest" => Class::Other,
        "only" | "just" | "solely" | "exactly" => Class::Only,
        "have" | "has" | "had" | "having" => Class::Have,
        "am" | "is" | "are" => Class::Be(true),
        "was" | "were" => Class::Be(false),
        "be" | "been" | "being" => Class::Been,
        "did" | "do" | "does" => Class::Did,
        "can" | "could" => Class::Can,
        "will" | "would" | "should" | "shall" | "must" | "may" | "might" | "need" | "needs"
        | "needed" | "plan" | "planning" | "let" | "lets" | "intend" | "decided" | "supposed"
        | "ready" | "require" | "requires" => Class::Will,
        "if" | "whether" | "unless" | "maybe" | "perhaps" | "probably" | "possibly" | "likely"
        | "think" | "thought" | "believe" | "believed" | "assume" | "assumed" | "guess"
        | "suspect" | "expect" | "expected" | "hope" | "hoping" | "seems" | "seemed"
        | "appears" | "appeared" | "apparently" | "goal" | "task" | "instruction" | "plans"
        | "todo" | "remember" => Class::Hedge,
        "to" | "toward" | "towards" => Class::To,
        "from" | "off" => Class::Prep(Prep::From),
        "at" | "on" | "in" | "inside" | "into" | "onto" | "within" | "upon" | "around" | "atop" => {
            Class::Prep(Prep::At)
        }
        "near" | "beside" | "by" | "behind" | "under" | "between" | "above" | "below"
        | "outside" => Class::Prep(Prep::Near),
        "for" => Class::Prep(Prep::For),
        "with" => Class::Prep(Prep::With),
        "about" | "regarding" | "concerning" => Class::Prep(Prep::About),
        "of" => Class::Prep(Prep::Of),
        "as" | "like" | "than" | "through" | "via" | "during" | "despite" | "using" => {
            Class::Prep(Prep::Other)
        }
        "and" | "plus" => Class::Link(Link::And),
        "or" | "nor" => Class::Link(Link::Or),
        "but" | "however" | "although" | "though" => Class::Link(Link::But),
        "then" | "afterwards" | "afterward" | "subsequently" => Class::Link(Link::Then),
        "after" => Class::Link(Link::After),
        "before" => Class::Link(Link::Before),
        "because" | "since" | "due" => Class::Link(Link::Because),
        "while" | "when" | "where" | "which" | "that" | "who" | "whose" | "so" | "until"
        | "what" | "how" => Class::Link(Link::Sub),
        "i" | "we" | "robot" | "agent" | "myself" => Class::Agent,
        "it" | "them" | "itself" => Class::It,
        "there" | "here" => Class::There,
        "user" | "they" | "he" | "she" | "human" | "person" | "me" => Class::User,
        "hand" | "hands" | "gripper" | "arm" | "inventory" => Class::Hand,
        "zero" => Class::Number(0),
        "one" => Class::Number(1),
        "two" => Class::Number(2),
        "three" => Class::Number(3),
        "four" => Class::Number(4),
        "five" => Class::Number(5),
        "six" => Class::Number(6),
        "seven" => Class::Number(7),
        "eight" => Class::Number(8),
        "nine" => Class::Number(9),
        "ten" => Class::Number(10),
        "once" => Class::Times(1),
        "twice" => Class::Times(2),
        "thrice" => Class::Times(3),
        "marker" | "markers" | "number" | "numbers" | "id" => Class::Marker,
        "able" => Class::Able(true),
        "unable" => Class::Able(false),
        "empty" | "bare" => Class::Empty,
        "free" => Class::Free,
        "visible" | "view" | "sight" => Class::Visible,
        "door" | "doors" => Class::Door,
        "last" | "latest" | "previous" | "recent" => Class::Last,
        "action" | "call" | "attempt" | "step" | "try" | "tries" | "attempts" | "calls"
        | "actions" => Class::Doing,
        "successfully" | "success" | "successful" => Class::Success(true),
        "unsuccessfully" | "unsuccessful" | "vain" => Class::Success(false),
        "now" | "again" | "also" | "yet" | "ever" | "already" | "still" | "currently"
        | "finally" | "first" | "second" | "third" | "next" | "later" | "earlier" | "back"
        | "far" | "up" | "down" | "away" | "out" | "over" | "together" | "too" | "very"
        | "even" | "instead" | "meanwhile" | "anymore" | "eventually" | "immediately"
        | "directly" | "longer" | "right" | "previously" | "initially" | "recently"
        | "therefore" | "thus" | "along" | "straight" | "closely" | "carefully" | "simply"
        | "actually" | "rather" | "most" => Class::Adverb,
        _ if TABLE.contains_key(word) => Class::Verb,
        _ => Class::Noun,
    }
}

/// The verb of a word, if it is one.
pub(crate) fn verb(word: &str) -> Option<Verb> {
    TABLE.get(word).copied()
}

/// Words that stand for any object.
pub(crate) const ANYTHING: [&str; 18] = reel_world::words! {
    object item thing something anything candidate match target one everything result option
    instance ones stuff piece copy "target object"
};

/// Words that stand for any receptacle.
pub(crate) const ANYWHERE: [&str; 12] = reel_world::words! {
    receptacle furniture place location surface spot landmark destination source somewhere anywhere
    viewpoint
};

/// What a reason says in words -> the error codes it may mean.
pub(crate) const REASONS: &[(&str, &[&str])] = &[
    ("out of reach", &["out_of_reach"]),
    ("too far", &["out_of_reach"]),
    ("far away", &["out_of_reach"]),
    ("not close enough", &["out_of_reach"]),
    ("could not reach", &["out_of_reach", "no_viewpoint"]),
    ("already holding", &["already_holding", "hand_not_free"]),
    ("holding", &["already_holding", "hand_not_free"]),
    ("not free", &["hand_not_free", "already_holding"]),
    ("not empty", &["hand_not_free", "already_holding"]),
    ("hand was full", &["hand_not_free", "already_holding"]),
    ("no door", &["no_door"]),
    ("door was closed", &["door_closed", "marker_not_in_view"]),
    ("door is closed", &["door_closed", "marker_not_in_view"]),
    ("was closed", &["door_closed", "marker_not_in_view"]),
    ("is closed", &["door_closed", "marker_not_in_view"]),
    ("closed door", &["door_closed", "marker_not_in_view"]),
    ("unknown marker", &["unknown_marker"]),
    ("marker was unknown", &["unknown_marker"]),
    ("marker map", &["no_marker_map", "unknown_marker"]),
    ("no marker", &["no_marker_map", "unknown_marker"]),
    ("not in view", &["marker_not_in_view", "nothing_found"]),
    ("not visible", &["marker_not_in_view", "nothing_found"]),
    ("no such receptacle", &["unknown_receptacle"]),
    ("does not exist", &["unknown_receptacle", "unknown_marker"]),
    ("did not exist", &["unknown_receptacle", "unknown_marker"]),
    ("no landmark", &["no_landmark"]),
    ("held nothing", &["nothing_held"]),
    ("holding nothing", &["nothing_held"]),
    ("not holding", &["nothing_held"]),
    ("nothing in my hand", &["nothing_held"]),
    ("hand was empty", &["nothing_held"]),
    ("hand is empty", &["nothing_held"]),
    ("gripper was empty", &["nothing_held"]),
    ("not graspable", &["not_graspable"]),
    ("no free spot", &["no_free_spot"]),
    ("no space", &["no_free_spot"]),
    ("no room", &["no_free_spot"]),
    ("bad argument", &["bad_arguments"]),
    ("invalid argument", &["bad_arguments"]),
    ("missing argument", &["bad_arguments"]),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verb_is_known_in_each_of_its_forms() {
        for (word, act, form) in [
            ("went", Act::Go, Form::Past),
            ("gone", Act::Go, Form::Participle),
            ("visited", Act::Go, Form::PastOrParticiple),
            ("put", Act::Place, Form::Any),
            ("picking", Act::Pick, Form::Gerund),
            ("holds", Act::Hold, Form::Present),
        ] {
            let verb = verb(word).unwrap();
            assert_eq!((verb.act, verb.form), (act, form), "{word}");
        }
        assert_eq!(class("banana"), Class::Noun);
    }
}
