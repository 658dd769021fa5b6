//! A trace is written as a trajectory, with its images beside it.

use reel_trace::Trace;
use reel_world::{
    SPOKEN_TURN, ToolCall,
    record::{Backend, StateDigests, StepRecord},
};
use serde_json::{Map, Value, json};

use super::{
    Agent, Call, CallResult, Content, FinalMetrics, KeptEpisode, Media, OURS, Observation, Part,
    Source, Step, StepMetrics, Trajectory, VERSION,
};

/// A trajectory with the files that it names.
#[derive(Debug)]
pub struct Exported {
    /// The document to write as JSON.
    pub trajectory: Trajectory,
    /// Images by their path, relative to the document's folder.
    pub images: Vec<(String, Vec<u8>)>,
}

/// A trace as a trajectory. Images go into a folder of that name beside the document; `tools` are
/// those that the policy could call, in OpenAI's schema.
///
/// # Errors
/// When a record cannot be written as JSON.
pub fn export(trace: &Trace, folder: &str, tools: &[Value]) -> serde_json::Result<Exported> {
    let mut images = Vec::new();
    let mut with_image = |step: Option<u32>, text: &str| {
        let Some(webp) = trace.image(step) else {
            return Content::Text(text.to_owned());
        };
        let name = step.map_or_else(|| "start".to_owned(), |step| format!("{step:04}"));
        let path = format!("{folder}/{name}.webp");
        images.push((path.clone(), webp.to_vec()));
        let media_type = "image/webp".to_owned();
        let text = (!text.is_empty()).then(|| Part::Text {
            text: text.to_owned(),
        });
        let image = Part::Image {
            source: Media { media_type, path },
        };
        Content::Parts(text.into_iter().chain([image]).collect())
    };
    let header = &trace.header;
    let text = |name: &str| {
        header
            .policy
            .parameters
            .get(name)?
            .as_str()
            .map(str::to_owned)
    };
    let system = text("system_prompt").map(|prompt| Step {
        message: Content::Text(prompt),
        ..Step::of(Source::System)
    });
    let task = Step {
        message: with_image(None, &trace.task.instruction),
        ..Step::of(Source::User)
    };
    let mut steps: Vec<Step> = system.into_iter().chain([task]).collect();
    for record in &trace.steps {
        let result = with_image(Some(record.step), &record.outcome.text);
        steps.push(step(record, header.backend, result)?);
    }
    for (number, step) in (1..).zip(&mut steps) {
        step.step_id = number;
    }
    let kept = KeptEpisode {
        trace_digest: trace.chain().to_string(),
        header: header.clone(),
        task: (*trace.task).clone(),
        graphs: trace.start.graphs.clone(),
        shortest_path_m: trace.start.shortest_path_m,
        end: trace.end.clone(),
    };
    let version = header.policy.checkpoint.clone();
    let trajectory = Trajectory {
        schema_version: VERSION.to_owned(),
        session_id: Some(header.episode_id.clone()),
        trajectory_id: Some(kept.trace_digest.clone()),
        agent: Agent {
            name: header.policy.name.clone(),
            version: version
                .or_else(|| text("version"))
                .unwrap_or_else(|| "unknown".to_owned()),
            model_name: text("model"),
            tool_definitions: tools.to_vec(),
            extra: Map::new(),
        },
        final_metrics: Some(final_metrics(trace, &steps)),
        steps,
        notes: None,
        continued_trajectory_ref: None,
        extra: ours(&kept)?,
        subagent_trajectories: Vec::new(),
    };
    Ok(Exported { trajectory, images })
}

/// The turn of a decision. Who has no words in our simulator has no model.
fn step(record: &StepRecord, backend: Backend, result: Content) -> serde_json::Result<Step> {
    let call = &record.input.call;
    let policy = record.input.policy.clone().unwrap_or_default();
    let id = format!("call_{}", record.step);
    let said = call.name == SPOKEN_TURN && call.arguments == json!({});
    // What is no object stands in our part.
    let object = call.arguments.is_object();
    let arguments = if object {
        call.arguments.clone()
    } else {
        json!({})
    };
    let tool_calls = Vec::from_iter((!said).then(|| Call {
        tool_call_id: id.clone(),
        function_name: call.name.clone(),
        arguments,
    }));
    let metrics = StepMetrics {
        prompt_tokens: policy.tokens.map(|[read, _]| read),
        completion_tokens: policy.tokens.map(|[_, written]| written),
        logprobs: policy
            .logprobs
            .as_ref()
            .and_then(|scored| scored.policies().next().map(|(_, values)| values.to_vec())),
        extra: Map::new(),
    };
    let mut kept = record.clone();
    kept.outcome.text.clear();
    // Where it has a name, its arguments count although they are null.
    let name = if call.arguments.is_null() { "null" } else { "" };
    kept.input.call = ToolCall::new(
        name,
        if object {
            Value::Null
        } else {
            call.arguments.clone()
        },
    );
    if let Some(policy) = &mut kept.input.policy {
        policy.raw.clear();
        policy.reasoning.clear();
        policy.tokens = None;
    }
    kept.bodies.clear();
    kept.visible.clear();
    kept.digests = StateDigests::default();
    Ok(Step {
        message: Content::Text(policy.raw),
        reasoning_content: Some(policy.reasoning).filter(|text| !text.is_empty()),
        observation: Some(Observation {
            results: vec![CallResult {
                source_call_id: (!tool_calls.is_empty()).then_some(id),
                content: Some(result),
            }],
        }),
        tool_calls,
        llm_call_count: (backend == Backend::Sim && record.input.policy.is_none()).then_some(0),
        metrics: (metrics != StepMetrics::default()).then_some(metrics),
        extra: ours(&kept)?,
        ..Step::of(Source::Agent)
    })
}

fn ours(kept: &impl serde::Serialize) -> serde_json::Result<Map<String, Value>> {
    Ok(Map::from_iter([(
        OURS.to_owned(),
        serde_json::to_value(kept)?,
    )]))
}

fn final_metrics(trace: &Trace, steps: &[Step]) -> FinalMetrics {
    let sum = |of: fn(&StepMetrics) -> Option<u32>| {
        let counts = steps.iter().filter_map(|step| of(step.metrics.as_ref()?));
        let counts: Vec<u64> = counts.map(u64::from).collect();
        (!counts.is_empty()).then(|| counts.iter().sum())
    };
    let extra = trace.end.as_ref().map(|end| {
        let metrics = &end.metrics;
        let facts = json!({
            "success": metrics.success, "completion": metrics.completion, "total_reward": metrics.total_reward,
            "reward_preset": trace.header.reward_preset, "end_reason": end.reason,
        });
        facts.as_object().cloned().unwrap_or_default()
    });
    FinalMetrics {
        total_prompt_tokens: sum(|metrics| metrics.prompt_tokens),
        total_completion_tokens: sum(|metrics| metrics.completion_tokens),
        total_steps: Some(steps.len() as u64),
        extra: extra.unwrap_or_default(),
    }
}
