//! A stand-in for a model: it gives the decisions of recorded episodes to whoever plays them again,
//! in either style, and makes trouble on request. For tests, demos, and for trying an installation
//! before there is a model.
//!
//! It keeps no conversations: where one stands is read from the prompt, as a model would. A
//! decision counts as done when its outcome is the recorded one; else it is given again, so that it
//! gets over unreliable skills, too.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    sync::{Mutex, PoisonError},
};

use reel_prompt::{
    CallLog, DecisionAnswer, HistoryLines, action, arguments,
    python::{self, Ascii},
};
use reel_trace::Trace;
use reel_world::{Digest, ToolCall, answer::Call, language};
use serde_json::{Deserializer, Value, json};

/// Numbers in a vector of a text.
const DIMENSIONS: usize = 256;
/// Letters of a token.
const TOKEN: usize = 4;
/// By how much the log-probabilities of two models differ at most.
const MODEL_SHARE: f64 = 0.2;
/// Longest outcome in the log of a prompt.
const LOGGED: usize = 120;
/// Characters of a prompt that an error shows.
const BEGINNING: usize = 80;
/// How a line of the History counts: `(3 of 9 calls were made)`.
const OF: &str = " of ";
const CALLS_MADE: &str = " calls were made)";
/// Around the memory in a prompt.
const MEMORY_BEGIN: &str = "{'History': '";
const MEMORY_END: &str = "'}";

/// What can be wrong with an answer.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum InjectedError {
    /// Text that is neither JSON nor a call.
    Gibberish,
    /// JSON that ends in the middle, as at the limit of tokens.
    Truncated,
    /// Two calls at once.
    TwoCalls,
    /// A tool that there is not.
    UnknownTool,
    /// Status 429 with `Retry-After`, once.
    RateLimit,
    /// HTTP status 500, for the first attempt of a request only.
    Error,
    /// No answer for a while, once.
    Stall,
    /// A connection that breaks off in the middle of the answer, once.
    Cut,
}

impl InjectedError {
    /// All of them, with the names they go by.
    pub const ALL: [(InjectedError, &'static str); 8] = [
        (InjectedError::Gibberish, "gibberish"),
        (InjectedError::Truncated, "truncated"),
        (InjectedError::TwoCalls, "two-calls"),
        (InjectedError::UnknownTool, "unknown-tool"),
        (InjectedError::RateLimit, "rate-limit"),
        (InjectedError::Error, "error"),
        (InjectedError::Stall, "stall"),
        (InjectedError::Cut, "cut"),
    ];

    /// Reads `KIND@CALL`, e.g. `gibberish@3`.
    ///
    /// # Errors
    /// What is wrong, and what there is.
    pub fn parse(text: &str) -> Result<(InjectedError, usize), String> {
        let kinds = || Self::ALL.map(|(_, name)| name).join(", ");
        let (kind, call) = text
            .split_once('@')
            .ok_or_else(|| format!("'{text}' is not KIND@CALL, as in gibberish@3"))?;
        let call = call
            .parse()
            .map_err(|_| format!("'{call}' is no number of a call (from 0)"))?;
        let kind = Self::ALL.into_iter().find(|(_, name)| *name == kind);
        kind.map(|(trouble, _)| (trouble, call))
            .ok_or_else(|| format!("no trouble is called so; there are {}", kinds()))
    }

    /// Whether the answer itself is right, and only its way is hard.
    fn is_on_the_way(self) -> bool {
        matches!(
            self,
            InjectedError::RateLimit
                | InjectedError::Error
                | InjectedError::Stall
                | InjectedError::Cut
        )
    }
}

/// What is said to a request.
#[derive(Clone, PartialEq, Debug)]
pub struct ScriptedReply {
    /// The body of the answer.
    pub body: Value,
    /// What is wrong with its way.
    pub trouble: Option<InjectedError>,
}

/// Recorded decisions, by the instruction of their task.
#[derive(Default)]
pub struct Script {
    plans: BTreeMap<String, Vec<Vec<Line>>>,
    troubles: Vec<(InjectedError, usize)>,
    /// Requests whose way was made hard already.
    troubled: Mutex<BTreeSet<Digest>>,
}

impl fmt::Debug for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Script({} instructions, {:?})",
            self.plans.len(),
            self.troubles
        )
    }
}

