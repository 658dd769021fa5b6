//! Conditions over the steps of many episodes at once, whole columns at a time: what each step
//! fits, as bits. A column that was read as codes is asked once a code, not once a step. Knows
//! no function of SQL.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use crate::pattern::{ColumnKind, Condition, Literal, Op, Operand, Pattern, StepColumn};
use arrow::{
    array::{
        Array, ArrayRef, AsArray, BooleanArray, Float64Array, Int32Array, ListArray, Scalar,
        StringArray, StructArray, UInt32Array, new_null_array,
    },
    buffer::{BooleanBuffer, NullBuffer, OffsetBuffer},
    compute::{
        and_kleene, cast, concat, is_null,
        kernels::{cmp, comparison::like},
        not, or_kleene, take,
    },
    datatypes::{DataType, Field, Fields, Int32Type},
};
use datafusion::{
    common::exec_err,
    error::{DataFusionError, Result},
};

/// The steps of many episodes, flat, and where each episode begins.
pub(super) struct Episodes<'a> {
    pub(super) list: &'a ListArray,
    steps: StructArray,
    /// Of the first step.
    pub(super) base: usize,
}

impl<'a> Episodes<'a> {
    pub(super) fn new(list: &'a ListArray) -> Self {
        let offsets = list.value_offsets();
        let (base, end) = (offsets[0] as usize, offsets[list.len()] as usize);
        Self {
            list,
            steps: list.values().as_struct().slice(base, end - base),
            base,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    pub(super) fn nulls(&self) -> Option<NullBuffer> {
        self.list.nulls().cloned()
    }

    /// The steps of an episode.
    pub(super) fn range(&self, row: usize) -> std::ops::Range<usize> {
        let offsets = self.list.value_offsets();
        offsets[row] as usize - self.base..offsets[row + 1] as usize - self.base
    }

    pub(super) fn column(&self, name: &str) -> Result<&ArrayRef> {
        self.steps
            .column_by_name(name)
            .ok_or_else(|| DataFusionError::Execution(format!("the steps have no column '{name}'")))
    }

    /// Numbers of the decisions: the places of the steps in their episode.
    pub(super) fn numbers(&self) -> impl Fn(usize) -> i32 {
        let mut starts = vec![0; self.steps.len()];
        for row in 0..self.len() {
            let range = self.range(row);
            starts[range.clone()].fill(range.start);
        }
        move |step: usize| (step - starts[step]) as i32
    }

    /// A column, `back` steps earlier in the same episode.
    fn back(&self, column: &StepColumn) -> Result<ArrayRef> {
        let array = self.column(&column.name)?;
        if column.back == 0 {
            return Ok(array.clone());
        }
        let back = column.back as usize;
        let mut indices: Vec<Option<u32>> = vec![None; array.len()];
        for row in 0..self.len() {
            for step in self.range(row).skip(back) {
                indices[step] = Some((step - back) as u32);
            }
        }
        Ok(take(array, &UInt32Array::from(indices), None)?)
    }
}

/// Which conditions of a pattern each step fits.
pub(super) fn masks(pattern: &Pattern, steps: &Episodes) -> Result<Vec<u64>> {
    let mut always = 0;
    let mut by_code: BTreeMap<&str, Vec<(usize, &Condition)>> = BTreeMap::new();
    let mut others = Vec::new();
    for (bit, condition) in pattern.conditions().iter().enumerate() {
        match only_column(condition) {
            _ if *condition == Condition::Any => always |= 1 << bit,
            Some(column) if Coded::of(steps.column(column)?).is_some() => {
                by_code.entry(column).or_default().push((bit, condition));
            }
            _ => others.push((bit, condition)),
        }
    }
    let mut masks = vec![always; steps.steps.len()];
    for (name, conditions) in by_code {
        let Some(coded) = Coded::of(steps.column(name)?) else {
            continue;
        };
        let mut of_code = vec![0_u64; coded.values.len()];
        for (bit, condition) in conditions {
            let fits =
                coded.with_episode(name, |values| Ok(fitting(&truth(condition, values)?)))?;
            fits.set_indices()
                .for_each(|code| of_code[code] |= 1 << bit);
        }
        coded.each(|step, code| masks[step] |= of_code[code]);
    }
    for (bit, condition) in others {
        for step in fitting(&truth(condition, steps)?).set_indices() {
            masks[step] |= 1 << bit;
        }
    }
    Ok(masks)
}

/// The one column that a condition is about, where it is one, and of the step itself.
fn only_column(condition: &Condition) -> Option<&str> {
    let here = |column: &'_ StepColumn| column.back == 0;
    match condition {
        Condition::Flag(column)
        | Condition::InList { column, .. }
        | Condition::Like { column, .. }
        | Condition::IsNull(column)
        | Condition::Compare {
            left: column,
            right: Operand::Literal(_),
            ..
        } => here(column).then_some(&column.name),
        Condition::And(parts) | Condition::Or(parts) => {
            let first = only_column(parts.first()?)?;
            parts[1..]
                .iter()
                .all(|part| only_column(part) == Some(first))
                .then_some(first)
        }
        Condition::Not(part) | Condition::IsTrue(part) => only_column(part),
        Condition::Any | Condition::Compare { .. } => None,
    }
}

/// A column of texts that was read as codes.
struct Coded<'a> {
    codes: &'a Int32Array,
    /// The texts, and a null after them for the steps that have none.
    values: ArrayRef,
}

impl<'a> Coded<'a> {
    fn of(column: &'a ArrayRef) -> Option<Self> {
        let dictionary = column.as_dictionary_opt::<Int32Type>()?;
        let null = new_null_array(dictionary.values().data_type(), 1);
        let values = concat(&[dictionary.values().as_ref(), null.as_ref()]).ok()?;
        Some(Self {
            codes: dictionary.keys(),
            values,
        })
    }

