//! What a question may cost: memory, time, rows, and the size of single values. Counts
//! and refuses; runs nothing.

use std::{sync::Arc, time::Duration};

use arrow::{
    array::{Array, AsArray},
    compute::cast,
    datatypes::{
        DataType, FieldRef, Float64Type, IntervalMonthDayNanoType, IntervalUnit, TimeUnit,
    },
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

/// Most pairs of characters that a function may compare in one batch: seconds.
const COMPARISONS_MAX: u128 = 300_000_000;

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
        // of arguments that are the same for every row a function makes one value
        let column = |value: &ColumnarValue| matches!(value, ColumnarValue::Array(_));
        let once = !arguments.args.iter().any(column);
        let rows = if once { 1 } else { arguments.number_rows };
        let first = arguments.args.first();
        let of = |index| arguments.args.get(index);
        match self.size {
            Size::Compare => {
                let pairs = lengths(first, rows).zip(lengths(of(1), rows));
                self.check_comparisons(pairs.map(|(one, other)| one * other).sum())
            }
            Size::Sum => {
                let all = arguments.args.iter().map(|value| total(Some(value), rows));
                self.check_batch(all.sum())
            }
            Size::Replace => {
                let longest = |index| lengths(of(index), rows).fold(0.0, f64::max);
                let grows = (longest(2) / longest(1).max(1.0)).max(1.0);
                self.check_batch(total(first, rows) * grows)
            }
            Size::Pad => self.check_values(numbers(of(1), rows)),
            Size::Repeat => {
                let one = first.map_or(8.0, |value| width(value, rows));
                self.check_values(numbers(of(1), rows).map(|times| one * times))
            }
            Size::Range => {
                let (from, to) = match of(1) {
                    None => (None, first),
                    to => (first, to),
                };
                let bounds = numbers(from, rows).zip(numbers(to, rows));
                let steps = bounds.zip(numbers_or(of(2), rows, 1.0));
                // a step of nothing is refused by the function itself, a step away from the end
                // makes none
                self.check_values(steps.map(|((from, to), step)| (to - from) / step * 8.0))
            }
        }
    }

    /// Bytes of what is made for each row, one by one and together. A single value is counted for
    /// every row, though it may be made once.
    fn check_values(&self, bytes: impl Iterator<Item = f64>) -> Result<()> {
        let made = bytes.filter(|bytes| bytes.is_finite() && *bytes > 0.0);
        let (largest, sum) = made.fold((0.0_f64, 0.0), |(largest, sum), bytes| {
            (f64::max(largest, bytes), sum + bytes)
        });
        let bytes = largest.clamp(0.0, 1e30) as u128;
        if bytes > VALUE_BYTES_MAX {
            return Err(refused(StopReason::Value {
                function: self.name().to_owned(),
                bytes,
                limit: VALUE_BYTES_MAX,
            }));
        }
        self.check_batch(sum)
    }

    fn check_batch(&self, bytes: f64) -> Result<()> {
        let bytes = bytes.clamp(0.0, 1e30) as u128;
        if bytes > BATCH_BYTES_MAX {
            return Err(refused(StopReason::Batch {
                function: self.name().to_owned(),
                bytes,
                limit: BATCH_BYTES_MAX,
            }));
        }
        Ok(())
    }

    /// Nothing stops the comparison of two texts on its way.
    fn check_comparisons(&self, pairs: f64) -> Result<()> {
        let characters = pairs.clamp(0.0, 1e30) as u128;
        if characters > COMPARISONS_MAX {
            return Err(refused(StopReason::Comparisons {
                function: self.name().to_owned(),
                characters,
                limit: COMPARISONS_MAX,
            }));
        }
        Ok(())
    }
}

fn refused(reason: StopReason) -> DataFusionError {
    DataFusionError::External(Box::new(reason))
}

/// Values of an argument as numbers, row by row: times in nanoseconds, spans of time as such,
/// months of 28 days. 0 where there is none.
fn numbers(value: Option<&ColumnarValue>, rows: usize) -> impl Iterator<Item = f64> {
    numbers_or(value, rows, 0.0)
}

fn numbers_or(
    value: Option<&ColumnarValue>,
    rows: usize,
    missing: f64,
) -> impl Iterator<Item = f64> {
    let values = value.and_then(|value| {
        let array = value.to_array(stored(value, rows)).ok()?;
        let unit = match array.data_type() {
            DataType::Timestamp(TimeUnit::Second, _) => 1e9,
            DataType::Timestamp(TimeUnit::Millisecond, _) => 1e6,
            DataType::Timestamp(TimeUnit::Microsecond, _) => 1e3,
            DataType::Date32 => DAY_NS,
            DataType::Interval(IntervalUnit::MonthDayNano) => {
                let spans = array.as_primitive::<IntervalMonthDayNanoType>();
                let spans = spans.iter().map(|span| {
                    let span = span.unwrap_or_default();
                    let days = f64::from(span.months) * 28.0 + f64::from(span.days);
                    days * DAY_NS + span.nanoseconds as f64
                });
                return Some(spans.collect());
            }
            _ => 1.0,
        };
        // times become whole numbers first
        let whole = match array.data_type() {
            DataType::Timestamp(..) => cast(&array, &DataType::Int64).ok()?,
            DataType::Date32 => cast(&array, &DataType::Int32).ok()?,
            _ => array,
        };
        let array = cast(&whole, &DataType::Float64).ok()?;
        let numbers = array.as_primitive::<Float64Type>().iter();
        Some(
            numbers
                .map(|value| value.unwrap_or(missing) * unit)
                .collect::<Vec<_>>(),
        )
    });
    each_row(values.unwrap_or_else(|| vec![missing]), rows)
}

const DAY_NS: f64 = 86_400e9;

/// A value for each row: what there is one of stands for all.
fn each_row(mut values: Vec<f64>, rows: usize) -> impl Iterator<Item = f64> {
    if let [one] = values[..] {
        values = vec![one; rows.max(1)];
    }
    values.into_iter()
}

/// How many values of an argument are stored.
fn stored(value: &ColumnarValue, rows: usize) -> usize {
    match value {
        ColumnarValue::Array(_) => rows,
        ColumnarValue::Scalar(_) => 1,
    }
}

/// Bytes of one value of an argument: of the longest text, of a list on average.
fn width(value: &ColumnarValue, rows: usize) -> f64 {
    match value.data_type() {
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => {
            lengths(Some(value), rows).fold(0.0, f64::max)
        }
        _ => total(Some(value), rows) / rows.max(1) as f64,
    }
}

/// Bytes of an argument, a single value counted for every row.
fn total(value: Option<&ColumnarValue>, rows: usize) -> f64 {
    let Some(value) = value else {
        return 0.0;
    };
    let stored = stored(value, rows);
    let times = match value {
        ColumnarValue::Array(_) => 1.0,
        ColumnarValue::Scalar(_) => rows.max(1) as f64,
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

/// Lengths of the texts of an argument in bytes, row by row.
fn lengths(value: Option<&ColumnarValue>, rows: usize) -> impl Iterator<Item = f64> {
    let texts = value.and_then(|value| {
        let array = value.to_array(stored(value, rows)).ok()?;
        cast(&array, &DataType::Utf8).ok()
    });
    let lengths = texts.map(|texts| {
        let texts = texts.as_string::<i32>().iter();
        texts
            .map(|text| text.map_or(0.0, |text| text.len() as f64))
            .collect()
    });
    each_row(lengths.unwrap_or_default(), rows)
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
