//! What a question may cost: memory, time, rows, and the size of single values. Counts
//! and refuses; runs nothing.

use std::{sync::Arc, time::Duration};

use arrow::{
    array::{Array, AsArray},
    compute::cast,
    datatypes::{DataType, FieldRef, Float64Type},
};
use datafusion::{
    error::{DataFusionError, Result},
    execution::FunctionRegistry as _,
    logical_expr::{
        ColumnarValue, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature,
    },
    prelude::SessionContext,
    sql::sqlparser::{
        dialect::GenericDialect,
        keywords::Keyword,
        tokenizer::{Token, Tokenizer},
    },
};

use crate::control::StopReason;

/// Longest SQL text, in bytes.
pub const SQL_BYTES_MAX: usize = 1 << 20;

/// Most operators of a SQL text: a chain of them is a tree as deep as it is long.
pub const OPERATORS_MAX: usize = 2_000;

/// Largest value that a function may make of a small one, in bytes.
const VALUE_BYTES_MAX: u128 = 128 << 10;

/// Most bytes that a function may make of small values in one batch: it cannot be stopped on its
/// way.
const BATCH_BYTES_MAX: u128 = 128 << 20;

/// Most pairs of characters that a function may compare in one batch: a second.
const COMPARISONS_MAX: u128 = 200_000_000;

/// What a question may cost.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Memory that sorts, joins and aggregations may take before they spill to disk, and that the
    /// process may grow by (four times it), in bytes.
    pub memory_bytes: usize,
    /// Longest wall-clock time that a query may run.
    pub time: Duration,
    /// Rows of the answer.
    pub rows: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            memory_bytes: 1 << 30,
            time: Duration::from_secs(600),
            rows: 10_000_000,
        }
    }
}

/// Puts a guard before the functions that make large values of small arguments.
pub(crate) fn guard(context: &SessionContext) {
    for (name, size) in GUARDED {
        if let Ok(function) = context.udf(name) {
            context.register_udf(ScalarUDF::from(Guarded {
                inner: function,
                size: *size,
            }));
        }
    }
}

/// How many bytes a call makes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Size {
    /// The second argument counts characters; the first is repeated.
    Repeat,
    /// The second argument is the length.
    Pad,
    /// From, to and step, of eight bytes each.
    Range,
    /// All arguments, one after the other.
    Sum,
    /// The third argument in the place of every character of the first.
    Replace,
    /// Both arguments are texts, each character of which is compared with each of the other.
    Compare,
}

const GUARDED: &[(&str, Size)] = &[
    ("repeat", Size::Repeat),
    ("lpad", Size::Pad),
    ("rpad", Size::Pad),
    ("array_repeat", Size::Repeat),
    ("array_resize", Size::Pad),
    ("range", Size::Range),
    ("generate_series", Size::Range),
    ("levenshtein", Size::Compare),
    ("concat", Size::Sum),
    ("concat_ws", Size::Sum),
    ("array_concat", Size::Sum),
    // A list beside a column of rows is written out for each of them.
    ("array_append", Size::Sum),
    ("array_distinct", Size::Sum),
    ("array_except", Size::Sum),
    ("array_has", Size::Sum),
    ("array_has_all", Size::Sum),
    ("array_has_any", Size::Sum),
    ("array_intersect", Size::Sum),
    ("array_position", Size::Sum),
    ("array_positions", Size::Sum),
    ("array_prepend", Size::Sum),
    ("array_remove", Size::Sum),
    ("array_remove_all", Size::Sum),
    ("array_replace", Size::Sum),
    ("array_replace_all", Size::Sum),
    ("array_union", Size::Sum),
    ("replace", Size::Replace),
];

#[derive(PartialEq, Eq, Hash, Debug)]
struct Guarded {
    inner: Arc<ScalarUDF>,
    size: Size,
}

impl ScalarUDFImpl for Guarded {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn aliases(&self) -> &[String] {
        self.inner.aliases()
    }

    fn signature(&self) -> &Signature {
        self.inner.signature()
    }