/// A recorded decision, with its outcome and the policy's output.
#[derive(Clone, Debug)]
struct Line {
    call: ToolCall,
    outcome: String,
    reply: Option<String>,
    reasoning: String,
    /// What it adds to the History.
    history: String,
    schedule: String,
    subtask: String,
}

impl Script {
    /// The decisions of recorded episodes; the trouble comes at these calls of every episode.
    pub fn new(traces: &[Trace], troubles: Vec<(InjectedError, usize)>) -> Self {
        let mut plans: BTreeMap<String, Vec<Vec<Line>>> = BTreeMap::new();
        for trace in traces {
            let mut histories = HistoryLines::default();
            let lines = trace.steps.iter().map(|step| {
                let said = step.input.policy.clone().unwrap_or_default();
                let (schedule, subtask) = said
                    .plan
                    .rsplit_once("Current subtask: ")
                    .unwrap_or((&said.plan, ""));
                let schedule = schedule
                    .trim()
                    .trim_start_matches("New Schedule: ")
                    .to_owned();
                let history = histories.next(&said.history, CallLog::Last(Some("")));
                let line = history.lines().next_back().unwrap_or_default();
                let history = line
                    .split_once(") ")
                    .map_or("", |(_, line)| line)
                    .to_owned();
                Line {
                    call: step.input.call.clone(),
                    outcome: step.outcome.text.clone(),
                    reply: step.reply.as_ref().map(|reply| reply.text.clone()),
                    history,
                    schedule,
                    subtask: subtask.to_owned(),
                    reasoning: said.reasoning,
                }
            });
            plans
                .entry(trace.task.instruction.clone())
                .or_default()
                .push(lines.collect());
        }
        Self {
            plans,
            troubles,
            troubled: Mutex::default(),
        }
    }

    /// How many instructions it knows.
    pub fn instructions(&self) -> usize {
        self.plans.len()
    }

    /// What it says to a chat completion.
    ///
    /// # Errors
    /// When the request is none, or of a task that was not recorded: in words for whoever asked.
    pub fn answer(&self, request: &Value) -> Result<ScriptedReply, String> {
        let messages = request
            .get("messages")
            .and_then(Value::as_array)
            .ok_or("the request has no list `messages`")?;
        let users = || {
            messages
                .iter()
                .filter(|message| message["role"] == "user")
                .map(|message| words(&message["content"]))
        };
        let last = users().next_back().ok_or("there is no message of a user")?;
        if last.contains("\nThe robot asks: ") {
            return Ok(ScriptedReply {
                body: completion(request, &text_message(&self.reply(&last)), "stop"),
                trouble: None,
            });
        }
        let first = users().next().unwrap_or_default();
        let named = self
            .plans
            .iter()
            .filter(|(instruction, _)| first.contains(instruction.as_str()));
        let (_, plans) = named
            .max_by_key(|(instruction, _)| instruction.len())
            .ok_or_else(|| {
                format!(
                    "the prompt holds the task of no recorded episode; it begins {:?}",
                    python::prefix(&first, BEGINNING)
                )
            })?;
        let functions = request.get("tools").is_some();
        let reached = |plan: &[Line]| {
            if functions {
                conversation(messages).reached(plan)
            } else {
                progress(&last, plan)
            }
        };
        let (plan, reached) = plans
            .iter()
            .map(|plan| (plan, reached(plan)))
            .max_by_key(|(_, (call, _))| *call)
            .expect("an instruction comes with a plan");
        let (call, smooth) = reached;
        let trouble = self
            .troubles
            .iter()
            .filter(|(_, at)| *at == call)
            .map(|(trouble, _)| *trouble)
            .find(|trouble| {
                if trouble.is_on_the_way() {
                    self.is_new(request, *trouble)
                } else {
                    smooth
                }
            });
        let right = plan.get(call).cloned().unwrap_or_else(Line::finish);
        let line = |(number, line): (usize, &Line)| {
            format!(
                "{number}) ({number}{OF}{}{CALLS_MADE} {}",
                plan.len(),
                line.history
            )
        };
        let history: Vec<String> = plan
            .iter()
            .chain([&right])
            .take(call + 1)
            .enumerate()
            .map(line)
            .collect();
        let (message, reason) = right.message(functions, call, &history.join("\n"), trouble);
        Ok(ScriptedReply {
            body: completion(request, &message, reason),
            trouble: trouble.filter(|trouble| trouble.is_on_the_way()),
        })
    }

