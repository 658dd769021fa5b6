//! Scenes and objects: what comes along, what is made by seed, and what the check finds. Made
//! tasks: the same on any number of threads, placed as docs/spec.md#placement says, settled where
//! the graph says, written and read. Questions in their plans.

mod built_in;
mod faults;
mod generated;
mod parts;
mod placing;
mod real_contract;
mod real_proc;
mod social;
mod tasks;
