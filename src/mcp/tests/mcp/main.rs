//! The protocol as clients meet it.

mod conformance;
mod real_contract;
