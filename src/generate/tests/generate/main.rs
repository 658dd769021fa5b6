//! Made tasks: the same on any number of threads, placed as SPEC section 3 says, settled where the graph says, written and read.

mod placing;
mod tasks;
