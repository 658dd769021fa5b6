//! The protocol as clients meet it.

mod conformance;
