//! What an agent never reads and no training text may carry: `Debug Info`, `finish` payloads, world
//! graphs, plans, poses, instances, goals (docs/spec.md#episode, docs/spec.md#sft-data and
//! docs/spec.md#published-results).
//!
//! Owns the removal of whole payloads ([`strip`]) and the refusal of whatever remains
//! ([`find_leak`]). Knows no format and no episode but what [`PrivilegedFacts`] names;
//! never rewrites a sentence.

use std::{borrow::Cow, collections::BTreeSet, fmt, ops::Range, sync::LazyLock};

use aho_corasick::{AhoCorasick, AhoCorasickKind};
use base64::{Engine as _, engine::general_purpose};
use reel_world::Task;
use regex::Regex;
use serde::Serialize;
use serde_json::Value;

/// What kind of privileged text.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LeakKind {
    /// The `Debug Info` of the published server.
    DebugInfo,
    /// The `finish` payload or a field of a task file.
    TaskPayload,
    /// A world graph, a change of one, or the goal.
    WorldGraph,
    /// A plan or trajectory that was made with a perfect map.
    Plan,
    /// Coordinates, sizes or turns of things.
    Pose,
    /// An object instance or its asset.
    Instance,
    /// What only the makers of the data know: distractors, rewards, the oracle.
    Oracle,
    /// A phrase that the caller named.
    Phrase,
}

impl LeakKind {
    /// For people, after "the text holds".
    pub fn as_str(self) -> &'static str {
        match self {
            LeakKind::DebugInfo => "debug information of the server",
            LeakKind::TaskPayload => "a field of the task's payload",
            LeakKind::WorldGraph => "a world graph or a change of it",
            LeakKind::Plan => "an execution plan",
            LeakKind::Pose => "a pose or coordinates",
            LeakKind::Instance => "an object instance or asset",
            LeakKind::Oracle => "oracle metadata",
            LeakKind::Phrase => "a phrase that is not for the agent",
        }
    }
}

impl fmt::Display for LeakKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Privileged text that was found.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Leak {
    /// The kind of privileged text that was found.
    pub kind: LeakKind,
    /// Where, in bytes of the text as it was given; the whole disguise where it was encoded.
    pub span: Range<usize>,
}

impl Leak {
    /// The place as text, shortened to 80 characters.
    pub fn excerpt(&self, text: &str) -> String {
        text.get(self.span.clone())
            .unwrap_or_default()
            .chars()
            .take(80)
            .collect()
    }
}

/// What is privileged in one episode in particular: its instances, their assets, phrases.
#[derive(Clone, Debug, Default)]
pub struct PrivilegedFacts {
    words: Option<AhoCorasick>,
    kinds: Vec<LeakKind>,
    /// Receptacle ids and the like, which the agent knows.
    public: BTreeSet<String>,
    /// Whether the agent acted outside of homes, where coordinates and plans are its own.
    is_other_world: bool,
}

impl PrivilegedFacts {
    /// None in particular: only what is privileged in every episode is found.
    pub fn none() -> Self {
        Self::default()
    }

    /// The given words, found as whole words whatever their case, but for the `public` ones.
    pub fn new<'t>(
        words: impl IntoIterator<Item = (LeakKind, &'t str)>,
        public: impl IntoIterator<Item = &'t str>,
    ) -> Self {
        let public: BTreeSet<String> = public.into_iter().map(str::to_ascii_lowercase).collect();
        let words: BTreeSet<(String, LeakKind)> = words
            .into_iter()
            .map(|(kind, word)| (word.trim().to_ascii_lowercase(), kind))
            .filter(|(word, _)| !word.is_empty() && !public.contains(word))
            .collect();
        let (words, kinds): (Vec<String>, Vec<LeakKind>) = words.into_iter().unzip();
        // built for every task, and quickly: an automaton of all transitions is no
        // faster here in sum
        let kind = Some(AhoCorasickKind::ContiguousNFA);
        let automaton = AhoCorasick::builder()
            .kind(kind)
            .ascii_case_insensitive(true)
            .build(&words);
        Self {
            words: automaton.ok().filter(|_| !words.is_empty()),
            kinds,
            public,
            is_other_world: false,
        }
    }

