//! The spans of an episode as the turns of a trajectory, in the order in which they began.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::record::{EndReason, Reported, Score};
use serde_json::{Map, Value};

use super::{
    convention::{Role, SpanFacts},
    messages::{self, Message},
    names,
};
use crate::{
    SuccessRule,
    atif::{
        Agent, Call, CallResult, Content, LogFacts, OURS, Observation, Source, Step, StepMetrics,
        Trajectory, VERSION,
    },
};

/// Settings of a request that are kept as parameters of the policy.
const SETTINGS: [&str; 7] = [
    "temperature",
    "top_p",
    "top_k",
    "max_tokens",
    "seed",
    "frequency_penalty",
    "presence_penalty",
];

/// An episode as a trajectory, with what trajectories have no field for.
pub(super) struct Conversation {
    pub(super) trajectory: Trajectory,
    pub(super) facts: LogFacts,
    /// What was there and is not read.
    pub(super) left_out: Vec<String>,
    /// What was decided where the spans leave it open.
    pub(super) notes: Vec<String>,
}

/// How many spans around one are looked at; ids of broken exporters may go in a circle.
const DEPTH_MAX: usize = 256;

/// Makes turns of spans, which are in their order. `task` names an attribute that says which task it was.
pub(super) fn conversation(
    id: &str,
    spans: &[SpanFacts],
    rule: Option<&SuccessRule>,
    task: Option<&str>,
) -> Conversation {
    let family = Family::of(spans);
    let mut reader = Reader::default();
    let agents: Vec<&SpanFacts> = of_role(spans, Role::Agent).collect();
    // Beside no response, what the agent as a whole got and said is the conversation.
    let silent = !spans
        .iter()
        .any(|span| span.role == Role::Chat && !span.output().is_empty());
    let root = agents.first().copied();
    if let Some(root) = root {
        reader.opening(root.input());
        reader.kept(root);
    }
    for (number, span) in spans.iter().enumerate() {
        match span.role {
            Role::Chat if family.within(number, |outer| outer.role == Role::Chat) => {
                reader.skip("responses within another response");
            }
            Role::Chat => reader.chat(span),
            Role::Tool
                if family.within(number, |outer| {
                    outer.role == Role::Tool && outer.tool() == span.tool()
                }) =>
            {
                reader.skip("executions of a tool within one of the same name");
            }
            Role::Tool => reader.tool(span),
            Role::Agent => {}
            Role::Other => reader.skip("spans of something else than agents, responses and tools"),
        }
    }
    if let (Some(root), true) = (root, silent) {
        reader.closing(root);
    }
    let (steps, failed_calls, kept) = reader.steps();
    let facts = LogFacts {
        task_id: task.and_then(|key| spans.iter().find_map(|span| span.text(&[key]))),
        parameters: parameters(spans),
        failed_calls,
        end: root.and_then(SpanFacts::error).map(|_| EndReason::Fault),
        reported: reader.reported(spans, rule),
        ..LogFacts::default()
    };
    let named = |name: fn(&SpanFacts) -> Option<String>| {
        let of_agents = agents.iter().find_map(|span| name(span));
        of_agents.or_else(|| spans.iter().find_map(name))
    };
    let service = spans.iter().find_map(|span| {
        let name = span.resource.get("service.name")?;
        messages::text_of(name).filter(|name| !name.starts_with("unknown_service"))
    });
    let version = named(|span| span.text(&[names::AGENT_VERSION]));
    let model = named(SpanFacts::model);
    let name = named(SpanFacts::agent)
        .or(service)
        .or_else(|| model.clone());
    let tools = spans.iter().map(SpanFacts::tools).find(|it| !it.is_empty());
    Conversation {
        trajectory: Trajectory {
            schema_version: VERSION.to_owned(),
            session_id: Some(id.to_owned()),
            trajectory_id: None,
            agent: Agent {
                name: name.unwrap_or_else(|| "unknown".to_owned()),
                version: version.unwrap_or_default(),
                model_name: model,
                tool_definitions: tools.unwrap_or_default(),
                extra: Map::new(),
            },
            steps,
            notes: None,
            final_metrics: None,
            continued_trajectory_ref: None,
            extra: kept,
            subagent_trajectories: Vec::new(),
        },
        facts,
        left_out: reader.losses(),
        notes: reader.notes,
    }
}

