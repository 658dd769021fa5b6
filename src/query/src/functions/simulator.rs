//! SQL functions that call the simulator: they open a trace of the store, and what they say follows
//! from its inputs. Rows are worked off in parallel and remembered by the trace's digest; a stopped
//! query stops between two rows.

use std::{
    path::Path,
    sync::{Arc, PoisonError},
};

use arrow::{
    array::{
        Array, ArrayRef, AsArray, BinaryBuilder, BooleanArray, Float64Array, StringBuilder,
        StructArray,
    },
    compute::cast,
    datatypes::{DataType, Field, Fields, Int64Type},
};
use datafusion::{
    common::exec_err,
    error::{DataFusionError, Result},
    logical_expr::{ColumnarValue, ScalarUDF, Volatility, create_udf},
};
use rayon::prelude::*;
use reel_replay::Detail;
use reel_reward::Preset;
use reel_tables::TraceVerdict;
use reel_trace::{TraceError, encode_png};
use reel_world::{Digest, FRAME_HEIGHT, FRAME_WIDTH, record::Metrics};

use super::FunctionHelp;
use crate::control::Control;

pub(crate) const HELP: &[FunctionHelp] = &[
    FunctionHelp {
        call: "replay(trace)",
        meaning: "Runs an episode again from its inputs and compares every digest: struct(verdict, first_divergence, digest). \
                  The verdict is 'exact', 'diverged', 'other_simulator', 'not_replayable' or 'refused', and goes to the \
                  table `verdicts` of a store that can be written.",
        example: "SELECT family, count(*) FROM episodes WHERE replay(trace).verdict = 'exact' GROUP BY family",
    },
    FunctionHelp {
        call: "reward(trace, preset)",
        meaning: "Scores an episode under a built-in preset: struct(total_reward, discounted_return, success, completion). \
                  `reel store reward` scores whole stores, also by presets of your own, without opening traces.",
        example: "SELECT policy, avg(reward(trace, 'real-repo').total_reward) FROM episodes GROUP BY policy",
    },
    FunctionHelp {
        call: "frame(trace, step)",
        meaning: "The image after a step as PNG; step -1 is before the first decision. Where the trace holds no images it \
                  is rendered again.",
        example: "SELECT episode_id, frame(trace, -1) AS png FROM episodes LIMIT 1",
    },
];

/// What these functions are called.
pub(crate) const NAMES: [&str; 3] = ["replay", "reward", "frame"];

/// What `replay` says of a trace.
#[derive(Clone, Debug)]
pub(crate) struct ReplayRow {
    verdict: &'static str,
    first_divergence: Option<String>,
    digest: Option<String>,
}

pub(crate) fn functions(control: &Arc<Control>) -> Vec<ScalarUDF> {
    let (replay_control, frame_control, reward_control) =
        (control.clone(), control.clone(), control.clone());
    vec![
        create_udf(
            NAMES[1],
            vec![DataType::Utf8, DataType::Utf8],
            DataType::Struct(metric_fields()),
            Volatility::Stable,
            Arc::new(move |arguments| reward(arguments, &reward_control)),
        ),
        create_udf(
            NAMES[0],
            vec![DataType::Utf8],
            DataType::Struct(verdict_fields()),
            Volatility::Stable,
            Arc::new(move |arguments| replay(arguments, &replay_control)),
        ),
        create_udf(
            NAMES[2],
            vec![DataType::Utf8, DataType::Int64],
            DataType::Binary,
            Volatility::Stable,
            Arc::new(move |arguments| frame(arguments, &frame_control)),
        ),
    ]
}

fn replay(arguments: &[ColumnarValue], control: &Control) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let rows = each(&arrays[0], control, |path, _| Ok(replayed(path, control)))?;
    let (mut verdicts, mut divergences, mut digests) = (
        StringBuilder::new(),
        StringBuilder::new(),
        StringBuilder::new(),
    );
    for row in rows {
        verdicts.append_option(row.as_ref().map(|row| row.verdict));
        divergences.append_option(row.as_ref().and_then(|row| row.first_divergence.as_deref()));
        digests.append_option(row.as_ref().and_then(|row| row.digest.as_deref()));
    }
    let columns: Vec<ArrayRef> = vec![
        Arc::new(verdicts.finish()),
        Arc::new(divergences.finish()),
        Arc::new(digests.finish()),
    ];
    Ok(ColumnarValue::Array(Arc::new(StructArray::new(
        verdict_fields(),
        columns,
        None,
    ))))
}

/// What the replay of a trace says, remembered for the session by the digest of its file.
fn replayed(path: &Path, control: &Control) -> ReplayRow {
    let refused = |error: &TraceError| ReplayRow {
        verdict: "refused",
        first_divergence: Some(error.to_string()),
        digest: None,
    };
    let bytes = match control.files.bytes(path) {
        Ok(bytes) => bytes,
        Err(error) => return refused(&error),
    };
    let file = Digest::of(&bytes);
    let remembered = || {
        control
            .verdicts
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    };
    if let Some(row) = remembered().get(&file) {
        return row.clone();
    }
    let judged = reel_replay::verify_bytes(&control.files, path, &bytes, Detail::Full);
    let verdict = &judged.verdict;
    let row = ReplayRow {
        verdict: verdict.name(),
        first_divergence: (!verdict.is_exact()).then(|| verdict.to_string()),
        digest: judged.trace.map(|digest| digest.to_string()),
    };
    if judged.is_lasting() {
        control.keep(TraceVerdict::new(
            file,
            judged.trace,
            reel_replay::SIM_VERSION,
            row.verdict.to_owned(),
            verdict.to_string(),
        ));
    }
    remembered().insert(file, row.clone());
    row
}

