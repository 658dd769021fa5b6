//! The functions on sequences of steps as expressions of Polars: the C interface by which Polars calls
//! functions of other libraries on its own threads, without the interpreter. A column crosses it by
//! Arrow's C data interface, so that no version of Polars has to be linked.
//!
//! The interface is version 0.1 of `polars-ffi`: a column comes as a `SeriesExport`, which the
//! function owns; its answer goes the same way, and an empty one says to ask for the error's text.
//! The pattern is the second column, of one value.

#![allow(unsafe_code, reason = "a C interface")]

use std::{
    cell::RefCell,
    ffi::{CString, c_char, c_void},
    mem::ManuallyDrop,
    panic::catch_unwind,
    ptr, slice,
};

use arrow::{
    array::{Array, ArrayRef, AsArray as _, make_array},
    compute::{cast, concat},
    datatypes::{DataType, Field},
    ffi::{FFI_ArrowArray, FFI_ArrowSchema, from_ffi, to_ffi},
};

/// Version 0.1 of the interface: the major one in the upper half.
const VERSION: u32 = 1;

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// A column on its way through the interface: chunks of one type. `release` frees what holds the
/// chunks and the type; the chunks themselves belong to whom they were handed to.
#[repr(C)]
pub struct SeriesExport {
    field: *mut FFI_ArrowSchema,
    arrays: *mut *mut FFI_ArrowArray,
    len: usize,
    release: Option<unsafe extern "C" fn(*mut SeriesExport)>,
    private_data: *mut c_void,
}

/// What a column of ours consists of while Polars reads it.
struct Exported {
    _field: Box<FFI_ArrowSchema>,
    arrays: Vec<*mut FFI_ArrowArray>,
}

impl SeriesExport {
    /// Takes the column over.
    ///
    /// # Safety
    /// `export` points to a valid export, which nobody else releases.
    unsafe fn take(export: *const Self) -> Result<(String, ArrayRef), String> {
        // SAFETY: by the caller; the copy is the only one that is released.
        let mut export = unsafe { ptr::read(export) };
        // SAFETY: `field` is valid until the release.
        let schema = unsafe { &*export.field };
        // SAFETY: so are as many chunks as `len` says; each is moved out once.
        let chunks = unsafe { slice::from_raw_parts(export.arrays, export.len) }
            .iter()
            .map(|&chunk| unsafe { from_ffi(ptr::read(chunk), schema) }.map(make_array))
            .collect::<Result<Vec<_>, _>>();
        let field = Field::try_from(schema);
        if let Some(release) = export.release {
            // SAFETY: the exporter's own function, on its own export, once.
            unsafe { release(&raw mut export) };
        }
        let field = field.map_err(text)?;
        let chunks = chunks.map_err(text)?;
        let whole: Vec<&dyn Array> = chunks.iter().map(AsRef::as_ref).collect();
        let column = match chunks.as_slice() {
            [] => arrow::array::new_empty_array(field.data_type()),
            [one] => one.clone(),
            _ => concat(&whole).map_err(text)?,
        };
        Ok((field.name().clone(), column))
    }

    /// Hands a column on.
    fn of(name: &str, column: &ArrayRef) -> Result<Self, String> {
        let field = Field::new(name, column.data_type().clone(), true);
        let mut field = Box::new(FFI_ArrowSchema::try_from(&field).map_err(text)?);
        let (array, _) = to_ffi(&column.to_data()).map_err(text)?;
        let mut exported = Box::new(Exported {
            arrays: vec![Box::into_raw(Box::new(array))],
            _field: Box::new(FFI_ArrowSchema::empty()),
        });
        let pointer = &raw mut *field;
        exported._field = field;
        Ok(Self {
            field: pointer,
            arrays: exported.arrays.as_mut_ptr(),
            len: exported.arrays.len(),
            release: Some(release),
            private_data: Box::into_raw(exported).cast(),
        })
    }
}

/// Frees what held a column that Polars has read.
///
/// # Safety
/// `export` is one of [`SeriesExport::of`] that was not released.
unsafe extern "C" fn release(export: *mut SeriesExport) {
    // SAFETY: by the caller.
    let export = unsafe { &mut *export };
    // SAFETY: made by `Box::into_raw` in `of`, and taken back once.
    let exported = unsafe { Box::from_raw(export.private_data.cast::<Exported>()) };
    for &array in &exported.arrays {
        // SAFETY: as above; the array was moved out by the reader, so that only its box is freed.
        drop(unsafe { Box::from_raw(array.cast::<ManuallyDrop<FFI_ArrowArray>>()) });
    }
    export.release = None;
}

