//! What a dataset promises, from outside.

mod formats;
mod leaks;
mod sample;