fn of_role(spans: &[SpanFacts], role: Role) -> impl Iterator<Item = &SpanFacts> {
    spans.iter().filter(move |span| span.role == role)
}

/// Which span stands within which.
struct Family<'a> {
    spans: &'a [SpanFacts],
    by_id: BTreeMap<&'a [u8], usize>,
}

impl<'a> Family<'a> {
    fn of(spans: &'a [SpanFacts]) -> Self {
        let ids = spans.iter().enumerate();
        Self {
            spans,
            by_id: ids.map(|(at, span)| (&span.span.span_id[..], at)).collect(),
        }
    }

    /// Whether a span that encloses this one is such.
    fn within(&self, number: usize, is_such: impl Fn(&SpanFacts) -> bool) -> bool {
        let mut at = number;
        for _ in 0..DEPTH_MAX {
            let parent = &self.spans[at].span.parent_span_id[..];
            match self.by_id.get(parent) {
                Some(outer) if is_such(&self.spans[*outer]) => return true,
                Some(outer) => at = *outer,
                None => return false,
            }
        }
        false
    }
}

fn parameters(spans: &[SpanFacts]) -> BTreeMap<String, Value> {
    let mut found = BTreeMap::new();
    let mut add = |name: &str, value: Option<Value>| {
        if let Some(value) = value.filter(|value| !value.is_null()) {
            found.entry(name.to_owned()).or_insert(value);
        }
    };
    for span in spans {
        for name in SETTINGS {
            let key = format!("gen_ai.request.{name}");
            add(name, span.attributes.get(&key).cloned());
        }
        for (name, keys) in [
            (
                "provider",
                [names::PROVIDER, "gen_ai.system", "llm.provider"],
            ),
            ("invocation", ["llm.invocation_parameters"; 3]),
        ] {
            add(name, span.text(&keys).map(Value::from));
        }
        for name in [
            "service.name",
            "service.version",
            "deployment.environment.name",
        ] {
            add(name, span.resource.get(name).cloned());
        }
    }
    let root = of_role(spans, Role::Agent).next();
    add("error", root.and_then(SpanFacts::error).map(Value::from));
    if let Some(first) = spans.first() {
        add(
            "trace_id",
            Some(reel_otlp::to_hex(&first.span.trace_id).into()),
        );
    }
    found
}

/// A call on its way, with what came of it.
struct OpenCall {
    step: usize,
    /// Its own id, in the whole conversation.
    id: String,
    /// The id that spans give it; providers may count anew in each response.
    told: Option<String>,
    name: String,
    result: Option<Content>,
    /// Whether a span executed it.
    executed: bool,
    failed: bool,
}

/// A response of which nothing was recorded.
struct Unrecorded {
    /// Index of its turn in the trajectory.
    step: usize,
    /// Its step, where the span says so.
    number: Option<String>,
}

/// Turns on their way.
#[derive(Default)]
struct Reader {
    steps: Vec<Step>,
    calls: Vec<OpenCall>,
    /// Ids of all calls.
    ids: BTreeSet<String>,
    /// Whether the agent did or said something.
    acted: bool,
    /// What came after a turn without a call, by an attribute of ours; the next response tells it again.
    answered: Option<String>,
    /// The turn of a response of which nothing was recorded: the executions that follow are its calls.
    unrecorded: Option<Unrecorded>,
    /// How often each message was there.
    seen: BTreeMap<String, usize>,
    /// The first message but for those of the system.
    first: Option<String>,
    kept: Map<String, Value>,
    left_out: Vec<String>,
    skipped: BTreeMap<&'static str, usize>,
    references: usize,
    notes: Vec<String>,
    /// Texts that came after a turn without a call.
    replies: BTreeMap<usize, Content>,
}

