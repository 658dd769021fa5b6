//! Stores of tables: questions in SQL, whose answers are Arrow arrays that other libraries take
//! over without a copy (the PyCapsule interface).

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError, mpsc},
    thread,
    time::Duration,
};

use arrow::{
    array::{
        ArrayRef, RecordBatch, RecordBatchIterator, RecordBatchOptions, RecordBatchReader,
        StructArray,
    },
    compute::cast,
    datatypes::{DataType, Field, Schema, SchemaRef},
    error::ArrowError,
    ipc::{reader::StreamReader, writer::StreamWriter},
};
use pyo3::{
    exceptions::PyStopIteration,
    prelude::*,
    types::{PyBytes, PyCapsule, PyList},
};
use pyo3_arrow::ffi::{ArrayIterator, to_schema_pycapsule, to_stream_pycapsule};
use reel_query::{Control, Format, Limits, Parameters, QueryError, QuerySession, format};

use crate::{
    error::{OrRaise as _, raise},
    rows::dictionaries,
    running::interruptible,
};

/// Batches of an answer that wait for who takes them.
const AHEAD: usize = 4;

/// How pickle makes a store again: the class, and its arguments.
type Pickled<'py> = (Bound<'py, PyAny>, (String, Option<u64>));

/// How pickle makes a table again: the function, and the bytes of an Arrow IPC stream.
type PickledTable<'py> = (Bound<'py, PyAny>, (Bound<'py, PyBytes>,));

/// A store of tables, as it is when a question is asked.
#[pyclass(frozen, module = "reel._reel")]
pub struct Store {
    location: String,
    version: Option<u64>,
}

impl Store {
    fn session(&self, memory_bytes: usize, seconds: Option<f64>) -> PyResult<QuerySession> {
        let store = reel_cli::store(&self.location, self.version)
            .map_err(|error| crate::error::refuse(format!("{error:#}")))?;
        let time = match seconds {
            None => Duration::MAX,
            Some(seconds) if seconds == f64::INFINITY => Duration::MAX,
            Some(seconds) => Duration::try_from_secs_f64(seconds).map_err(|_| {
                crate::error::refuse(format!("timeout is {seconds}; give seconds, or None"))
            })?,
        };
        let limits = Limits {
            memory_bytes,
            time,
            rows: usize::MAX,
        };
        QuerySession::with_limits(store, limits).or_raise()
    }
}

#[pymethods]
impl Store {
    #[new]
    #[pyo3(signature = (location, version = None))]
    fn new(py: Python<'_>, location: String, version: Option<u64>) -> PyResult<Self> {
        let store = Self { location, version };
        py.detach(|| store.session(1 << 30, None))?;
        Ok(store)
    }

    #[getter]
    fn location(&self) -> &str {
        &self.location
    }

    /// The version of the store that questions see now.
    fn version(&self, py: Python<'_>) -> PyResult<u64> {
        Ok(py.detach(|| self.session(1 << 30, None))?.store().version())
    }

    /// Answers a question as a whole.
    #[pyo3(signature = (sql, parameters = None, memory_bytes = 1 << 30, timeout = None))]
    fn sql(
        &self,
        py: Python<'_>,
        sql: &str,
        parameters: Option<BTreeMap<String, String>>,
        memory_bytes: usize,
        timeout: Option<f64>,
    ) -> PyResult<Table> {
        let session = py.detach(|| self.session(memory_bytes, timeout))?;
        let control = session.control();
        let parameters: Parameters = parameters.unwrap_or_default();
        let answer = interruptible(
            py,
            || control.cancel(),
            || session.run_with(sql, &parameters),
        )?;
        Table::of(answer.or_raise()?)
    }

    /// Answers a question batch by batch, as they are taken.
    #[pyo3(signature = (sql, parameters = None, memory_bytes = 1 << 30, timeout = None))]
    fn stream(
        &self,
        py: Python<'_>,
        sql: String,
        parameters: Option<BTreeMap<String, String>>,
        memory_bytes: usize,
        timeout: Option<f64>,
    ) -> PyResult<Stream> {
        let session = py.detach(|| self.session(memory_bytes, timeout))?;
        Stream::of(py, session, sql, parameters.unwrap_or_default())
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Pickled<'py>> {
        Ok((
            py.get_type::<Self>().into_any(),
            (self.location.clone(), self.version),
        ))
    }
}

/// A question that comes with Reel: its text, and the values of its parameters that it has by itself.
#[pyfunction]
pub fn named_query(name: &str) -> PyResult<(&'static str, BTreeMap<String, String>)> {
    let query = reel_query::named::by_name(name).ok_or_else(|| {
        let names: Vec<&str> = reel_query::named::ALL.iter().map(|it| it.name).collect();
        crate::error::refuse(format!(
            "no query is named {name}; there are {}",
            names.join(", ")
        ))
    })?;
    Ok((query.sql, query.parameters().into_iter().collect()))
}

/// The answer to a question: columns of Arrow, in memory.
#[pyclass(frozen, module = "reel._reel")]
pub struct Table {
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

impl Table {
    fn of(batches: Vec<RecordBatch>) -> PyResult<Self> {
        let batches = batches
            .into_iter()
            .map(with_views)
            .collect::<Result<Vec<_>, _>>()
            .or_raise()?;
        let schema = batches
            .first()
            .map_or_else(|| Arc::new(Schema::empty()), RecordBatch::schema);
        Ok(Self { schema, batches })
    }
}

#[pymethods]
impl Table {
    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.schema
            .fields()
            .iter()
            .map(|field| field.name().clone())
            .collect()
    }

    /// Names and Arrow types of the columns, as Arrow's Rust library writes them, e.g. `Int32`.
    fn schema(&self) -> Vec<(String, String)> {
        self.schema
            .fields()
            .iter()
            .map(|field| (field.name().clone(), field.data_type().to_string()))
            .collect()
    }

    /// A table from the bytes of an Arrow IPC stream, as pickle keeps it.
    ///
    /// # Errors
    /// Fails if the bytes are damaged.
    #[staticmethod]
    fn from_ipc(bytes: &[u8]) -> PyResult<Self> {
        let reader = StreamReader::try_new(bytes, None).or_raise()?;
        let schema = reader.schema();
        let batches = reader.collect::<Result<_, _>>().or_raise()?;
        Ok(Self { schema, batches })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<PickledTable<'py>> {
        let mut bytes = Vec::new();
        let mut writer = StreamWriter::try_new(&mut bytes, &self.schema).or_raise()?;
        for batch in &self.batches {
            writer.write(batch).or_raise()?;
        }
        writer.finish().or_raise()?;
        drop(writer);
        let read = py.get_type::<Self>().getattr("from_ipc")?;
        Ok((read, (PyBytes::new(py, &bytes),)))
    }

    /// Bytes of the columns.
    #[getter]
    fn nbytes(&self) -> usize {
        self.batches
            .iter()
            .map(RecordBatch::get_array_memory_size)
            .sum()
    }

    /// The arrays, by Arrow's PyCapsule interface.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyCapsule>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let batches = self.batches.clone().into_iter().map(Ok);
        let reader = Box::new(RecordBatchIterator::new(batches, self.schema.clone()));
        capsule(py, reader, requested_schema)
    }

    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        Ok(to_schema_pycapsule(py, self.schema.as_ref())?)
    }

    /// Rows `start` to `end` as dictionaries.
    fn rows<'py>(&self, py: Python<'py>, start: usize, end: usize) -> PyResult<Bound<'py, PyList>> {
        let mut rows = Vec::new();
        let mut before = 0;
        for batch in &self.batches {
            let count = batch.num_rows();
            let (from, to) = (start.max(before), end.min(before + count));
            if from < to {
                rows.extend(dictionaries(py, &batch.slice(from - before, to - from))?);
            }
            before += count;
        }
        PyList::new(py, rows)
    }

    /// The table as the command line prints it.
    fn __str__(&self) -> PyResult<String> {
        format(&self.batches, Format::Table).or_raise()
    }
}

