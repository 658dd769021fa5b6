//! Functions over the nested steps of an episode: patterns in linear time, the first step that
//! fits, back and forth, and a column of the steps as a list. Patterns are matched over the bits
//! that come of their conditions.
//!
//! The language of the patterns is `reel_query::pattern`'s. [`needs`] says which columns of the
//! steps a call reads, so that a query reads no others from disk.

use std::{collections::BTreeSet, sync::Arc};

use crate::pattern::{
    ColumnKind, Condition, Literal, Op, Operand, Oscillation, Pattern, StepColumn,
};
use arrow::{
    array::{
        Array, ArrayRef, AsArray, BooleanArray, BooleanBufferBuilder, Int32Array, Int64Array,
        ListArray, StringArray, StructArray,
    },
    buffer::NullBuffer,
    compute::cast,
    datatypes::{DataType, Field, FieldRef, Fields},
};
use datafusion::{
    common::{ScalarValue, exec_err, plan_err},
    error::{DataFusionError, Result},
    logical_expr::{
        ColumnarValue, Expr, ReturnFieldArgs, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl,
        Signature, Volatility,
    },
};

use super::{
    FunctionHelp,
    conditions::{Codes, Episodes, compare, fitting, kind_of, masks, of_values, truth},
};

pub(crate) const HELP: &[FunctionHelp] = &[
    FunctionHelp {
        call: "sequence_match(steps, pattern)",
        meaning: "Whether a pattern occurs in the steps.",
        example: "SELECT count(*) FROM episodes WHERE sequence_match(steps, 'nav_to show_object_by_category .. pick[ok]')",
    },
    FunctionHelp {
        call: "sequence_count(steps, pattern)",
        meaning: "How often it occurs, without overlap.",
        example: "SELECT episode_id, sequence_count(steps, 'nav_to[failed]') FROM episodes",
    },
    FunctionHelp {
        call: "sequence_find(steps, pattern)",
        meaning: "Where it occurs first: struct(first, last), numbers of decisions; null where it does not, or is empty.",
        example: "SELECT sequence_find(steps, '^ !ask* pick').last AS picked_unasked FROM episodes",
    },
    FunctionHelp {
        call: "first_step(steps, condition)",
        meaning: "The first decision that fits; null where none does.",
        example: "SELECT episode_id, first_step(steps, 'pick[goal_object]') FROM episodes",
    },
    FunctionHelp {
        call: "prevailing_tail(steps, condition)",
        meaning: "The stretch up to the end in which decisions that fit outnumber the others by most: struct(first, last, \
                  margin, onset); onset is the earliest from which they outnumber them at all. Null where they never do.",
        example: "SELECT episode_id, prevailing_tail(steps, '[repeated]').first FROM episodes",
    },
    FunctionHelp {
        call: "oscillation(steps)",
        meaning: "The longest run of `nav_to` back and forth between two receptacles (A-B-A...): struct(length, first, one, \
                  other); null below three calls. Four or more are the mark of Lost Memory.",
        example: "SELECT policy, max(oscillation(steps).length) FROM episodes GROUP BY policy",
    },
    FunctionHelp {
        call: "step_values(steps, column)",
        meaning: "A column of the steps as a list of numbers.",
        example: "SELECT step_values(steps, 'reward') FROM episodes LIMIT 1",
    },
    FunctionHelp {
        call: "step_texts(steps, column)",
        meaning: "A column of the steps as a list of texts.",
        example: "SELECT array_to_string(step_texts(steps, 'tool'), ' > ') FROM episodes LIMIT 1",
    },
];

/// The functions that take `steps` as their first argument.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Kind {
    Match,
    Count,
    Find,
    FirstStep,
    PrevailingTail,
    Oscillation,
    Values,
    Texts,
}

const KINDS: [(Kind, &str); 8] = [
    (Kind::Match, "sequence_match"),
    (Kind::Count, "sequence_count"),
    (Kind::Find, "sequence_find"),
    (Kind::FirstStep, "first_step"),
    (Kind::PrevailingTail, "prevailing_tail"),
    (Kind::Oscillation, "oscillation"),
    (Kind::Values, "step_values"),
    (Kind::Texts, "step_texts"),
];