impl Reader {
    fn skip(&mut self, kind: &'static str) {
        *self.skipped.entry(kind).or_default() += 1;
    }

    fn lose(&mut self, place: &str, left_out: Vec<String>) {
        for message in left_out {
            if messages::is_reference(&message) {
                self.references += 1;
            } else {
                self.left_out.push(format!("{place}: {message}"));
            }
        }
    }

    fn losses(&mut self) -> Vec<String> {
        let counted = std::mem::take(&mut self.skipped).into_iter();
        self.notes
            .extend(counted.map(|(kind, count)| format!("{count} {kind} are not read")));
        if self.references > 0 {
            self.notes.push(format!(
                "{} mentions of images name them by their digest alone",
                self.references
            ));
        }
        std::mem::take(&mut self.left_out)
    }

    /// What stands in an attribute of ours; what is not JSON is left to the reader of trajectories to name.
    fn kept(&mut self, span: &SpanFacts) {
        if let Some(kept) = span.text(&[names::EPISODE]) {
            let kept = serde_json::from_str(&kept).unwrap_or(Value::String(kept));
            self.kept.insert(OURS.to_owned(), kept);
        }
    }

    /// What the agent as a whole was asked, until it says something.
    fn opening(&mut self, input: Vec<Message>) {
        let asked = input
            .into_iter()
            .take_while(|message| message.role != "assistant");
        self.news(asked.collect(), "invoke_agent");
    }

    /// What the agent as a whole said, where no response is recorded.
    fn closing(&mut self, root: &SpanFacts) {
        for message in root.output() {
            self.acted = true;
            let step = self.said(message, "invoke_agent");
            self.steps.push(step);
        }
    }

    /// Adds messages that were not there before. A conversation that begins as before is told again as a whole;
    /// any other one is news.
    fn news(&mut self, input: Vec<Message>, place: &str) {
        let is_system = |message: &Message| message.role == "system" || message.role == "developer";
        let begins = input.iter().find(|message| !is_system(message));
        let begins = begins.map(Message::fingerprint);
        let whole = begins.is_some() && begins == self.first;
        if self.first.is_none() {
            self.first = begins;
        }
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for message in input {
            let answer = self.answered.as_deref();
            if message.role == "user" && answer.is_some_and(|answer| answer == message.text()) {
                self.answered = None;
                continue;
            }
            let print = message.fingerprint();
            let count = counts.entry(print.clone()).or_default();
            *count += 1;
            let known = self.seen.get(&print).copied().unwrap_or_default();
            if *count <= known && (whole || is_system(&message)) {
                continue;
            }
            *self.seen.entry(print).or_default() += 1;
            self.message(message, place);
        }
    }

    fn message(&mut self, mut message: Message, place: &str) {
        for response in std::mem::take(&mut message.responses) {
            let open = self.calls.iter_mut().rev();
            let found = open
                .filter(|call| call.result.is_none())
                .find(|call| response.id.is_none() || response.id == call.told);
            if let Some(call) = found {
                call.result = Some(response.content);
            }
        }
        self.lose(place, std::mem::take(&mut message.left_out));
        let source = match message.role.as_str() {
            "system" | "developer" => Source::System,
            // What it said is in the span of that response.
            "assistant" | "model" if self.acted => return,
            "assistant" | "model" => {
                let mut step = self.said(message, place);
                step.is_copied_context = Some(true);
                self.steps.push(step);
                return;
            }
            "tool" | "function" => return,
            _ => Source::User,
        };
        if message.parts.is_empty() {
            return;
        }
        self.steps.push(Step {
            message: message.content(),
            ..Step::of(source)
        });
    }

