//! The functions on sequences of steps over Arrow arrays of any library.

use pyo3::prelude::*;
use pyo3_arrow::PyChunkedArray;

use crate::error::OrRaise as _;

/// Applies one of the SQL functions on sequences (`sequence_match`, `first_step`, ...) to a column
/// of steps: a list of records an episode.
#[pyfunction]
#[pyo3(signature = (function, steps, text = None))]
pub fn apply_to_steps(
    py: Python<'_>,
    function: &str,
    steps: PyChunkedArray,
    text: Option<&str>,
) -> PyResult<PyChunkedArray> {
    let (chunks, _) = steps.into_inner();
    let answers = py.detach(|| {
        let apply = |chunk| reel_query::apply_to_steps(function, chunk, text).or_raise();
        chunks.iter().map(apply).collect::<PyResult<Vec<_>>>()
    })?;
    PyChunkedArray::from_array_refs(answers).map_err(Into::into)
}