/// A batch whose texts are views, as Polars and DuckDB hold them: they take these over, and would
/// make views of offsets anew.
fn with_views(batch: RecordBatch) -> Result<RecordBatch, ArrowError> {
    let schema = batch.schema();
    let mut fields = Vec::with_capacity(schema.fields().len());
    let mut columns = Vec::with_capacity(schema.fields().len());
    for (field, column) in schema.fields().iter().zip(batch.columns()) {
        if field.data_type() == &DataType::Utf8 {
            fields.push(Arc::new(
                field.as_ref().clone().with_data_type(DataType::Utf8View),
            ));
            columns.push(cast(column, &DataType::Utf8View)?);
        } else {
            fields.push(field.clone());
            columns.push(column.clone());
        }
    }
    let schema = Schema::new_with_metadata(fields, schema.metadata().clone());
    let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    RecordBatch::try_new_with_options(Arc::new(schema), columns, &options)
}

/// An answer that comes batch by batch. Taken once.
#[pyclass(frozen, module = "reel._reel")]
pub struct Stream {
    schema: SchemaRef,
    batches: Mutex<Option<Batches>>,
}

impl Stream {
    fn of(
        py: Python<'_>,
        session: QuerySession,
        sql: String,
        parameters: Parameters,
    ) -> PyResult<Self> {
        let control = session.control();
        let (sender, receiver) = mpsc::sync_channel(AHEAD);
        thread::spawn(move || {
            let batches = sender.clone();
            let end = session.run_each(&sql, &parameters, |batch| batches.send(Ok(batch)).is_ok());
            if let Err(error) = end {
                let _nobody_left = sender.send(Err(error));
            }
        });
        let wait = move || (receiver.recv(), receiver);
        let (first, receiver) = interruptible(py, || control.cancel(), wait)?;
        let first = match first {
            Ok(Ok(batch)) => with_views(batch).or_raise()?,
            Ok(Err(error)) => return Err(raise(&error)),
            // the thread died without an answer
            Err(gone) => return Err(raise(&gone)),
        };
        Ok(Self {
            schema: first.schema(),
            batches: Mutex::new(Some(Batches {
                schema: first.schema(),
                first: Some(first),
                rest: receiver,
                control,
            })),
        })
    }