    /// A turn of the agent, with calls that wait for their results.
    fn said(&mut self, mut message: Message, place: &str) -> Step {
        self.lose(place, std::mem::take(&mut message.left_out));
        let content = message.content();
        let calls = message.calls.into_iter().map(|call| {
            let id = call.id.unwrap_or_default();
            Call {
                tool_call_id: id,
                function_name: call.name,
                arguments: call.arguments,
            }
        });
        Step {
            message: content,
            reasoning_content: Some(message.reasoning).filter(|words| !words.is_empty()),
            tool_calls: calls.collect(),
            ..Step::of(Source::Agent)
        }
    }

    fn chat(&mut self, span: &SpanFacts) {
        let place = format!("span '{}'", span.span.name.escape_debug());
        self.news(span.input(), &place);
        let mut output = span.output();
        let error = span.error();
        let recorded = !output.is_empty();
        // Of several choices the agent went on with the first.
        if output.len() > 1 {
            self.skip("further choices of a response");
            output.truncate(1);
        }
        let message = output.pop().unwrap_or_default();
        if recorded {
            *self.seen.entry(message.fingerprint()).or_default() += 1;
        }
        let mut step = self.said(message, &place);
        let [read, written] = span.tokens();
        step.metrics = (read.is_some() || written.is_some()).then(|| StepMetrics {
            prompt_tokens: read,
            completion_tokens: written,
            ..StepMetrics::default()
        });
        self.record(span, &mut step);
        self.acted = true;
        let number = self.steps.len();
        for call in &mut step.tool_calls {
            let told = Some(std::mem::take(&mut call.tool_call_id)).filter(|id| !id.is_empty());
            call.tool_call_id = self.unique(told.as_deref());
            self.calls.push(OpenCall {
                step: number,
                id: call.tool_call_id.clone(),
                told,
                name: call.function_name.clone(),
                result: None,
                executed: false,
                failed: false,
            });
        }
        self.unrecorded = (!recorded && error.is_none()).then(|| Unrecorded {
            step: number,
            number: span.text(&[names::STEP]),
        });
        let reply = span.attributes.get(names::RESULT).map(messages::result);
        if let Some((content, left_out)) = reply {
            self.lose(&place, left_out);
            self.answered = Some(content.text());
            self.replies.insert(number, content);
        } else if let (Some(error), false) = (error, recorded) {
            self.replies.insert(number, Content::Text(error));
        }
        self.steps.push(step);
    }

    fn record(&mut self, span: &SpanFacts, step: &mut Step) {
        if let Some(kept) = span.text(&[names::RECORD]) {
            let kept = serde_json::from_str(&kept).unwrap_or(Value::String(kept));
            step.extra.insert(OURS.to_owned(), kept);
        }
    }

    fn tool(&mut self, span: &SpanFacts) {
        let (name, id) = (span.tool(), span.call_id());
        let place = format!("tool '{}'", name.escape_debug());
        let waits = |call: &OpenCall| !call.executed;
        let mut open = self.calls.iter();
        let found = match &id {
            Some(_) => open.position(|call| waits(call) && call.told == id),
            None => open.position(|call| waits(call) && call.name == name),
        };
        let number = found.unwrap_or_else(|| self.new_call(&name, id, span));
        let (step, id) = (self.calls[number].step, self.calls[number].id.clone());
        let told = self.steps[step].tool_calls.iter_mut();
        if let Some(call) = told.into_iter().find(|call| call.tool_call_id == id) {
            let empty = call.arguments.as_object().is_none_or(Map::is_empty);
            if let (Some(arguments), true) = (span.arguments(), empty) {
                call.arguments = arguments;
            }
        }
        let mut kept = std::mem::replace(&mut self.steps[step], Step::of(Source::Agent));
        self.record(span, &mut kept);
        self.steps[step] = kept;
        let error = span.error();
        let result = span.result().map(messages::result);
        let result = result.map(|(content, left_out)| {
            self.lose(&place, left_out);
            content
        });
        let call = &mut self.calls[number];
        call.executed = true;
        call.failed = error.is_some();
        call.result = result.or(error.map(Content::Text));
    }

