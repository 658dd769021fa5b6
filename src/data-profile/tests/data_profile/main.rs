//! Profiles, differences and joins over files that the tests write.

mod bad_input;
mod diffs;
mod independent;
mod joins;
mod memory;
mod profiles;
mod write;