    fn take(&self) -> PyResult<Batches> {
        let mut batches = self.batches.lock().unwrap_or_else(PoisonError::into_inner);
        batches
            .take()
            .ok_or_else(|| crate::error::refuse("this stream was taken already; ask again"))
    }
}

#[pymethods]
impl Stream {
    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.schema
            .fields()
            .iter()
            .map(|field| field.name().clone())
            .collect()
    }

    /// The batches that are left, by Arrow's PyCapsule interface.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyCapsule>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        capsule(py, Box::new(self.take()?), requested_schema)
    }

    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        Ok(to_schema_pycapsule(py, self.schema.as_ref())?)
    }

    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    /// The next batch as a table.
    fn __next__(&self, py: Python<'_>) -> PyResult<Table> {
        let mut held = self.batches.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(batches) = held.as_mut() else {
            return Err(PyStopIteration::new_err(()));
        };
        let control = batches.control.clone();
        match interruptible(py, || control.cancel(), || batches.next_batch())? {
            Some(Ok(batch)) => Table::of(vec![batch]),
            Some(Err(error)) => Err(raise(&error)),
            None => Err(PyStopIteration::new_err(())),
        }
    }
}

/// The batches of an answer, first of all the one that told the schema.
struct Batches {
    schema: SchemaRef,
    first: Option<RecordBatch>,
    rest: mpsc::Receiver<Result<RecordBatch, QueryError>>,
    control: Arc<Control>,
}

impl Batches {
    fn next_batch(&mut self) -> Option<Result<RecordBatch, QueryError>> {
        let next = || {
            Some(
                self.rest
                    .recv()
                    .ok()?
                    .and_then(|batch| Ok(with_views(batch)?)),
            )
        };
        self.first.take().map(Ok).or_else(next)
    }
}

impl Iterator for Batches {
    type Item = Result<RecordBatch, ArrowError>;

    fn next(&mut self) -> Option<Self::Item> {
        Some(
            self.next_batch()?
                .map_err(|error| ArrowError::ExternalError(Box::new(error))),
        )
    }
}

impl RecordBatchReader for Batches {
    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }
}

impl Drop for Batches {
    fn drop(&mut self) {
        // who drops the stream wants no more of it
        self.control.cancel();
    }
}

fn capsule<'py>(
    py: Python<'py>,
    reader: Box<dyn RecordBatchReader + Send>,
    requested_schema: Option<Bound<'py, PyCapsule>>,
) -> PyResult<Bound<'py, PyCapsule>> {
    // a batch is an array of records, and a stream of batches one of such arrays
    let schema = reader.schema();
    let field = Field::new_struct("", schema.fields().clone(), false)
        .with_metadata(schema.metadata().clone());
    let records = reader.map(|batch| Ok(Arc::new(StructArray::from(batch?)) as ArrayRef));
    let stream = Box::new(ArrayIterator::new(records, Arc::new(field)));
    to_stream_pycapsule(py, stream, requested_schema).map_err(Into::into)
}