pub(crate) fn functions() -> Vec<ScalarUDF> {
    let function = |(kind, name)| {
        let count = if kind == Kind::Oscillation { 1 } else { 2 };
        ScalarUDF::from(StepFunction {
            kind,
            name,
            signature: Signature::any(count, Volatility::Immutable),
        })
    };
    KINDS.into_iter().map(function).collect()
}

/// The function of a name.
fn by_name(name: &str) -> Result<ScalarUDF> {
    let found = functions()
        .into_iter()
        .find(|function| function.name() == name);
    found.ok_or_else(|| {
        let known = KINDS.map(|(_, name)| name).join(", ");
        DataFusionError::Plan(format!(
            "no function on steps is called {name}; there are {known}"
        ))
    })
}

/// The type of what one of these functions gives for steps of that type.
pub(crate) fn type_over(name: &str, steps: &DataType) -> Result<DataType> {
    by_name(name)?.return_type(&[plain(steps)])
}

/// Applies one of these functions to a column of steps, outside of any question.
pub(crate) fn apply(name: &str, steps: &ArrayRef, text: Option<&str>) -> Result<ArrayRef> {
    let function = by_name(name)?;
    let steps = cast(steps, &plain(steps.data_type()))?;
    let rows = steps.len();
    let text = text.map(ScalarValue::from);
    let mut fields = vec![Arc::new(Field::new(
        "steps",
        steps.data_type().clone(),
        true,
    ))];
    fields.extend(
        text.iter()
            .map(|text| Arc::new(Field::new("text", text.data_type(), false))),
    );
    let scalars = [None, text.as_ref()];
    let return_field = function.return_field_from_args(ReturnFieldArgs {
        arg_fields: &fields,
        scalar_arguments: &scalars[..fields.len()],
    })?;
    let mut args = vec![ColumnarValue::Array(steps)];
    args.extend(text.map(ColumnarValue::Scalar));
    let answer = function.invoke_with_args(ScalarFunctionArgs {
        args,
        arg_fields: fields,
        number_rows: rows,
        return_field,
        config_options: Arc::default(),
    })?;
    answer.into_array(rows)
}

/// Lists with large offsets and text views, as Polars has them, as the types of the store.
fn plain(data_type: &DataType) -> DataType {
    let field = |field: &FieldRef| {
        Arc::new(
            field
                .as_ref()
                .clone()
                .with_data_type(plain(field.data_type())),
        )
    };
    match data_type {
        DataType::LargeList(item) | DataType::List(item) => DataType::List(field(item)),
        DataType::Struct(fields) => DataType::Struct(fields.iter().map(field).collect()),
        DataType::LargeUtf8 | DataType::Utf8View => DataType::Utf8,
        other => other.clone(),
    }
}

/// Columns of the steps that a call of one of these functions reads; none where that is not to be
/// seen from the call.
pub(crate) fn needs(name: &str, arguments: &[Expr]) -> Option<BTreeSet<String>> {
    let (kind, _) = KINDS.into_iter().find(|(_, known)| *known == name)?;
    let text = || match arguments.get(1)? {
        Expr::Literal(value, _) => value.try_as_str().flatten().map(str::to_owned),
        _ => None,
    };
    let mut columns = BTreeSet::new();
    match kind {
        Kind::Oscillation => columns.extend(["tool".to_owned(), "argument".to_owned()]),
        Kind::Values | Kind::Texts => {
            columns.insert(text()?);
        }
        Kind::FirstStep | Kind::PrevailingTail => {
            collect(&Condition::parse(&text()?).ok()?, &mut columns)
        }
        Kind::Match | Kind::Count | Kind::Find => {
            Pattern::parse(&text()?)
                .ok()?
                .conditions()
                .iter()
                .for_each(|condition| collect(condition, &mut columns));
        }
    }
    Some(columns)
}

fn collect(condition: &Condition, columns: &mut BTreeSet<String>) {
    let mut take = |column: &StepColumn| {
        columns.insert(column.name.clone());
    };
    match condition {
        Condition::Any => {}
        Condition::Flag(column)
        | Condition::InList { column, .. }
        | Condition::Like { column, .. }
        | Condition::IsNull(column) => {
            take(column);
        }
        Condition::Compare { left, right, .. } => {
            take(left);
            if let Operand::Column(right) = right {
                take(right);
            }
        }
        Condition::And(parts) | Condition::Or(parts) => {
            parts.iter().for_each(|part| collect(part, columns))
        }
        Condition::Not(part) | Condition::IsTrue(part) => collect(part, columns),
    }
}