    /// The vectors of texts: which letters stand together in them, in the words of the vocabulary.
    ///
    /// # Errors
    /// When the request is none.
    pub fn embed(&self, request: &Value) -> Result<Value, String> {
        let texts = match &request["input"] {
            Value::String(text) => vec![text.as_str()],
            Value::Array(texts) => texts.iter().filter_map(Value::as_str).collect(),
            _ => return Err("the request has no texts in `input`".to_owned()),
        };
        let data: Vec<Value> = texts
            .iter()
            .enumerate()
            .map(|(index, text)| json!({"object": "embedding", "index": index, "embedding": vector(text)}))
            .collect();
        Ok(json!({"object": "list", "data": data, "model": request["model"]}))
    }

    /// Whether a request meets this trouble for the first time.
    fn is_new(&self, request: &Value, trouble: InjectedError) -> bool {
        let digest = Digest::of(format!("{trouble:?} {request}").as_bytes());
        self.troubled
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(digest)
    }

    /// What a simulated user says: what was replied to the same question, else nothing of use.
    fn reply(&self, asked: &str) -> String {
        let between = |from: &str, to: &str| {
            asked
                .rsplit_once(from)
                .map(|(_, rest)| rest.split(to).next().unwrap_or(rest).trim())
        };
        let question = between("\nThe robot asks: ", "\n").unwrap_or_default();
        let instruction = asked
            .strip_prefix("What you told the robot: ")
            .and_then(|rest| rest.split_once("\n\n"));
        let plans = instruction
            .and_then(|(instruction, _)| self.plans.get(instruction))
            .into_iter()
            .flatten()
            .flatten();
        let mut replies = plans
            .filter(|line| line.call.arguments["question"] == question)
            .filter_map(|line| line.reply.clone());
        replies
            .next()
            .unwrap_or_else(|| "Please look around.".to_owned())
    }
}

impl Line {
    fn finish() -> Self {
        Self {
            call: ToolCall::new("finish", json!({})),
            outcome: String::new(),
            reply: None,
            reasoning: String::new(),
            history: String::new(),
            schedule: String::new(),
            subtask: String::new(),
        }
    }

    /// The assistant's message, and why it ends. `number` is that of the call.
    fn message(
        self,
        functions: bool,
        number: usize,
        history: &str,
        trouble: Option<InjectedError>,
    ) -> (Value, &'static str) {
        let mut call = self.call.clone();
        match trouble {
            Some(InjectedError::Gibberish) => {
                return (
                    text_message("the {spoon sleeps furiously: under [the} verb"),
                    "stop",
                );
            }
            Some(InjectedError::UnknownTool) => {
                call = ToolCall::new("teleport", json!({"to": "the target"}))
            }
            _ => {}
        }
        if functions {
            let function = |id: usize, call: &ToolCall, cut: bool| {
                let mut text = arguments(&call.arguments);
                if cut {
                    text.truncate(text.len() / 2);
                }
                json!({"id": format!("call_{number}_{id}"), "type": "function",
                    "function": {"name": call.name, "arguments": text}})
            };
            let mut calls = vec![function(
                0,
                &call,
                trouble == Some(InjectedError::Truncated),
            )];
            if trouble == Some(InjectedError::TwoCalls) {
                calls.push(function(1, &ToolCall::new("finish", json!({})), false));
            }
            let said = if self.reasoning.is_empty() {
                Value::Null
            } else {
                json!(self.reasoning)
            };
            return (
                json!({"role": "assistant", "content": said, "tool_calls": calls}),
                "tool_calls",
            );
        }
        let answer = DecisionAnswer {
            reasoning: &self.reasoning,
            history,
            schedule: &self.schedule,
            subtask: &self.subtask,
            tool_name: &call.name,
            arguments: Some(&call.arguments),
        };
        let mut text = answer.text();
        match trouble {
            Some(InjectedError::Truncated) => {
                let end = text
                    .char_indices()
                    .nth(text.chars().count() / 2)
                    .map_or(0, |(at, _)| at);
                text.truncate(end);
                return (text_message(&text), "length");
            }
            Some(InjectedError::TwoCalls) => {
                text.push_str("\n{\"next action\":{\"tool_name\":\"finish\",\"args\":{}}}")
            }
            _ => {}
        }
        (text_message(&text), "stop")
    }
}