    /// What the agent of a task must not know: instances, assets that are no plain words, the
    /// task's id, and the precise instruction where it got a fuzzy one. Nothing where the task is
    /// none of a home.
    pub fn of_task(task: &Task) -> Self {
        if !task.has_goal() && task.objects.is_empty() {
            return Self {
                is_other_world: true,
                ..Self::default()
            };
        }
        let numbered = |asset: &&str| asset.bytes().any(|byte| byte.is_ascii_digit());
        let instances = task.objects.iter().map(|object| object.instance.as_str());
        let assets = task
            .objects
            .iter()
            .map(|object| object.asset.as_str())
            .chain(task.object_distractors.iter().map(|it| it.as_str()));
        let instances = instances
            .chain(assets.filter(numbered))
            .map(|word| (LeakKind::Instance, word));
        let fuzzy = task.instruction != task.precise_instruction;
        let precise = fuzzy.then_some((LeakKind::Phrase, task.precise_instruction.as_str()));
        let id = (LeakKind::TaskPayload, task.task_id.as_str());
        let receptacles = task.initial.receptacles.keys().map(|id| id.as_str());
        Self::new(instances.chain(precise).chain([id]), receptacles)
    }

    fn find(&self, text: &str) -> Option<Leak> {
        let whole = |span: &Range<usize>| {
            let word = |byte: Option<&u8>| {
                byte.is_some_and(|byte| byte.is_ascii_alphanumeric() || *byte == b'_')
            };
            let bytes = text.as_bytes();
            !word(
                span.start
                    .checked_sub(1)
                    .and_then(|before| bytes.get(before)),
            ) && !word(bytes.get(span.end))
        };
        let matches = self.words.as_ref()?.find_overlapping_iter(text);
        let mut leaks = matches.map(|it| Leak {
            kind: self.kinds[it.pattern().as_usize()],
            span: it.start()..it.end(),
        });
        leaks.find(|leak| whole(&leak.span))
    }
}

/// The text without whole payloads: `Debug Info` blocks and JSON values that are privileged,
/// wherever in it they stand.
pub fn strip(text: &str) -> Cow<'_, str> {
    let mut cuts = Vec::new();
    let mut from = 0;
    if let Some(header) = DEBUG_INFO.find(text) {
        // The block is the last part of a result; what is no JSON there is a block
        // that was cut off.
        let body = text[header.end()..].find('{').map(|at| header.end() + at);
        let end = body
            .and_then(|start| json_at(text, start))
            .map_or(text.len(), |(_, end)| end);
        cuts.push(header.start()..end);
        from = end;
    }
    for (value, span) in JsonValues::new(text) {
        if span.start >= from
            && (value_leak(&value, &PrivilegedFacts::none()).is_some()
                || PRIVILEGED.is_match(&text[span.clone()]))
        {
            cuts.push(span);
        }
    }
    if cuts.is_empty() {
        return Cow::Borrowed(text);
    }
    cuts.sort_by_key(|cut| cut.start);
    let mut kept = String::with_capacity(text.len());
    let mut from = 0;
    for cut in cuts.into_iter().filter(|cut| !cut.is_empty()) {
        kept.push_str(&text[from.min(cut.start)..cut.start]);
        from = from.max(cut.end);
    }
    kept.push_str(&text[from..]);
    Cow::Owned(kept.trim().to_owned())
}

/// The first privileged thing in a text, disguised or not; none in a clean one.
pub fn find_leak(text: &str, secrets: &PrivilegedFacts) -> Option<Leak> {
    if secrets.is_other_world {
        return None;
    }
    plain_leak(text, secrets).or_else(|| {
        let hidden = |(span, plain): (Range<usize>, String)| {
            plain_leak(&plain, secrets).map(|leak| Leak {
                kind: leak.kind,
                span,
            })
        };
        disguises(text).into_iter().find_map(hidden)
    })
}

fn plain_leak(text: &str, secrets: &PrivilegedFacts) -> Option<Leak> {
    if let Some(leak) = secrets.find(text) {
        return Some(leak);
    }
    let mut from = 0;
    while let Some(found) = PRIVILEGED.find_at(text, from) {
        let word = found.as_str().to_ascii_lowercase();
        if !secrets.public.contains(&word) {
            return Some(Leak {
                kind: kind_of(found.as_str()),
                span: found.range(),
            });
        }
        from = found.end();
    }
    JsonValues::new(text)
        .find_map(|(value, span)| value_leak(&value, secrets).map(|kind| Leak { kind, span }))
}