#[derive(PartialEq, Eq, Hash, Debug)]
struct StepFunction {
    kind: Kind,
    name: &'static str,
    signature: Signature,
}

impl ScalarUDFImpl for StepFunction {
    fn name(&self) -> &str {
        self.name
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, arguments: &[DataType]) -> Result<DataType> {
        if step_fields(&arguments[0]).is_none() {
            return plan_err!(
                "{} takes the steps of an episode first: {}(steps, ...)",
                self.name,
                self.name
            );
        }
        Ok(match self.kind {
            Kind::Match => DataType::Boolean,
            Kind::Count => DataType::Int64,
            Kind::FirstStep => DataType::Int32,
            Kind::Find => DataType::Struct(span()),
            Kind::PrevailingTail => DataType::Struct(tail_fields()),
            Kind::Oscillation => DataType::Struct(swing()),
            Kind::Values => list_of(DataType::Float64),
            Kind::Texts => list_of(DataType::Utf8),
        })
    }

    fn return_field_from_args(&self, arguments: ReturnFieldArgs<'_>) -> Result<FieldRef> {
        let types: Vec<DataType> = arguments
            .arg_fields
            .iter()
            .map(|field| field.data_type().clone())
            .collect();
        let data_type = self.return_type(&types)?;
        // a wrong pattern is an error of the question, not of its run
        if let Some(Some(text)) = arguments.scalar_arguments.get(1) {
            let (Some(text), Some(fields)) = (text.try_as_str().flatten(), step_fields(&types[0]))
            else {
                return plan_err!("{}: the second argument is a text", self.name);
            };
            self.understand(text, fields)?;
        }
        Ok(Arc::new(Field::new(self.name, data_type, true)))
    }

    fn invoke_with_args(&self, arguments: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let steps = arguments.args[0].to_array(arguments.number_rows)?;
        let Some(fields) = step_fields(steps.data_type()) else {
            return exec_err!("{}: no steps", self.name);
        };
        let steps = Episodes::new(steps.as_list::<i32>());
        let text = match arguments.args.get(1) {
            None => String::new(),
            Some(ColumnarValue::Scalar(text)) => match text.try_as_str().flatten() {
                Some(text) => text.to_owned(),
                None => {
                    return Ok(ColumnarValue::Scalar(ScalarValue::try_from(
                        arguments.return_field.data_type(),
                    )?));
                }
            },
            Some(ColumnarValue::Array(_)) => {
                return exec_err!(
                    "{}: the second argument is one text, not a column",
                    self.name
                );
            }
        };
        let array: ArrayRef = match self.understand(&text, fields)? {
            ConditionArgument::Pattern(pattern) => self.matched(&pattern, &steps)?,
            ConditionArgument::Condition(condition) => match self.kind {
                Kind::PrevailingTail => Arc::new(prevailing_tail(&condition, &steps)?),
                _ => Arc::new(first_step(&condition, &steps)?),
            },
            ConditionArgument::Column(column) => Arc::new(values(&column, self.kind, &steps)?),
            ConditionArgument::Nothing => Arc::new(oscillation(&steps)?),
        };
        Ok(ColumnarValue::Array(array))
    }
}

/// The second argument as parsed for the kind of function.
enum ConditionArgument {
    Pattern(Pattern),
    Condition(Condition),
    Column(String),
    Nothing,
}

