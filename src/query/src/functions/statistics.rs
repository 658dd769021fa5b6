//! Statistics that SQL lacks: intervals of proportions, tests of paired
//! runs, returns and advantages.

use std::sync::Arc;

use arrow::{
    array::{Array, ArrayRef, AsArray, Float64Array, Float64Builder, ListBuilder, StructArray},
    datatypes::{DataType, Field, Fields, Float64Type, Int64Type},
};
use datafusion::{
    error::Result,
    logical_expr::{ColumnarValue, ScalarUDF, Volatility, create_udf},
};
use reel_statistics::{bootstrap, mcnemar, wilson};

use super::FunctionHelp;

/// Most draws of a bootstrap: samples times pairs.
const DRAWS_MAX: u128 = 100_000_000;

pub(crate) const HELP: &[FunctionHelp] = &[
    FunctionHelp {
        call: "wilson_low(successes, trials)",
        meaning: "Lower end of Wilson's 95 % interval of a proportion; null for no trials.",
        example: "SELECT wilson_low(8, 10)",
    },
    FunctionHelp {
        call: "wilson_high(successes, trials)",
        meaning: "Upper end of that interval.",
        example: "SELECT policy, wilson_low(sum(CAST(success AS INT)), count(*)) AS low, \
                  wilson_high(sum(CAST(success AS INT)), count(*)) AS high FROM episodes GROUP BY policy",
    },
    FunctionHelp {
        call: "mcnemar(only_a, only_b)",
        meaning: "Two-sided exact p-value of McNemar's test: of the tasks that one of two policies solves and the other does \
                  not, `only_a` are solved by the first and `only_b` by the second. Null beyond ten million.",
        example: "SELECT mcnemar(9, 1)",
    },
    FunctionHelp {
        call: "paired_bootstrap(a, b, samples, seed)",
        meaning: "Mean of a[i] - b[i] with its 95 % percentile interval over resampled pairs: struct(difference, low, high).",
        example: "SELECT paired_bootstrap([1, 1, 0, 1], [0, 1, 0, 0], 1000, 7)",
    },
    FunctionHelp {
        call: "discounted(rewards, gamma)",
        meaning: "Discounted return: the sum of gamma^(t-1) r_t.",
        example: "SELECT episode_id, discounted(step_values(steps, 'reward'), 0.99) AS j FROM episodes",
    },
    FunctionHelp {
        call: "advantages(returns, eps)",
        meaning: "Group-relative advantages of a group's returns, in their order: (J - mean) / (std + eps), std of the \
                  population (paper, GSPO Objective).",
        example: "SELECT group_id, advantages(array_agg(discounted_return), 1e-6) AS a FROM episodes GROUP BY group_id",
    },
];

pub(crate) fn functions() -> Vec<ScalarUDF> {
    let (float, int, list) = (DataType::Float64, DataType::Int64, list_of_floats());
    let pair = || vec![float.clone(), float.clone()];
    vec![
        create_udf(
            "wilson_low",
            pair(),
            float.clone(),
            Volatility::Immutable,
            Arc::new(|arguments| two(arguments, wilson_low)),
        ),
        create_udf(
            "wilson_high",
            pair(),
            float.clone(),
            Volatility::Immutable,
            Arc::new(|arguments| two(arguments, wilson_high)),
        ),
        create_udf(
            "mcnemar",
            pair(),
            float.clone(),
            Volatility::Immutable,
            Arc::new(|arguments| two(arguments, mcnemar)),
        ),
        create_udf(
            "paired_bootstrap",
            vec![list.clone(), list.clone(), int.clone(), int],
            DataType::Struct(interval()),
            Volatility::Immutable,
            Arc::new(paired_bootstrap),
        ),
        create_udf(
            "discounted",
            vec![list.clone(), float.clone()],
            float.clone(),
            Volatility::Immutable,
            Arc::new(discounted),
        ),
        create_udf(
            "advantages",
            vec![list.clone(), float],
            list,
            Volatility::Immutable,
            Arc::new(advantages),
        ),
    ]
}

/// Wilson score interval (Wilson 1927), lower end.
fn wilson_low(successes: f64, trials: f64) -> Option<f64> {
    wilson(successes, trials).map(|(low, _)| low)
}

fn wilson_high(successes: f64, trials: f64) -> Option<f64> {
    wilson(successes, trials).map(|(_, high)| high)
}