/// Signs of privileged text, ASCII whatever the case. Every one is something that no agent says of
/// its own in English.
const SIGNS: &[(LeakKind, &str)] = &[
    (LeakKind::DebugInfo, r"\bdebug[ _-]?info"),
    (
        LeakKind::DebugInfo,
        r"\bcurrent_(?:landmark|pos|inv|marker_map)\b|\bmarker_map\b",
    ),
    (
        LeakKind::TaskPayload,
        r"\b(?:benchmark_task_id|global_index|episode_idx|episode_local_idx|episode_range|rooms_and_furniture|task_id|scene_id)\b",
    ),
    (
        LeakKind::TaskPayload,
        r"\b(?:source|src|destination|dest)[_-]?(?:furniture|receptacle|distractors?)\b",
    ),
    (
        LeakKind::TaskPayload,
        r"\btarget_?object(?:_?id)?\b|\btarget_?(?:instance|asset)\b|\bprecise_instruction\b|\bpurpose_group\b",
    ),
    (
        LeakKind::TaskPayload,
        r"\bfuzzy_task_description\b|\bobject_?(?:distractors?|id)\b|\b(?:asset|instance)_?id\b",
    ),
    (
        LeakKind::WorldGraph,
        r"world[ _-]?graph|\b(?:initial|target|goal|scene|published)[ _-]?graph\b|\bpublished_goal\b",
    ),
    (
        LeakKind::WorldGraph,
        r"\bwg_[a-z]+\b|\bdelta_(?:goal|task|aux)\b|\bsimulator[ _-]?state\b|\bgoal[ _-]state\b",
    ),
    (
        LeakKind::WorldGraph,
        r#"(?:^|[\s"'({\[,;:])[+-][a-z_]\w*@[a-z]\w*|\b[a-z]\w*_\w+\.door\b|\bdoor: (?:open|closed) ->"#,
    ),
    (LeakKind::Plan, r"\bexecution[ _-]?plan|\bplan_steps\b"),
    (
        LeakKind::Plan,
        r"\b(?:expert|gold|optimal|reference|perfect)[ _-](?:plan|trajectory|actions?|policy)\b",
    ),
    (
        LeakKind::Pose,
        r"\b(?:initial|final)_?pos(?:itions?)?\b|\brobot_start\b|\breference_rest\b|\bquat(?:ernion)?\b|\bworld_from_\w+",
    ),
    (
        LeakKind::Pose,
        r#"\b(?:pos|position|pose|xyz|coord|coords|coordinates?|translation|rotation|orientation|yaw|location|bbox|size)\b["']?\s*(?:is|are|at|of|[:=])?\s*[\[({<]*\s*-?\d+\.\d+"#,
    ),
    (
        LeakKind::Pose,
        r"[\[(<]\s*-?\d+\.\d+\s*[,; ]\s*-?\d+\.\d+|-?\d+\.\d+(?:\s*[,;/ ]\s*-?\d+\.\d+){2}",
    ),
    (
        LeakKind::Pose,
        r#"\bx["']?\s*[:= ]\s*-?\d+(?:\.\d+)?\s*m?[,; ]*["']?y["']?\s*[:= ]\s*-?\d"#,
    ),
    (
        LeakKind::Instance,
        r"\b\w+_on_\w+|\b\w+[_-]\d+[ _-]on[ _-]\w+[_-]\d+[ _-]at[ _-]\w+",
    ),
    (
        LeakKind::Oracle,
        r"\boracle\b|\bground[ _-]?truth\b|\bdistractors?\b|\bdistractor_\w+|\bis_(?:target|distractor|goal)\b",
    ),
    (
        LeakKind::Oracle,
        r"\b\w*reward\w*[\x22']?\s*(?:is|was|of|[:=])?\s*[+-]?\d|\bsuccess[\x22']?\s*[:=]\s*(?:true|false|[01])",
    ),
];

static DEBUG_INFO: LazyLock<Regex> = LazyLock::new(|| compiled(r"\bdebug[ _-]?info"));
static PRIVILEGED: LazyLock<Regex> = LazyLock::new(|| {
    compiled(
        &SIGNS
            .iter()
            .map(|(_, sign)| format!("(?:{sign})"))
            .collect::<Vec<_>>()
            .join("|"),
    )
});
static BY_KIND: LazyLock<Vec<(LeakKind, Regex)>> = LazyLock::new(|| {
    SIGNS
        .iter()
        .map(|(kind, sign)| (*kind, compiled(sign)))
        .collect()
});

fn compiled(sign: &str) -> Regex {
    // `(?-u)`: the signs are ASCII, and so is what bounds a word.
    Regex::new(&format!("(?i-u:{sign})")).expect("the signs are regular expressions")
}

fn kind_of(found: &str) -> LeakKind {
    BY_KIND
        .iter()
        .find(|(_, sign)| sign.is_match(found))
        .map_or(LeakKind::Oracle, |(kind, _)| *kind)
}

