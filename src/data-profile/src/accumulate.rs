//! Frequent values, quantiles and lengths of all columns in one pass over the rows.

use std::sync::{Arc, Mutex, PoisonError};

use polars::prelude::{Column as Values, DataFrame, DataType, Expr, LazyFrame, PolarsResult};

use crate::{
    conversation::Conversation,
    leaves::Leaf,
    sketch::{Counts, Key, QuantileSketch},
};

/// What is gathered of one column.
#[derive(Clone, Debug, Default)]
pub(crate) struct LeafTotals {
    pub(crate) counts: Counts,
    pub(crate) numbers: QuantileSketch,
}

/// What is gathered of conversations.
#[derive(Clone, Debug, Default)]
pub(crate) struct ConversationTotals {
    pub(crate) turns: QuantileSketch,
    pub(crate) answers: QuantileSketch,
    pub(crate) answer_characters: QuantileSketch,
    pub(crate) images: QuantileSketch,
}

/// What is gathered of a table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    pub(crate) leaves: Vec<LeafTotals>,
    pub(crate) conversation: ConversationTotals,
}

/// A plan of the columns to read, and what gathers its batches.
pub(crate) struct Gathering {
    plan: LazyFrame,
    totals: Arc<Mutex<Totals>>,
}

const TURNS: &str = "turns";
const ANSWERS: &str = "answers";
const IMAGES: &str = "images";

impl Gathering {
    pub(crate) fn new(
        frame: LazyFrame,
        leaves: &[Leaf],
        conversation: Option<&Conversation>,
    ) -> Self {
        let mut read: Vec<Expr> = Vec::new();
        for (index, leaf) in leaves.iter().enumerate() {
            let named = |expr: Expr, kind: char| expr.alias(format!("{kind}{index}"));
            read.extend(leaf.counted().map(|expr| named(expr, 'c')));
            read.extend(leaf.number().map(|expr| named(expr, 'n')));
        }
        if let Some(conversation) = conversation {
            read.push(conversation.turns.clone().alias(TURNS));
            read.extend(conversation.answers.clone().map(|it| it.alias(ANSWERS)));
            read.extend(conversation.images.clone().map(|it| it.alias(IMAGES)));
        }
        let totals = Totals {
            leaves: vec![LeafTotals::default(); leaves.len()],
            conversation: ConversationTotals::default(),
        };
        Self {
            plan: frame.select(read),
            totals: Arc::new(Mutex::new(totals)),
        }
    }

    /// The plan, and the function that takes its batches.
    pub(crate) fn parts(
        &self,
    ) -> (
        LazyFrame,
        impl Fn(DataFrame) -> PolarsResult<()> + Clone + Send + Sync + 'static + use<>,
    ) {
        let totals = Arc::clone(&self.totals);
        let take = move |batch: DataFrame| {
            totals
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .add(&batch)
        };
        (self.plan.clone(), take)
    }

    /// The totals that were gathered, which begin anew.
    pub(crate) fn finish(&self) -> Totals {
        let mut totals = self.totals.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut totals)
    }
}

impl Totals {
    fn add(&mut self, batch: &DataFrame) -> PolarsResult<()> {
        for (index, totals) in self.leaves.iter_mut().enumerate() {
            if let Ok(values) = batch.column(&format!("c{index}")) {
                count(values, &mut totals.counts)?;
            }
            if let Ok(values) = batch.column(&format!("n{index}")) {
                numbers(values, &mut totals.numbers)?;
            }
        }
        let conversation = &mut self.conversation;
        if let Ok(values) = batch.column(TURNS) {
            numbers(values, &mut conversation.turns)?;
        }
        if let Ok(values) = batch.column(IMAGES) {
            let values = values.fill_null(polars::prelude::FillNullStrategy::Zero)?;
            numbers(&values, &mut conversation.images)?;
        }
        if let Ok(values) = batch.column(ANSWERS) {
            let lists = values.as_materialized_series().list()?;
            for row in 0..lists.len() {
                let Some(lengths) = lists.get_as_series(row) else {
                    conversation.answers.add(0.0);
                    continue;
                };
                let lengths = lengths.f64()?;
                let answers = lengths.iter().flatten();
                let count = answers.map(|length| conversation.answer_characters.add(length));
                conversation.answers.add(count.count() as f64);
            }
        }
        Ok(())
    }
}

fn count(values: &Values, counts: &mut Counts) -> PolarsResult<()> {
    let series = values.as_materialized_series();
    match series.dtype() {
        DataType::Boolean => series
            .bool()?
            .iter()
            .flatten()
            .for_each(|value| counts.add(Key::Bool(value))),
        DataType::Int128 => series
            .i128()?
            .iter()
            .flatten()
            .for_each(|value| counts.add(Key::Integer(value))),
        DataType::Float64 => series
            .f64()?
            .iter()
            .flatten()
            .for_each(|value| counts.add_float(value)),
        _ => series
            .str()?
            .iter()
            .flatten()
            .for_each(|value| counts.add_text(value)),
    }
    Ok(())
}

fn numbers(values: &Values, numbers: &mut QuantileSketch) -> PolarsResult<()> {
    let series = values.as_materialized_series();
    series
        .f64()?
        .iter()
        .flatten()
        .for_each(|value| numbers.add(value));
    Ok(())
}