    /// A call of which no response told: of the response before if nothing of that was recorded, else a turn of
    /// its own.
    fn new_call(&mut self, name: &str, id: Option<String>, span: &SpanFacts) -> usize {
        self.acted = true;
        let number = span.text(&[names::STEP]);
        let unrecorded = self.unrecorded.as_ref();
        let unrecorded = unrecorded.filter(|it| it.number == number || number.is_none());
        let step = unrecorded.map(|it| it.step).unwrap_or_else(|| {
            self.steps.push(Step::of(Source::Agent));
            self.steps.len() - 1
        });
        let told = id;
        let id = self.unique(told.as_deref());
        self.steps[step].tool_calls.push(Call {
            tool_call_id: id.clone(),
            function_name: name.to_owned(),
            arguments: Value::Object(Map::new()),
        });
        self.calls.push(OpenCall {
            step,
            id,
            told,
            name: name.to_owned(),
            result: None,
            executed: false,
            failed: false,
        });
        self.calls.len() - 1
    }

    /// An id that no call has: the told one where it is.
    fn unique(&mut self, told: Option<&str>) -> String {
        let number = self.calls.len();
        let told = told.filter(|id| !self.ids.contains(*id));
        let id = told.map_or_else(|| format!("reel_call_{number}"), str::to_owned);
        self.ids.insert(id.clone());
        id
    }

    /// The turns with their results, the calls that failed, and what is ours of the episode.
    fn steps(&mut self) -> (Vec<Step>, BTreeSet<String>, Map<String, Value>) {
        let mut steps = std::mem::take(&mut self.steps);
        let mut failed = BTreeSet::new();
        for (number, content) in std::mem::take(&mut self.replies) {
            let result = CallResult {
                source_call_id: None,
                content: Some(content),
            };
            observation(&mut steps[number]).push(result);
        }
        for call in std::mem::take(&mut self.calls) {
            if call.failed {
                failed.insert(call.id.clone());
            }
            if let Some(content) = call.result {
                observation(&mut steps[call.step]).push(CallResult {
                    source_call_id: Some(call.id),
                    content: Some(content),
                });
            }
        }
        for (number, step) in (1..).zip(&mut steps) {
            step.step_id = number;
        }
        (steps, failed, std::mem::take(&mut self.kept))
    }

    /// The scores of all spans, and whether they say success. The outermost agent's come first; of several results
    /// of one name the last counts, unless the agent has one.
    fn reported(&mut self, spans: &[SpanFacts], rule: Option<&SuccessRule>) -> Reported {
        let mut scores: Vec<Score> = Vec::new();
        let mut several: BTreeMap<String, usize> = BTreeMap::new();
        let (agents, others): (Vec<_>, Vec<_>) =
            spans.iter().partition(|span| span.role == Role::Agent);
        let mut of_agents = 0;
        for (number, span) in agents.iter().chain(&others).enumerate() {
            if number == agents.len() {
                of_agents = scores.len();
            }
            for score in span.scores() {
                let known = scores.iter().position(|known| known.name == score.name);
                let Some(at) = known else {
                    scores.push(score);
                    continue;
                };
                *several.entry(score.name.clone()).or_insert(1) += 1;
                if number >= agents.len() && at >= of_agents {
                    scores[at] = score;
                }
            }
        }
        self.notes.extend(several.iter().map(|(name, count)| {
            format!(
                "{count} results of evaluation '{}': one is kept",
                name.escape_debug()
            )
        }));
        self.notes.extend(SuccessRule::unmet(rule, &scores));
        Reported {
            success: SuccessRule::judge(rule, &scores),
            scores,
        }
    }
}

fn observation(step: &mut Step) -> &mut Vec<CallResult> {
    let seen = step.observation.get_or_insert_with(|| Observation {
        results: Vec::new(),
    });
    &mut seen.results
}
