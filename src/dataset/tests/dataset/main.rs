//! What a dataset promises, from outside.

mod formats;
mod leaks;
mod loaders;
mod sample;
mod whole;