fn reward(arguments: &[ColumnarValue], control: &Control) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let presets = arrays[1].as_string::<i32>();
    let rows = each(&arrays[0], control, |path, row| {
        if presets.is_null(row) {
            return Ok(None);
        }
        let name = presets.value(row);
        let Some(preset) = Preset::parse(name) else {
            let known = Preset::built_in()
                .map(|preset| preset.name().to_owned())
                .join("', '");
            return exec_err!("reward: no preset is called '{name}'; there are '{known}'");
        };
        let mut trace = control
            .files
            .read(path)
            .map_err(|error| DataFusionError::External(Box::new(error)))?;
        let terms = reel_reward::rewards(
            &preset,
            &trace.task,
            &trace.scene,
            &trace.start,
            &trace.steps,
        );
        for (step, terms) in trace.steps.iter_mut().zip(terms) {
            step.reward = terms;
        }
        let end = trace.end.as_ref().map(|end| &end.graphs);
        Ok(end
            .map(|end| reel_reward::metrics(&preset, &trace.task, &trace.start, &trace.steps, end)))
    })?;
    let rows: Vec<Option<Metrics>> = rows.into_iter().map(Option::flatten).collect();
    let number = |of: fn(&Metrics) -> f64| -> ArrayRef {
        Arc::new(
            rows.iter()
                .map(|row| row.as_ref().map(of))
                .collect::<Float64Array>(),
        )
    };
    let success: BooleanArray = rows
        .iter()
        .map(|row| row.as_ref().map(|metrics| metrics.success))
        .collect();
    let columns = vec![
        number(|metrics| metrics.total_reward),
        number(|metrics| metrics.discounted_return),
        Arc::new(success),
        number(|metrics| metrics.completion),
    ];
    Ok(ColumnarValue::Array(Arc::new(StructArray::new(
        metric_fields(),
        columns,
        None,
    ))))
}

fn frame(arguments: &[ColumnarValue], control: &Control) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let steps = arrays[1].as_primitive::<Int64Type>();
    let files = each(&arrays[0], control, |path, row| {
        if steps.is_null(row) {
            return Ok(None);
        }
        let trace = control
            .files
            .read(path)
            .map_err(|error| DataFusionError::External(Box::new(error)))?;
        let step = steps.value(row);
        let wanted = match step {
            -1 => None,
            _ => Some(u32::try_from(step).map_err(|_| {
                DataFusionError::Execution(format!("frame: there is no step {step}"))
            })?),
        };
        let failed = |error: String| {
            DataFusionError::Execution(format!("frame: {}: {error}", path.display()))
        };
        let rgb = match trace
            .frame_rgb(wanted)
            .map_err(|error| failed(error.to_string()))?
        {
            Some(rgb) => rgb,
            None => reel_replay::frame_at(&trace, wanted, None)
                .map(|frame| frame.rgb)
                .map_err(|verdict| failed(verdict.to_string()))?,
        };
        Ok(Some(encode_png(
            &rgb,
            FRAME_WIDTH as u32,
            FRAME_HEIGHT as u32,
        )))
    })?;
    let mut bytes = BinaryBuilder::new();
    files
        .into_iter()
        .for_each(|png| bytes.append_option(png.flatten()));
    Ok(ColumnarValue::Array(Arc::new(bytes.finish())))
}

/// Works off the traces of a column, several at a time; null stays null.
pub(super) fn each<T: Send>(
    traces: &ArrayRef,
    control: &Control,
    work: impl Fn(&Path, usize) -> Result<T> + Sync,
) -> Result<Vec<Option<T>>> {
    let traces = cast(traces, &DataType::Utf8)?;
    let traces = traces.as_string::<i32>();
    let one = |row: usize| {
        if traces.is_null(row) {
            return Ok(None);
        }
        control.check()?;
        let path = Path::new(traces.value(row));
        if !control.allowed(path) {
            return exec_err!(
                "this store has no trace '{}'; functions open only the traces of `episodes`",
                path.display()
            );
        }
        let done = work(path, row);
        control.count_simulated();
        done.map(Some)
    };
    (0..traces.len()).into_par_iter().map(one).collect()
}

fn metric_fields() -> Fields {
    let float = |name| Field::new(name, DataType::Float64, true);
    let success = Field::new("success", DataType::Boolean, true);
    Fields::from(vec![
        float("total_reward"),
        float("discounted_return"),
        success,
        float("completion"),
    ])
}

fn verdict_fields() -> Fields {
    ["verdict", "first_divergence", "digest"]
        .into_iter()
        .map(|name| Field::new(name, DataType::Utf8, true))
        .collect()
}