impl StepFunction {
    fn understand(&self, text: &str, fields: &Fields) -> Result<ConditionArgument> {
        let known: Vec<(&str, ColumnKind)> = fields
            .iter()
            .filter_map(|field| Some((field.name().as_str(), kind(field)?)))
            .collect();
        let wrong = |error: crate::pattern::PatternError| {
            DataFusionError::Plan(format!("{}: {error}", self.name))
        };
        match self.kind {
            Kind::Oscillation => Ok(ConditionArgument::Nothing),
            Kind::FirstStep | Kind::PrevailingTail => Condition::parse_for(text, &known)
                .map(ConditionArgument::Condition)
                .map_err(wrong),
            Kind::Match | Kind::Count | Kind::Find => {
                let pattern = Pattern::parse(text).map_err(wrong)?;
                pattern.check(&known).map_err(wrong)?;
                Ok(ConditionArgument::Pattern(pattern))
            }
            Kind::Values | Kind::Texts => {
                let fits =
                    |kind: ColumnKind| (self.kind == Kind::Texts) == (kind == ColumnKind::Text);
                match known.iter().find(|(name, _)| *name == text) {
                    Some((_, kind)) if fits(*kind) => {
                        Ok(ConditionArgument::Column(text.to_owned()))
                    }
                    Some((_, kind)) => plan_err!(
                        "{}: the column '{text}' of the steps holds {kind}",
                        self.name
                    ),
                    None => {
                        let names: Vec<&str> = known
                            .iter()
                            .filter(|(_, kind)| fits(*kind))
                            .map(|(name, _)| *name)
                            .collect();
                        plan_err!(
                            "{}: the steps have no column '{text}'; there are {}",
                            self.name,
                            names.join(", ")
                        )
                    }
                }
            }
        }
    }

    fn matched(&self, pattern: &Pattern, steps: &Episodes) -> Result<ArrayRef> {
        let masks = masks(pattern, steps)?;
        let mut matcher = pattern.matcher();
        let nulls = steps.nulls();
        Ok(match self.kind {
            Kind::Match => {
                let mut found = BooleanBufferBuilder::new(steps.len());
                (0..steps.len())
                    .for_each(|row| found.append(matcher.is_match(&masks[steps.range(row)])));
                Arc::new(BooleanArray::new(found.finish(), nulls))
            }
            Kind::Count => {
                let counts =
                    (0..steps.len()).map(|row| matcher.count(&masks[steps.range(row)]) as i64);
                Arc::new(Int64Array::new(counts.collect(), nulls))
            }
            _ => {
                let numbers = steps.numbers();
                let found: Vec<Option<(i32, i32)>> = (0..steps.len())
                    .map(|row| {
                        let range = steps.range(row);
                        let found = matcher
                            .find(&masks[range.clone()])
                            .filter(|found| !found.is_empty())?;
                        Some((
                            numbers(range.start + found.start),
                            numbers(range.start + found.end - 1),
                        ))
                    })
                    .collect();
                let first: Int32Array = found
                    .iter()
                    .map(|found| found.map(|(first, _)| first))
                    .collect();
                let last: Int32Array = found
                    .iter()
                    .map(|found| found.map(|(_, last)| last))
                    .collect();
                let known = NullBuffer::from_iter(found.iter().map(Option::is_some));
                Arc::new(StructArray::new(
                    span(),
                    vec![Arc::new(first), Arc::new(last)],
                    NullBuffer::union(nulls.as_ref(), Some(&known)),
                ))
            }
        })
    }
}

fn first_step(condition: &Condition, steps: &Episodes) -> Result<Int32Array> {
    let fits = fitting(&truth(condition, steps)?);
    let numbers = steps.numbers();
    let first = |row: usize| {
        if steps.list.is_null(row) {
            return None;
        }
        steps
            .range(row)
            .find(|step| fits.value(*step))
            .map(&numbers)
    };
    Ok((0..steps.len()).map(first).collect())
}

/// From the end: each decision that fits counts for the stretch that begins with it, each other one
/// against it. The onset fits itself.
fn prevailing_tail(condition: &Condition, steps: &Episodes) -> Result<StructArray> {
    let fits = fitting(&truth(condition, steps)?);
    let numbers = steps.numbers();
    let tail = |row: usize| {
        let range = steps.range(row);
        let last = numbers(range.clone().next_back()?);
        let (mut sum, mut best, mut onset) = (0, None, last);
        for step in range.rev() {
            sum += if fits.value(step) { 1 } else { -1 };
            if sum > best.map_or(0, |(_, margin)| margin) {
                best = Some((numbers(step), sum));
            }
            if sum > 0 && fits.value(step) {
                onset = numbers(step);
            }
        }
        best.map(|(first, margin)| [first, last, margin, onset])
    };
    let found: Vec<Option<[i32; 4]>> = (0..steps.len())
        .map(|row| tail(row).filter(|_| steps.list.is_valid(row)))
        .collect();
    let column = |index: usize| -> ArrayRef {
        let values = found.iter().map(|found| found.map(|tail| tail[index]));
        Arc::new(values.collect::<Int32Array>())
    };
    Ok(StructArray::new(
        tail_fields(),
        (0..4).map(column).collect(),
        Some(NullBuffer::from_iter(found.iter().map(Option::is_some))),
    ))
}

