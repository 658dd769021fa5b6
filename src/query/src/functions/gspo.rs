//! The quantities of GSPO in SQL: advantages by the published estimators, ratios, KL, clip shares
//! and the objective. The mathematics is `reel-reward`'s; what it refuses is the question's error.

use std::sync::Arc;

use arrow::{
    array::{
        Array, ArrayRef, AsArray, Float64Array, Float64Builder, ListArray, ListBuilder, StructArray,
    },
    datatypes::{DataType, Field, Fields, Float64Type},
};
use datafusion::{
    common::exec_err,
    error::{DataFusionError, Result},
    logical_expr::{ColumnarValue, ScalarUDF, Volatility, create_udf},
};
use reel_reward::{
    Estimator, RewardError, Scale,
    gspo::{ClipRange, KlEstimator, clip_share, kl, objective, sequence_ratio, token_ratios},
};

use super::FunctionHelp;

pub(crate) const HELP: &[FunctionHelp] = &[
    FunctionHelp {
        call: "estimated_advantages(returns, estimator, scale)",
        meaning: "Advantages of the rollouts of several groups, from a list of lists of returns: estimator `paper`, `ngrpo`, `grpo`, \
                  `rloo` or `reinforce++`; scale `group`, `batch` or `none` for the last three.",
        example: "SELECT estimated_advantages([[1.0, 3.0], [-4.0, -4.0]], 'ngrpo', 'group')",
    },
    FunctionHelp {
        call: "sequence_ratio(new, old)",
        meaning: "Length-normalised ratio of a sequence from its log-probabilities under two policies: exp(mean(new - old)).",
        example: "SELECT sequence_ratio([-0.5, -1.0], [-0.6, -1.2])",
    },
    FunctionHelp {
        call: "token_ratios(new, old)",
        meaning: "Ratio of each token: exp(new - old).",
        example: "SELECT token_ratios([-0.5, -1.0], [-0.6, -1.2])",
    },
    FunctionHelp {
        call: "kl(policy, reference, estimator)",
        meaning: "Length-normalised estimate of the KL of a sequence from a reference policy, by `k1`, `k2` or `k3`.",
        example: "SELECT kl([-0.5, -1.0], [-0.6, -1.2], 'k3')",
    },
    FunctionHelp {
        call: "clip_share(ratios, advantages, low, high)",
        meaning: "Shares of sequences that are clipped: struct(low, high), below 1 - low with a negative advantage, above 1 + high \
                  with a positive one.",
        example: "SELECT clip_share([0.5, 1.5], [-1.0, 1.0], 0.2, 0.2)",
    },
    FunctionHelp {
        call: "gspo(ratios, advantages, kl, low, high, beta)",
        meaning: "The objective over sequences: struct(loss, surrogate, kl, clip_low, clip_high), loss = -surrogate + beta * kl.",
        example: "SELECT gspo([0.9, 1.5], [-1.0, 1.0], [0.01, 0.02], 0.2, 0.2, 0.04).loss",
    },
];

pub(crate) fn functions() -> Vec<ScalarUDF> {
    let (float, text, list) = (
        DataType::Float64,
        DataType::Utf8,
        list_of(DataType::Float64),
    );
    let groups = list_of(list.clone());
    let function = |name: &str,
                    takes: Vec<DataType>,
                    gives: DataType,
                    run: fn(&[ColumnarValue]) -> Result<ColumnarValue>| {
        create_udf(name, takes, gives, Volatility::Immutable, Arc::new(run))
    };
    let two = vec![list.clone(), list.clone()];
    vec![
        function(
            "estimated_advantages",
            vec![groups.clone(), text.clone(), text.clone()],
            groups,
            estimated_advantages,
        ),
        function("sequence_ratio", two.clone(), float.clone(), |arguments| {
            floats(arguments, |lists, _| {
                sequence_ratio(&lists[0], &lists[1]).map_err(refused)
            })
        }),
        function("token_ratios", two.clone(), list.clone(), |arguments| {
            let arrays = ColumnarValue::values_to_arrays(arguments)?;
            let mut ratios = ListBuilder::new(Float64Builder::new());
            for row in 0..arrays[0].len() {
                match lists(&arrays, row)? {
                    None => ratios.append_null(),
                    Some(lists) => {
                        ratios
                            .values()
                            .append_slice(&token_ratios(&lists[0], &lists[1]).map_err(refused)?);
                        ratios.append(true);
                    }
                }
            }
            Ok(ColumnarValue::Array(Arc::new(ratios.finish())))
        }),
        function(
            "kl",
            [two.clone(), vec![text]].concat(),
            float.clone(),
            |arguments| {
                let arrays = ColumnarValue::values_to_arrays(arguments)?;
                let names = arrays[2].as_string::<i32>();
                floats(&arguments[..2], |lists, row| {
                    let name = if names.is_null(row) {
                        ""
                    } else {
                        names.value(row)
                    };
                    let estimator = KlEstimator::parse(name);
                    let Some(estimator) = estimator else {
                        return exec_err!(
                            "kl: no estimator is called '{name}'; there are k1, k2, k3"
                        );
                    };
                    kl(estimator, &lists[0], &lists[1]).map_err(refused)
                })
            },
        ),
        function(
            "clip_share",
            [two.clone(), vec![float.clone(); 2]].concat(),
            DataType::Struct(named(&CLIP_SHARE)),
            |arguments| {
                structs(arguments, 2, &CLIP_SHARE, |lists, numbers| {
                    let share = clip_share(
                        &lists[0],
                        &lists[1],
                        ClipRange::new(numbers[0], numbers[1])?,
                    )?;
                    Ok([share.low, share.high])
                })
            },
        ),
        function(
            "gspo",
            [two, vec![list], vec![float; 3]].concat(),
            DataType::Struct(named(&OBJECTIVE)),
            |arguments| {
                structs(arguments, 3, &OBJECTIVE, |lists, numbers| {
                    let range = ClipRange::new(numbers[0], numbers[1])?;
                    let of = objective(&lists[0], &lists[1], &lists[2], range, numbers[2])?;
                    Ok([
                        of.loss,
                        of.surrogate,
                        of.kl,
                        of.clipped.low,
                        of.clipped.high,
                    ])
                })
            },
        ),
    ]
}

