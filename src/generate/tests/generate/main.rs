//! Scenes and objects: what comes along, what is made by seed, and what the check finds.

mod built_in;
mod faults;
mod generated;
mod library;
mod mint;