fn oscillation(steps: &Episodes) -> Result<StructArray> {
    let goes = of_values(steps.column("tool")?, |tools| {
        compare(tools, Op::Eq, &Literal::Text("nav_to".into()))
    })?;
    let goes = fitting(&goes);
    let places = Codes::of(steps.column("argument")?)?;
    let place = |step: usize| {
        if goes.value(step) {
            places.code(step)
        } else {
            None
        }
    };
    let numbers = steps.numbers();
    let mut found: Vec<Option<(Oscillation, &str, &str)>> = Vec::with_capacity(steps.len());
    for row in 0..steps.len() {
        let range = steps.range(row);
        let run = crate::pattern::oscillation(range.clone().map(place));
        found.push(run.filter(|_| steps.list.is_valid(row)).map(|run| {
            let first = range.start + run.first_step;
            let (one, other) = (places.text(first), places.text(first + 1));
            let run = Oscillation {
                first_step: numbers(first) as usize,
                ..run
            };
            (run, one.min(other), one.max(other))
        }));
    }
    let number = |of: fn(&Oscillation) -> usize| -> ArrayRef {
        Arc::new(
            found
                .iter()
                .map(|found| found.as_ref().map(|(run, ..)| of(run) as i32))
                .collect::<Int32Array>(),
        )
    };
    let one: StringArray = found
        .iter()
        .map(|found| found.map(|(_, one, _)| one))
        .collect();
    let other: StringArray = found
        .iter()
        .map(|found| found.map(|(_, _, other)| other))
        .collect();
    let columns = vec![
        number(|run| run.length),
        number(|run| run.first_step),
        Arc::new(one),
        Arc::new(other),
    ];
    Ok(StructArray::new(
        swing(),
        columns,
        Some(NullBuffer::from_iter(found.iter().map(Option::is_some))),
    ))
}

fn values(column: &str, kind: Kind, steps: &Episodes) -> Result<ListArray> {
    let to = if kind == Kind::Texts {
        DataType::Utf8
    } else {
        DataType::Float64
    };
    let values = cast(steps.column(column)?, &to)?;
    let offsets = steps
        .list
        .value_offsets()
        .iter()
        .map(|offset| offset - steps.base as i32);
    let offsets = arrow::buffer::OffsetBuffer::new(offsets.collect());
    Ok(ListArray::new(
        Arc::new(Field::new_list_field(to, true)),
        offsets,
        values,
        steps.nulls(),
    ))
}

/// The fields of a list of structs.
fn step_fields(data_type: &DataType) -> Option<&Fields> {
    match data_type {
        DataType::List(item) => match item.data_type() {
            DataType::Struct(fields) => Some(fields),
            _ => None,
        },
        _ => None,
    }
}

fn kind(field: &FieldRef) -> Option<ColumnKind> {
    kind_of(field.data_type())
}

fn tail_fields() -> Fields {
    ["first", "last", "margin", "onset"]
        .map(|name| Field::new(name, DataType::Int32, true))
        .into_iter()
        .collect()
}

fn span() -> Fields {
    ["first", "last"]
        .into_iter()
        .map(|name| Field::new(name, DataType::Int32, true))
        .collect()
}

fn swing() -> Fields {
    let number = |name| Field::new(name, DataType::Int32, true);
    let text = |name| Field::new(name, DataType::Utf8, true);
    Fields::from(vec![
        number("length"),
        number("first"),
        text("one"),
        text("other"),
    ])
}

fn list_of(item: DataType) -> DataType {
    DataType::List(Arc::new(Field::new_list_field(item, true)))
}