    /// Calls with every step and its code; what is null has the last one.
    fn each(&self, mut take: impl FnMut(usize, usize)) {
        let none = self.values.len() - 1;
        match self.codes.nulls() {
            None => self
                .codes
                .values()
                .iter()
                .enumerate()
                .for_each(|(step, code)| take(step, *code as usize)),
            Some(nulls) => {
                for (step, (code, valid)) in self.codes.values().iter().zip(nulls).enumerate() {
                    take(step, if valid { *code as usize } else { none });
                }
            }
        }
    }

    /// A bit a step, which its code decides.
    fn bits(&self, of_code: impl Fn(usize) -> bool) -> BooleanBuffer {
        let of_code: Vec<bool> = (0..self.values.len()).map(of_code).collect();
        let (codes, none) = (self.codes.values(), self.values.len() - 1);
        match self.codes.nulls() {
            None => BooleanBuffer::collect_bool(codes.len(), |step| of_code[codes[step] as usize]),
            Some(nulls) => BooleanBuffer::collect_bool(codes.len(), |step| {
                of_code[if nulls.is_valid(step) {
                    codes[step] as usize
                } else {
                    none
                }]
            }),
        }
    }

    /// The texts as an episode with a step each.
    fn with_episode<T>(&self, name: &str, take: impl FnOnce(&Episodes) -> Result<T>) -> Result<T> {
        let fields = Fields::from(vec![Field::new(
            name,
            self.values.data_type().clone(),
            true,
        )]);
        let steps = StructArray::new(fields, vec![self.values.clone()], None);
        let item = Arc::new(Field::new_list_field(steps.data_type().clone(), true));
        let list = ListArray::new(
            item,
            OffsetBuffer::from_lengths([steps.len()]),
            Arc::new(steps),
            None,
        );
        take(&Episodes::new(&list))
    }
}

/// What is said of each value of a column, asked once a code where there are codes.
pub(super) fn of_values(
    column: &ArrayRef,
    say: impl Fn(&ArrayRef) -> Result<BooleanArray>,
) -> Result<BooleanArray> {
    let Some(coded) = Coded::of(column) else {
        return say(column);
    };
    let said = say(&coded.values)?;
    let nulls =
        (said.null_count() > 0).then(|| NullBuffer::new(coded.bits(|code| said.is_valid(code))));
    Ok(BooleanArray::new(
        coded.bits(|code| said.is_valid(code) && said.value(code)),
        nulls,
    ))
}

/// Texts as numbers, equal where the texts are.
pub(super) struct Codes {
    texts: StringArray,
    /// Which text a step has; negative: none.
    of_step: Vec<i32>,
}

impl Codes {
    pub(super) fn of(column: &ArrayRef) -> Result<Self> {
        let (texts, codes) = match Coded::of(column) {
            Some(coded) => {
                let mut codes = vec![0; column.len()];
                coded.each(|step, code| codes[step] = code);
                (cast(&coded.values, &DataType::Utf8)?, codes)
            }
            None => (cast(column, &DataType::Utf8)?, (0..column.len()).collect()),
        };
        let texts = texts.as_string::<i32>().clone();
        // a dictionary may hold a text twice
        let mut first = HashMap::new();
        let code = |text: usize| match texts.is_valid(text) {
            true => *first.entry(texts.value(text)).or_insert(text as i32),
            false => -1,
        };
        let of_text: Vec<i32> = (0..texts.len()).map(code).collect();
        Ok(Self {
            of_step: codes.into_iter().map(|text| of_text[text]).collect(),
            texts,
        })
    }