fn two(
    arguments: &[ColumnarValue],
    function: fn(f64, f64) -> Option<f64>,
) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let (one, other) = (
        arrays[0].as_primitive::<Float64Type>(),
        arrays[1].as_primitive::<Float64Type>(),
    );
    let values: Float64Array = one
        .iter()
        .zip(other)
        .map(|(one, other)| function(one?, other?))
        .collect();
    Ok(ColumnarValue::Array(Arc::new(values)))
}

fn discounted(arguments: &[ColumnarValue]) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let (rewards, gamma) = (
        arrays[0].as_list::<i32>(),
        arrays[1].as_primitive::<Float64Type>(),
    );
    let values = rewards.values().as_primitive::<Float64Type>();
    let offsets = rewards.value_offsets();
    let row = |row: usize| {
        if rewards.is_null(row) || gamma.is_null(row) {
            return None;
        }
        let (from, to) = (offsets[row] as usize, offsets[row + 1] as usize);
        let mut discount = 1.0;
        let mut sum = 0.0;
        for value in &values.values()[from..to] {
            sum += discount * value;
            discount *= gamma.value(row);
        }
        Some(sum)
    };
    let sums: Float64Array = (0..rewards.len()).map(row).collect();
    Ok(ColumnarValue::Array(Arc::new(sums)))
}

fn advantages(arguments: &[ColumnarValue]) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let (returns, eps) = (
        arrays[0].as_list::<i32>(),
        arrays[1].as_primitive::<Float64Type>(),
    );
    let mut lists = ListBuilder::new(Float64Builder::new());
    for row in 0..returns.len() {
        if returns.is_null(row) || eps.is_null(row) {
            lists.append_null();
            continue;
        }
        let group = returns.value(row);
        let group = group.as_primitive::<Float64Type>();
        let known: Vec<f64> = group.iter().flatten().collect();
        let mut advantages = reel_reward::group_relative(&known, eps.value(row)).into_iter();
        for value in group {
            lists
                .values()
                .append_option(value.and_then(|_| advantages.next()));
        }
        lists.append(true);
    }
    Ok(ColumnarValue::Array(Arc::new(lists.finish())))
}

fn paired_bootstrap(arguments: &[ColumnarValue]) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let (a, b) = (arrays[0].as_list::<i32>(), arrays[1].as_list::<i32>());
    let (samples, seeds) = (
        arrays[2].as_primitive::<Int64Type>(),
        arrays[3].as_primitive::<Int64Type>(),
    );
    let mut columns = [
        Float64Builder::new(),
        Float64Builder::new(),
        Float64Builder::new(),
    ];
    for row in 0..a.len() {
        let nothing =
            a.is_null(row) || b.is_null(row) || samples.is_null(row) || seeds.is_null(row);
        let interval = if nothing {
            None
        } else {
            let (one, other) = (a.value(row), b.value(row));
            if one.len() != other.len() {
                return datafusion::common::exec_err!(
                    "paired_bootstrap needs pairs: found {} values and {}",
                    one.len(),
                    other.len()
                );
            }
            let pairs = one
                .as_primitive::<Float64Type>()
                .iter()
                .zip(other.as_primitive::<Float64Type>());
            let differences: Vec<f64> = pairs
                .filter_map(|(one, other)| Some(one? - other?))
                .collect();
            let count = samples.value(row);
            if count < 1 || (count as u128) * differences.len() as u128 > DRAWS_MAX {
                return datafusion::common::exec_err!(
                    "paired_bootstrap: {count} samples of {} pairs; there must be one at least, and samples times pairs \
                     at most {DRAWS_MAX}",
                    differences.len()
                );
            }
            bootstrap(&differences, count as usize, seeds.value(row) as u64)
        };
        for (index, column) in columns.iter_mut().enumerate() {
            column.append_option(interval.map(|interval| interval[index]));
        }
    }
    let arrays: Vec<ArrayRef> = columns
        .into_iter()
        .map(|mut column| Arc::new(column.finish()) as ArrayRef)
        .collect();
    Ok(ColumnarValue::Array(Arc::new(StructArray::new(
        interval(),
        arrays,
        None,
    ))))
}

fn interval() -> Fields {
    ["difference", "low", "high"]
        .into_iter()
        .map(|name| Field::new(name, DataType::Float64, true))
        .collect()
}

fn list_of_floats() -> DataType {
    DataType::List(Arc::new(Field::new_list_field(DataType::Float64, true)))
}
