//! The SQL function that measures why an episode failed. Reads a trace of the
//! store; nothing is executed.

use std::sync::Arc;

use arrow::{
    array::{ArrayRef, BooleanArray, Float64Array, Int32Array, StringArray, StructArray},
    datatypes::{DataType, Field, Fields},
};
use datafusion::{
    error::{DataFusionError, Result},
    logical_expr::{ColumnarValue, ScalarUDF, Volatility, create_udf},
};
use reel_counterfactual::blame::{Blame, Decisive};

use super::{FunctionHelp, simulator::each};
use crate::control::Control;

pub(crate) const HELP: FunctionHelp = FunctionHelp {
    call: "blame(trace)",
    meaning: "Measures why an episode failed: struct(step, tool, harm, cause, explanation, advised_call, wasted_steps, point_of_no_return, \
              repairable_at_end, perception, communication, memory, primitive, other). `step` is the decisive call, from 0; the last five \
              share out what was lost for good. Of a success all but `wasted_steps` are null. See `reel blame`.",
    example: "SELECT blame(trace).cause AS cause, count(*) FROM episodes WHERE NOT success GROUP BY cause",
};

/// What it is called.
pub(crate) const NAME: &str = "blame";

pub(crate) fn function(control: &Arc<Control>) -> ScalarUDF {
    let control = control.clone();
    create_udf(
        NAME,
        vec![DataType::Utf8],
        DataType::Struct(fields()),
        Volatility::Stable,
        Arc::new(move |arguments| blame(arguments, &control)),
    )
}

fn blame(arguments: &[ColumnarValue], control: &Control) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let rows: Vec<Option<Blame>> = each(&arrays[0], control, |path, _| {
        let trace = control
            .files
            .read(path)
            .map_err(|error| DataFusionError::External(Box::new(error)))?;
        Ok(reel_counterfactual::blame::blame(&trace))
    })?;
    let decisive = || {
        rows.iter()
            .map(|row| row.as_ref().and_then(|row| row.decisive.as_ref()))
    };
    let text = |of: &dyn Fn(&Decisive) -> String| -> ArrayRef {
        Arc::new(
            decisive()
                .map(|decisive| decisive.map(of))
                .collect::<StringArray>(),
        )
    };
    let number = |of: fn(&Blame) -> Option<u32>| -> ArrayRef {
        Arc::new(
            rows.iter()
                .map(|row| row.as_ref().and_then(of).map(|number| number as i32))
                .collect::<Int32Array>(),
        )
    };
    // As in table `blame`: nothing was decisive where an episode was broken off before it failed.
    let unsuccessful = || {
        rows.iter()
            .map(|row| row.as_ref().filter(|row| row.success != Some(true)))
    };
    let share = |of: fn(&Blame) -> f64| -> ArrayRef {
        Arc::new(
            unsuccessful()
                .map(|row| row.map(of))
                .collect::<Float64Array>(),
        )
    };
    let repairable: BooleanArray = unsuccessful()
        .map(|row| row.map(|row| row.repairable_at_end))
        .collect();
    let columns: Vec<ArrayRef> = vec![
        number(|row| row.decisive.as_ref().map(|decisive| decisive.step)),
        text(&|decisive| decisive.tool.clone()),
        text(&|decisive| decisive.harm.name().to_owned()),
        text(&|decisive| decisive.cause.name().to_owned()),
        text(&|decisive| decisive.explanation.clone()),
        text(&|decisive| decisive.advised_call.to_string()),
        number(|row| Some(row.wasted_steps)),
        number(|row| row.point_of_no_return),
        Arc::new(repairable),
        share(|row| row.shares.perception),
        share(|row| row.shares.communication),
        share(|row| row.shares.memory),
        share(|row| row.shares.primitive),
        share(|row| row.shares.other),
    ];
    Ok(ColumnarValue::Array(Arc::new(StructArray::new(
        fields(),
        columns,
        None,
    ))))
}

fn fields() -> Fields {
    let field = |(name, kind): (&str, DataType)| Field::new(name, kind, true);
    let columns = [
        ("step", DataType::Int32),
        ("tool", DataType::Utf8),
        ("harm", DataType::Utf8),
        ("cause", DataType::Utf8),
        ("explanation", DataType::Utf8),
        ("advised_call", DataType::Utf8),
        ("wasted_steps", DataType::Int32),
        ("point_of_no_return", DataType::Int32),
        ("repairable_at_end", DataType::Boolean),
        ("perception", DataType::Float64),
        ("communication", DataType::Float64),
        ("memory", DataType::Float64),
        ("primitive", DataType::Float64),
        ("other", DataType::Float64),
    ];
    columns.map(field).into_iter().collect()
}
