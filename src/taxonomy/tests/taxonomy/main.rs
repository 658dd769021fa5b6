//! The taxonomy from outside.

mod judge;
#[path = "../../../model/tests/model/scripted.rs"]
#[expect(dead_code, reason = "the judge needs not all that the client's tests do")]
mod scripted;