/// What a JSON value tells by its shape, or a text within it.
fn value_leak(value: &Value, secrets: &PrivilegedFacts) -> Option<LeakKind> {
    match value {
        Value::Object(map) => {
            let state = |value: &Value| {
                value.get("content").is_some_and(Value::is_array) && value.get("role").is_none()
            };
            let place = |key: &str| {
                secrets.public.contains(key)
                    || (key.contains('_') && key.ends_with(|end: char| end.is_ascii_digit()))
            };
            let places = map
                .iter()
                .filter(|(key, value)| place(key) && (value.is_array() || value.is_object()))
                .count();
            if places >= 2 || map.values().any(state) {
                return Some(LeakKind::WorldGraph);
            }
            map.values().find_map(|value| value_leak(value, secrets))
        }
        Value::Array(items) => {
            let has =
                |item: &Value, names: &[&str]| names.iter().any(|name| item.get(name).is_some());
            let step = |item: &&Value| {
                has(item, &["action", "tool_name", "name"]) && has(item, &["args", "arguments"])
            };
            if items.iter().filter(step).count() >= 2 {
                return Some(LeakKind::Plan);
            }
            items.iter().find_map(|value| value_leak(value, secrets))
        }
        // JSON within JSON: what the escapes hid from the signs.
        Value::String(text) if text.contains(['"', '{', '[']) => {
            plain_leak(text, secrets).map(|leak| leak.kind)
        }
        _ => None,
    }
}

/// The outermost JSON objects and arrays in a text.
struct JsonValues<'t> {
    text: &'t str,
    from: usize,
    tries_left: usize,
}

/// Most places where JSON is tried to be read in one text, so that a text of braces takes no time.
pub(crate) const JSON_TRIES_MAX: usize = 256;

impl<'t> JsonValues<'t> {
    fn new(text: &'t str) -> Self {
        Self {
            text,
            from: 0,
            tries_left: JSON_TRIES_MAX,
        }
    }
}

impl Iterator for JsonValues<'_> {
    type Item = (Value, Range<usize>);

    fn next(&mut self) -> Option<Self::Item> {
        while let Some(at) = self.text[self.from..].find(['{', '[']) {
            let start = self.from + at;
            self.from = start + 1;
            self.tries_left = self.tries_left.checked_sub(1)?;
            if let Some((value, end)) = json_at(self.text, start) {
                self.from = end;
                return Some((value, start..end));
            }
        }
        None
    }
}

/// The JSON value that begins at a byte, and where it ends.
fn json_at(text: &str, start: usize) -> Option<(Value, usize)> {
    let mut values = serde_json::Deserializer::from_str(&text[start..]).into_iter::<Value>();
    let value = values.next()?.ok()?;
    Some((value, start + values.byte_offset()))
}

/// Other readings of a text: without invisible characters, escapes undone, base64 runs decoded.
fn disguises(text: &str) -> Vec<(Range<usize>, String)> {
    let invisible = |c: char| matches!(c, '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{2060}'..='\u{2064}' | '\u{feff}');
    let mut found = Vec::new();
    if !text.is_ascii() && text.contains(invisible) {
        found.push((0..text.len(), text.replace(invisible, "")));
    }
    if text.contains(['\\', '%', '&']) {
        let unescaped = ESCAPES.replace_all(text, |escape: &regex::Captures<'_>| {
            let digits = escape
                .iter()
                .skip(1)
                .flatten()
                .next()
                .map_or("", |digits| digits.as_str());
            let radix = if escape.get(4).is_some() { 10 } else { 16 };
            u32::from_str_radix(digits, radix)
                .ok()
                .and_then(char::from_u32)
                .map(String::from)
                .unwrap_or_default()
        });
        if let Cow::Owned(unescaped) = unescaped {
            found.push((0..text.len(), unescaped));
        }
    }
    for run in BASE64_RUN.find_iter(text) {
        let digits = run.as_str().trim_end_matches('=');
        let decoded = general_purpose::STANDARD_NO_PAD
            .decode(digits)
            .or_else(|_| general_purpose::URL_SAFE_NO_PAD.decode(digits));
        if let Some(decoded) = decoded.ok().and_then(|bytes| String::from_utf8(bytes).ok()) {
            found.push((run.range(), decoded));
        }
    }
    found
}

static ESCAPES: LazyLock<Regex> = LazyLock::new(|| {
    compiled(
        r"\\u([0-9a-f]{4})|\\x([0-9a-f]{2})|%([0-9a-f]{2})|&#([0-9]{1,6});|&#x([0-9a-f]{1,5});",
    )
});
static BASE64_RUN: LazyLock<Regex> = LazyLock::new(|| compiled(r"[a-z0-9+/_-]{24,}={0,2}"));