/// What a prompt tells of the calls before.
struct Done {
    /// The call in one line, and what was told.
    calls: Vec<(String, String)>,
}

impl Done {
    /// Which call of a plan comes next, and whether the last one went as it should.
    fn reached(&self, plan: &[Line]) -> (usize, bool) {
        let mut next = 0;
        let mut smooth = true;
        for (call, outcome) in &self.calls {
            let is_recorded = |line: &Line| {
                canonical(&line.call.name, &line.call.arguments) == *call
                    && short(&line.outcome) == short(outcome)
            };
            smooth = plan.get(next).is_some_and(is_recorded);
            next += usize::from(smooth);
        }
        (next, smooth)
    }
}

/// What a log keeps of an outcome.
fn short(outcome: &str) -> String {
    outcome
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
        .chars()
        .take(LOGGED)
        .collect()
}

/// The calls in a conversation with functions.
fn conversation(messages: &[Value]) -> Done {
    let mut calls = Vec::new();
    for (index, message) in messages
        .iter()
        .enumerate()
        .filter(|(_, message)| message["role"] == "assistant")
    {
        let call = Call::of_value(&message["tool_calls"][0])
            .map_or_else(String::new, |it| canonical(&it.name, &it.arguments));
        let told = messages
            .get(index + 1)
            .map(|next| words(&next["content"]))
            .unwrap_or_default();
        calls.push((call, told));
    }
    Done { calls }
}

/// Which call of a plan comes next by a single turn, and whether the last one went as it should.
/// Reads any template: each of our answers leaves a line in the memory that counts the calls before
/// it, and the last action and its outcome follow.
fn progress(prompt: &str, plan: &[Line]) -> (usize, bool) {
    let counted = prompt.rfind(CALLS_MADE).and_then(|at| {
        let number = prompt[..at]
            .rsplit('(')
            .next()?
            .split_once(OF)?
            .0
            .parse::<usize>()
            .ok()?;
        Some((number, at))
    });
    let remembered = prompt.find(MEMORY_BEGIN);
    let Some((answered, from)) = counted
        .map(|(number, at)| (Some(number), at))
        .or(remembered.map(|at| (None, at)))
    else {
        return (0, true);
    };
    let watched = watched_calls(prompt);
    if answered.is_none() && !watched.is_empty() {
        return Done { calls: watched }.reached(plan);
    }
    let end = prompt[from..]
        .find(MEMORY_END)
        .map_or(prompt.len(), |end| from + end);
    let (lines, shown) = (&prompt[from..end], &prompt[end..]);
    let told = |line: &Line, text: &str| text.contains(python::strip(&line.outcome));
    match answered {
        Some(call) if !lines.contains('\n') => {
            let is_last = |line: &Line| {
                let action = python::dumps(
                    &action(&line.call.name, &line.call.arguments),
                    Ascii::Escaped,
                );
                shown
                    .find(&action)
                    .is_some_and(|at| told(line, &shown[at..]))
            };
            let smooth = plan.get(call).is_some_and(is_last);
            (call + usize::from(smooth), smooth)
        }
        // The answer after the counted one could not be read whole, and so its call was not made,
        // or was and went right.
        _ => {
            let call = answered.map_or(0, |call| call + 1);
            let made = plan
                .get(call)
                .is_some_and(|line| !line.outcome.is_empty() && told(line, shown));
            (call + usize::from(made), made)
        }
    }
}

