//! What a dataset promises, from outside.

mod leaks;