    fn coerce_types(&self, types: &[DataType]) -> Result<Vec<DataType>> {
        self.inner.coerce_types(types)
    }

    fn return_type(&self, types: &[DataType]) -> Result<DataType> {
        self.inner.return_type(types)
    }

    fn return_field_from_args(&self, arguments: ReturnFieldArgs<'_>) -> Result<FieldRef> {
        self.inner.return_field_from_args(arguments)
    }

    fn invoke_with_args(&self, arguments: ScalarFunctionArgs) -> Result<ColumnarValue> {
        self.check(&arguments)?;
        self.inner.invoke_with_args(arguments)
    }
}

impl Guarded {
    fn check(&self, arguments: &ScalarFunctionArgs) -> Result<()> {
        // the arguments that are columns are looked at as a whole
        let column = |index: usize| -> Vec<f64> {
            let all = matches!(arguments.args.get(index), Some(ColumnarValue::Array(_)));
            let rows = if all { arguments.number_rows } else { 1 };
            let Some(value) = arguments.args.get(index) else {
                return Vec::new();
            };
            let Ok(array) = value.to_array(rows) else {
                return Vec::new();
            };
            let Ok(array) = cast(&array, &DataType::Float64) else {
                return Vec::new();
            };
            array
                .as_primitive::<Float64Type>()
                .iter()
                .map(|value| value.unwrap_or(0.0))
                .collect()
        };
        let largest = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
        let bytes = match self.size {
            Size::Compare => return self.check_comparisons(arguments),
            Size::Pad => largest(column(1)),
            Size::Repeat => {
                let (one, rows) = (arguments.args.first(), arguments.number_rows);
                one.map_or(8.0, |value| width(value, rows)) * largest(column(1))
            }
            Size::Sum => {
                let each = arguments.args.iter();
                let all = each.map(|value| total(Some(value), arguments.number_rows));
                return self.check_batch(all.sum());
            }
            Size::Replace => {
                let rows = arguments.number_rows;
                let of = |index| {
                    let value: Option<&ColumnarValue> = arguments.args.get(index);
                    value.map_or(0.0, |value| longest(value, rows))
                };
                let grows = (of(2) / of(1).max(1.0)).max(1.0);
                return self.check_batch(total(arguments.args.first(), rows) * grows);
            }
            Size::Range => {
                let one = arguments.args.len() == 1;
                let (from, to) = if one {
                    (vec![0.0], column(0))
                } else {
                    (column(0), column(1))
                };
                let steps = column(2)
                    .into_iter()
                    .map(f64::abs)
                    .filter(|step| *step > 0.0);
                let step = steps.reduce(f64::min).unwrap_or(1.0);
                let (low, high) = (
                    from.iter()
                        .chain(&to)
                        .copied()
                        .fold(f64::INFINITY, f64::min),
                    largest(from.into_iter().chain(to).collect()),
                );
                (high - low).max(0.0) / step * 8.0
            }
        };
        let bytes = bytes.clamp(0.0, 1e30) as u128;
        let columns = arguments
            .args
            .iter()
            .any(|value| matches!(value, ColumnarValue::Array(_)));
        let rows = match self.size {
            Size::Repeat | Size::Pad if columns => arguments.number_rows.max(1) as u128,
            _ => 1,
        };
        let limit = VALUE_BYTES_MAX.min(BATCH_BYTES_MAX / rows);
        if bytes > limit {
            let stopped = StopReason::Value {
                function: self.name().to_owned(),
                bytes,
                limit,
            };
            return Err(DataFusionError::External(Box::new(stopped)));
        }
        Ok(())
    }
}

impl Guarded {
    fn check_batch(&self, bytes: f64) -> Result<()> {
        let bytes = bytes.clamp(0.0, 1e30) as u128;
        if bytes > BATCH_BYTES_MAX {
            let stopped = StopReason::Batch {
                function: self.name().to_owned(),
                bytes,
                limit: BATCH_BYTES_MAX,
            };
            return Err(DataFusionError::External(Box::new(stopped)));
        }
        Ok(())
    }