fn text(error: impl ToString) -> String {
    error.to_string()
}

/// Does the work of a function, and keeps the text of what went wrong.
fn attempt<T>(work: impl FnOnce() -> Result<T, String> + std::panic::UnwindSafe) -> Option<T> {
    let done = catch_unwind(work).unwrap_or_else(|_| Err("the function panicked".to_owned()));
    done.map_err(|error| {
        let error = CString::new(error.replace('\0', " ")).unwrap_or_default();
        LAST_ERROR.with(|last| *last.borrow_mut() = error);
    })
    .ok()
}

/// # Safety
/// As the interface has it: `inputs` are so many valid exports, `answer` can be written.
unsafe fn call(
    function: &str,
    inputs: *const SeriesExport,
    count: usize,
    answer: *mut SeriesExport,
) {
    let answered = attempt(move || {
        // SAFETY: by the caller.
        let taken = (0..count).map(|index| unsafe { SeriesExport::take(inputs.add(index)) });
        let columns = taken.collect::<Result<Vec<_>, _>>()?;
        let (name, steps) = columns.first().ok_or("the steps are missing")?;
        let pattern = match columns.get(1) {
            Some((_, pattern)) => Some(cast(pattern, &DataType::Utf8).map_err(text)?),
            None => None,
        };
        let pattern = pattern.as_ref().filter(|pattern| !pattern.is_empty());
        let pattern = pattern.map(|pattern| pattern.as_string::<i32>().value(0));
        SeriesExport::of(
            name,
            &reel_query::apply_to_steps(function, steps, pattern).map_err(text)?,
        )
    });
    if let Some(answered) = answered {
        // SAFETY: by the caller; what was there is empty.
        unsafe { ptr::write(answer, answered) };
    }
}

/// # Safety
/// As the interface has it: `fields` are so many valid types, `answer` can be written.
unsafe fn answer_type(
    function: &str,
    fields: *const FFI_ArrowSchema,
    count: usize,
    answer: *mut FFI_ArrowSchema,
) {
    let found = attempt(move || {
        if count == 0 {
            return Err("the steps are missing".to_owned());
        }
        // SAFETY: by the caller, the first of `count` is valid.
        let steps = Field::try_from(unsafe { &*fields }).map_err(text)?;
        let data_type = reel_query::type_over_steps(function, steps.data_type()).map_err(text)?;
        FFI_ArrowSchema::try_from(&Field::new(steps.name(), data_type, true)).map_err(text)
    });
    if let Some(found) = found {
        // SAFETY: by the caller; what was there is empty.
        unsafe { ptr::write(answer, found) };
    }
}

/// The version of the interface.
#[unsafe(no_mangle)]
pub extern "C" fn _polars_plugin_get_version() -> u32 {
    VERSION
}

/// What went wrong last on this thread.
#[unsafe(no_mangle)]
pub extern "C" fn _polars_plugin_get_last_error_message() -> *const c_char {
    LAST_ERROR.with(|last| last.borrow().as_ptr())
}

macro_rules! expressions {
    ($($function:literal $call:ident $field:ident)*) => {$(
        #[doc = concat!("`", $function, "` over a column of steps.")]
        ///
        /// # Safety
        /// Called by Polars alone.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $call(
            inputs: *const SeriesExport,
            count: usize,
            _: *const u8,
            _: usize,
            answer: *mut SeriesExport,
            _: *const c_void,
        ) {
            // SAFETY: by the caller.
            unsafe { call($function, inputs, count, answer) }
        }

        #[doc = concat!("The type of what `", $function, "` gives.")]
        ///
        /// # Safety
        /// Called by Polars alone.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $field(
            fields: *const FFI_ArrowSchema,
            count: usize,
            answer: *mut FFI_ArrowSchema,
            _: *const u8,
            _: usize,
        ) {
            // SAFETY: by the caller.
            unsafe { answer_type($function, fields, count, answer) }
        }
    )*};
}

expressions! {
    "sequence_match" _polars_plugin_sequence_match _polars_plugin_field_sequence_match
    "sequence_count" _polars_plugin_sequence_count _polars_plugin_field_sequence_count
    "sequence_find" _polars_plugin_sequence_find _polars_plugin_field_sequence_find
    "first_step" _polars_plugin_first_step _polars_plugin_field_first_step
    "prevailing_tail" _polars_plugin_prevailing_tail _polars_plugin_field_prevailing_tail
    "oscillation" _polars_plugin_oscillation _polars_plugin_field_oscillation
    "step_values" _polars_plugin_step_values _polars_plugin_field_step_values
    "step_texts" _polars_plugin_step_texts _polars_plugin_field_step_texts
}