/// The calls that somebody else made, as the memory tells of them: `0) {"tool_name": ..}:
/// outcome`, one a line.
fn watched_calls(prompt: &str) -> Vec<(String, String)> {
    let mut calls = Vec::new();
    for (at, _) in prompt.match_indices(") {\"tool_name\":") {
        let rest = &prompt[at + ") ".len()..];
        let mut values = Deserializer::from_str(rest).into_iter::<Value>();
        let Some(call) = values
            .next()
            .and_then(Result::ok)
            .as_ref()
            .and_then(Call::of_value)
        else {
            continue;
        };
        let told = rest[values.byte_offset()..]
            .strip_prefix(": ")
            .unwrap_or_default();
        let told = told.lines().next().unwrap_or_default();
        calls.push((
            canonical(&call.name, &call.arguments),
            told.strip_suffix(MEMORY_END).unwrap_or(told).to_owned(),
        ));
    }
    calls
}

/// A call in one line by the published names, so that equal calls are equal texts.
fn canonical(name: &str, arguments: &Value) -> String {
    Call::of_value(&action(name, arguments)).map_or_else(String::new, |call| call.canonical())
}

fn words(content: &Value) -> String {
    match content {
        Value::String(text) => text.clone(),
        Value::Array(parts) => parts
            .iter()
            .filter_map(|part| part["text"].as_str())
            .collect(),
        _ => String::new(),
    }
}

fn text_message(text: &str) -> Value {
    json!({"role": "assistant", "content": text})
}

/// The body of a chat completion. Four letters are a token, and images cost nothing.
fn completion(request: &Value, message: &Value, reason: &str) -> Value {
    let messages = request["messages"].as_array().into_iter().flatten();
    let read = messages
        .map(|message| words(&message["content"]).len())
        .sum::<usize>()
        / TOKEN;
    let written = message.to_string().len() / TOKEN;
    let mut choice = json!({"index": 0, "message": message, "finish_reason": reason});
    if request["logprobs"] == true {
        choice["logprobs"] = logprobs(request, &words(&message["content"]));
    }
    json!({
        "id": format!("chatcmpl-{}", &Digest::of(request.to_string().as_bytes()).to_string()[..12]),
        "object": "chat.completion", "created": 0, "model": request["model"],
        "choices": [choice],
        "usage": {"prompt_tokens": read, "completion_tokens": written, "total_tokens": read + written},
    })
}

/// Log-probabilities of a text, four letters a token. What a token gets depends on the text before
/// it, and a little on the model that is asked for: two names stand in for two checkpoints.
fn logprobs(request: &Value, text: &str) -> Value {
    let share = |text: &str| f64::from(Digest::of(text.as_bytes()).0[0]) / 256.0;
    let letters: Vec<char> = text.chars().collect();
    let token = |(at, token): (usize, &[char])| {
        let token: String = token.iter().collect();
        let before: String = letters[..at * TOKEN].iter().collect();
        let by_model = share(&format!("{}/{before}/{token}", request["model"]));
        let logprob = -2.0 * share(&format!("{before}/{token}")) - MODEL_SHARE * by_model;
        json!({"token": token, "logprob": logprob, "bytes": token.as_bytes(), "top_logprobs": []})
    };
    let content: Vec<Value> = letters.chunks(TOKEN).enumerate().map(token).collect();
    if content.is_empty() {
        Value::Null
    } else {
        json!({"content": content})
    }
}

fn vector(text: &str) -> Vec<f32> {
    let mut vector = vec![0.0; DIMENSIONS];
    for word in language::words(text) {
        let letters: Vec<char> = format!(" {} ", language::lemma(&word)).chars().collect();
        for three in letters.windows(3) {
            let digest = Digest::of(three.iter().collect::<String>().as_bytes());
            vector[usize::from(digest.0[0]) % DIMENSIONS] += 1.0;
        }
    }
    vector
}

#[cfg(test)]
mod tests;