const CLIP_SHARE: [&str; 2] = ["low", "high"];
const OBJECTIVE: [&str; 5] = ["loss", "surrogate", "kl", "clip_low", "clip_high"];

fn estimated_advantages(arguments: &[ColumnarValue]) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let (batches, names, scales) = (
        arrays[0].as_list::<i32>(),
        arrays[1].as_string::<i32>(),
        arrays[2].as_string::<i32>(),
    );
    let mut found = ListBuilder::new(ListBuilder::new(Float64Builder::new()));
    for row in 0..batches.len() {
        if batches.is_null(row) || names.is_null(row) || scales.is_null(row) {
            found.append_null();
            continue;
        }
        let (name, scale) = (names.value(row), scales.value(row));
        let Some(estimator) = Scale::parse(scale).and_then(|scale| Estimator::named(name, scale))
        else {
            return exec_err!(
                "estimated_advantages: no estimator is called '{name}' with scale '{scale}'; estimators are {}, scales group, batch, none",
                Estimator::NAMES.join(", ")
            );
        };
        let batch = batches.value(row);
        let batch = batch.as_list::<i32>();
        let groups = (0..batch.len())
            .map(|group| Ok(numbers(batch, group)?.unwrap_or_default()))
            .collect::<Result<Vec<_>>>()?;
        for group in estimator.advantages(&groups).map_err(refused)? {
            found.values().values().append_slice(&group);
            found.values().append(true);
        }
        found.append(true);
    }
    Ok(ColumnarValue::Array(Arc::new(found.finish())))
}

/// A number a row from its lists; null where one of them is.
fn floats(
    arguments: &[ColumnarValue],
    of: impl Fn(&[Vec<f64>], usize) -> Result<f64>,
) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let row = |row: usize| {
        lists(&arrays, row)?
            .map(|lists| of(&lists, row))
            .transpose()
    };
    let values = (0..arrays[0].len())
        .map(row)
        .collect::<Result<Float64Array>>()?;
    Ok(ColumnarValue::Array(Arc::new(values)))
}

/// A struct of numbers a row from its lists and the numbers behind them; of nulls where one
/// of them is null.
fn structs<const N: usize>(
    arguments: &[ColumnarValue],
    list_count: usize,
    names: &[&'static str; N],
    of: impl Fn(&[Vec<f64>], &[f64]) -> Result<[f64; N], RewardError>,
) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let mut columns = [(); N].map(|()| Float64Builder::new());
    for row in 0..arrays[0].len() {
        let (of_lists, of_numbers) = arrays.split_at(list_count);
        let numbers: Option<Vec<f64>> = of_numbers
            .iter()
            .map(|array| {
                array
                    .is_valid(row)
                    .then(|| array.as_primitive::<Float64Type>().value(row))
            })
            .collect();
        let values = match lists(of_lists, row)?.zip(numbers) {
            Some((lists, numbers)) => Some(of(&lists, &numbers).map_err(refused)?),
            None => None,
        };
        for (index, column) in columns.iter_mut().enumerate() {
            column.append_option(values.map(|values| values[index]));
        }
    }
    let arrays: Vec<ArrayRef> = columns
        .into_iter()
        .map(|mut column| Arc::new(column.finish()) as ArrayRef)
        .collect();
    Ok(ColumnarValue::Array(Arc::new(StructArray::new(
        named(names),
        arrays,
        None,
    ))))
}

/// The lists of a row; `None` where one of them is null.
fn lists(arrays: &[ArrayRef], row: usize) -> Result<Option<Vec<Vec<f64>>>> {
    arrays
        .iter()
        .map(|array| numbers(array.as_list::<i32>(), row))
        .collect()
}

/// The numbers of a list; `None` where it is null.
fn numbers(list: &ListArray, row: usize) -> Result<Option<Vec<f64>>> {
    if list.is_null(row) {
        return Ok(None);
    }
    let values = list.value(row);
    let values = values.as_primitive::<Float64Type>();
    if values.null_count() > 0 {
        return exec_err!("a list of returns or log-probabilities holds null; filter it out first");
    }
    Ok(Some(values.values().to_vec()))
}

fn refused(error: RewardError) -> DataFusionError {
    DataFusionError::Execution(error.to_string())
}

fn named<const N: usize>(names: &[&'static str; N]) -> Fields {
    names
        .iter()
        .map(|name| Field::new(*name, DataType::Float64, true))
        .collect()
}

fn list_of(item: DataType) -> DataType {
    DataType::List(Arc::new(Field::new_list_field(item, true)))
}
