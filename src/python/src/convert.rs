//! Values of Reel as Python objects: records as dictionaries, pixels as arrays.

use numpy::{IntoPyArray as _, PyArray2, PyArray3, PyArrayMethods as _};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList, PyTuple},
};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame, ToolCall};
use serde::Serialize;

use crate::error::{OrRaise as _, refuse};

/// Anything with a JSON form, as dictionaries, lists, numbers and texts.
pub fn object<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    // by way of a JSON value: what JSON shows is what Python sees, flattened fields included
    let value = serde_json::to_value(value).or_raise()?;
    pythonize::pythonize(py, &value).map_err(Into::into)
}

/// A JSON value of dictionaries, lists, numbers and texts.
pub fn value(object: &Bound<'_, PyAny>) -> PyResult<serde_json::Value> {
    check_depth(object, DEPTH_MAX)?;
    pythonize::depythonize(object).map_err(Into::into)
}

/// Deepest nesting of what is taken over; what holds itself has no end.
const DEPTH_MAX: usize = 128;

fn check_depth(object: &Bound<'_, PyAny>, left: usize) -> PyResult<()> {
    let inner: Vec<Bound<'_, PyAny>> = if let Ok(map) = object.cast::<PyDict>() {
        map.values().iter().collect()
    } else if let Ok(list) = object.cast::<PyList>() {
        list.iter().collect()
    } else if let Ok(tuple) = object.cast::<PyTuple>() {
        tuple.iter().collect()
    } else {
        return Ok(());
    };
    if left == 0 {
        return Err(refuse(format!(
            "a value is nested deeper than {DEPTH_MAX}, or holds itself"
        )));
    }
    inner
        .iter()
        .try_for_each(|item| check_depth(item, left - 1))
}

/// A call of a tool: its name, and a dictionary of its arguments.
pub fn call(name: &str, arguments: Option<&Bound<'_, PyAny>>) -> PyResult<ToolCall> {
    let arguments = match arguments {
        Some(object) if !object.is_none() => value(object)?,
        _ => serde_json::Value::Object(serde_json::Map::new()),
    };
    Ok(ToolCall::new(name, arguments))
}

/// RGB bytes as an array of height x width x 3, which takes the bytes over without a copy.
pub fn rgb(py: Python<'_>, bytes: Vec<u8>) -> PyResult<Bound<'_, PyArray3<u8>>> {
    bytes
        .into_pyarray(py)
        .reshape([FRAME_HEIGHT, FRAME_WIDTH, 3])
}

/// A value for each pixel as an array of height x width, which takes them over without a copy.
pub fn layer(py: Python<'_>, values: Vec<u16>) -> PyResult<Bound<'_, PyArray2<u16>>> {
    values.into_pyarray(py).reshape([FRAME_HEIGHT, FRAME_WIDTH])
}

/// An image with its depth in millimetres and its instance ids, as three arrays.
pub fn frame(py: Python<'_>, frame: Frame) -> PyResult<Bound<'_, PyAny>> {
    let Frame {
        rgb: pixels,
        ids,
        depth_mm,
        marker_boxes: _,
    } = frame;
    let arrays = (rgb(py, pixels)?, layer(py, depth_mm)?, layer(py, ids)?);
    Ok(arrays.into_pyobject(py)?.into_any())
}

/// The call index that a Python caller means; negative ones count from the end.
pub fn index(wanted: isize, count: usize, what: &str) -> PyResult<usize> {
    let at = if wanted < 0 {
        wanted + count as isize
    } else {
        wanted
    };
    usize::try_from(at)
        .ok()
        .filter(|at| *at < count)
        .ok_or_else(|| refuse(format!("no {what} {wanted}: there are {count}, from 0")))
}
