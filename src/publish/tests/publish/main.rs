//! Publishing from outside: datasets to folders and to a Hub on this machine, and what is refused.

mod folders;
mod hubs;
mod refusals;
mod sample;
