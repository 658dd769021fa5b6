//! Scenes and objects: what comes along, what is made, and what the check finds. Made tasks: the same on any number of threads,
//! placed as SPEC section 3 says, settled where the graph says, written and read.

mod mint;
mod placing;
mod tasks;