    /// Nothing stops the comparison of two texts on its way.
    fn check_comparisons(&self, arguments: &ScalarFunctionArgs) -> Result<()> {
        let [one, other] = [0, 1].map(|index| {
            let value = arguments.args.get(index);
            value.map_or(0.0, |value| longest(value, arguments.number_rows))
        });
        let characters = (one * other * arguments.number_rows as f64) as u128;
        if characters > COMPARISONS_MAX {
            let stopped = StopReason::Comparisons {
                function: self.name().to_owned(),
                characters,
                limit: COMPARISONS_MAX,
            };
            return Err(DataFusionError::External(Box::new(stopped)));
        }
        Ok(())
    }
}

/// Bytes of one value of an argument: of the longest text, of a list on average.
fn width(value: &ColumnarValue, rows: usize) -> f64 {
    match value.data_type() {
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => longest(value, rows),
        _ => total(Some(value), rows) / rows.max(1) as f64,
    }
}

/// Bytes of an argument, a single value counted for every row.
fn total(value: Option<&ColumnarValue>, rows: usize) -> f64 {
    let Some(value) = value else {
        return 0.0;
    };
    let (stored, times) = match value {
        ColumnarValue::Array(_) => (rows, 1.0),
        ColumnarValue::Scalar(_) => (1, rows.max(1) as f64),
    };
    let Ok(array) = value.to_array(stored) else {
        return 0.0;
    };
    let bytes = match array.data_type() {
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => {
            let texts = cast(&array, &DataType::Utf8);
            texts.map_or(0.0, |texts| {
                let lengths = texts.as_string::<i32>().iter().flatten().map(str::len);
                lengths.sum::<usize>() as f64
            })
        }
        // A slice holds all the elements of what it was cut from.
        DataType::List(_) => {
            let list = array.as_list::<i32>();
            let (offsets, values) = (list.value_offsets(), list.values());
            let ends = offsets.last().zip(offsets.first());
            let elements = ends.map_or(0, |(to, from)| to - from);
            let each = values.get_array_memory_size() as f64 / values.len().max(1) as f64;
            f64::from(elements) * each
        }
        _ => 8.0 * stored as f64,
    };
    bytes * times
}

/// Length of the longest text of an argument, in bytes.
fn longest(value: &ColumnarValue, rows: usize) -> f64 {
    let rows = if matches!(value, ColumnarValue::Array(_)) {
        rows
    } else {
        1
    };
    let texts = value
        .to_array(rows)
        .and_then(|array| Ok(cast(&array, &DataType::Utf8)?));
    texts.map_or(8.0, |texts| {
        texts
            .as_string::<i32>()
            .iter()
            .flatten()
            .map(str::len)
            .max()
            .unwrap_or(0) as f64
    })
}

/// Operators of a text, set operations and joins included; 0 where it is no SQL.
pub(crate) fn operators(sql: &str) -> usize {
    let tokens = Tokenizer::new(&GenericDialect {}, sql)
        .tokenize()
        .unwrap_or_default();
    let deepens = |token: &Token| match token {
        Token::Word(word) => matches!(
            word.keyword,
            Keyword::AND
                | Keyword::OR
                | Keyword::NOT
                | Keyword::IS
                | Keyword::LIKE
                | Keyword::UNION
                | Keyword::EXCEPT
                | Keyword::INTERSECT
                | Keyword::JOIN
        ),
        Token::Comma
        | Token::Period
        | Token::SemiColon
        | Token::RParen
        | Token::RBracket
        | Token::Whitespace(_)
        | Token::Number(..)
        | Token::SingleQuotedString(_)
        | Token::DoubleQuotedString(_)
        | Token::EOF => false,
        // calls and parentheses nest no deeper than the parser allows
        Token::LParen => false,
        _ => true,
    };
    tokens.iter().filter(|token| deepens(token)).count()
}

/// Memory of this process that lies in RAM, in bytes; none where the system does not tell.
pub(crate) fn resident_bytes() -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(text.split_whitespace().nth(1)?.parse::<usize>().ok()? * 4096)
}