    pub(super) fn code(&self, step: usize) -> Option<i32> {
        Some(self.of_step[step]).filter(|code| *code >= 0)
    }

    /// The text of a step that has one.
    pub(super) fn text(&self, step: usize) -> &str {
        self.texts.value(self.of_step[step] as usize)
    }
}

/// Where a truth is true, not null.
pub(super) fn fitting(truth: &BooleanArray) -> BooleanBuffer {
    match truth.nulls() {
        Some(nulls) => truth.values() & nulls.inner(),
        None => truth.values().clone(),
    }
}

/// What a condition says of each step.
pub(super) fn truth(condition: &Condition, steps: &Episodes) -> Result<BooleanArray> {
    let all = |parts: &[Condition],
               join: fn(
        &BooleanArray,
        &BooleanArray,
    ) -> std::result::Result<BooleanArray, arrow::error::ArrowError>| {
        let mut truths = parts.iter().map(|part| truth(part, steps));
        let first = truths
            .next()
            .unwrap_or_else(|| exec_err!("an empty condition"))?;
        truths.try_fold(first, |sum, next| {
            Ok::<_, DataFusionError>(join(&sum, &next?)?)
        })
    };
    Ok(match condition {
        Condition::Any => BooleanArray::from(vec![true; steps.steps.len()]),
        Condition::Flag(column) => steps.back(column)?.as_boolean().clone(),
        Condition::Compare { left, op, right } => {
            let left = steps.back(left)?;
            match right {
                Operand::Literal(literal) => of_values(&left, |left| compare(left, *op, literal))?,
                Operand::Column(column) => {
                    let right = steps.back(column)?;
                    let plain = match kind_of(left.data_type()) {
                        Some(ColumnKind::Number) => DataType::Float64,
                        Some(ColumnKind::Text) => DataType::Utf8,
                        _ => left.data_type().clone(),
                    };
                    with(*op, &cast(&left, &plain)?, &cast(&right, &plain)?)?
                }
            }
        }
        Condition::InList { column, values } => {
            let column = steps.back(column)?;
            of_values(&column, |column| {
                let mut truths = values.iter().map(|value| compare(column, Op::Eq, value));
                let first = truths
                    .next()
                    .unwrap_or_else(|| exec_err!("an empty list"))?;
                truths.try_fold(first, |sum, next| Ok(or_kleene(&sum, &next?)?))
            })?
        }
        Condition::Like { column, pattern } => {
            let column = steps.back(column)?;
            of_values(&column, |column| {
                Ok(like(
                    column,
                    &Scalar::new(StringArray::from(vec![pattern.as_str()])),
                )?)
            })?
        }
        Condition::IsNull(column) => {
            of_values(&steps.back(column)?, |column| Ok(is_null(column)?))?
        }
        Condition::And(parts) => all(parts, and_kleene)?,
        Condition::Or(parts) => all(parts, or_kleene)?,
        Condition::Not(part) => not(&truth(part, steps)?)?,
        Condition::IsTrue(part) => BooleanArray::new(fitting(&truth(part, steps)?), None),
    })
}

/// How a column compares with a value.
pub(super) fn compare(column: &ArrayRef, op: Op, literal: &Literal) -> Result<BooleanArray> {
    match literal {
        Literal::Text(text) => with(
            op,
            column,
            &Scalar::new(StringArray::from(vec![text.as_str()])),
        ),
        Literal::Flag(flag) => with(op, column, &Scalar::new(BooleanArray::from(vec![*flag]))),
        Literal::Number(number) => {
            let column = cast(column, &DataType::Float64)?;
            with(op, &column, &Scalar::new(Float64Array::from(vec![*number])))
        }
    }
}

fn with(
    op: Op,
    left: &dyn arrow::array::Datum,
    right: &dyn arrow::array::Datum,
) -> Result<BooleanArray> {
    Ok(match op {
        Op::Eq => cmp::eq(left, right),
        Op::NotEq => cmp::neq(left, right),
        Op::Lt => cmp::lt(left, right),
        Op::LtEq => cmp::lt_eq(left, right),
        Op::Gt => cmp::gt(left, right),
        Op::GtEq => cmp::gt_eq(left, right),
    }?)
}

/// What the texts, numbers and flags of a column are called in a pattern.
pub(super) fn kind_of(data_type: &DataType) -> Option<ColumnKind> {
    match data_type {
        DataType::Utf8 | DataType::Utf8View | DataType::LargeUtf8 => Some(ColumnKind::Text),
        DataType::Dictionary(_, value) => kind_of(value),
        DataType::Boolean => Some(ColumnKind::Flag),
        number if number.is_numeric() => Some(ColumnKind::Number),
        _ => None,
    }
}
