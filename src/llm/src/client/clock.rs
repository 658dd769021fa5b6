//! Time as an argument: who calls owns the real one, and tests do not wait.

use std::time::Duration;

/// The time that goes into the log, and the pauses between tries.
pub trait Clock: Send + Sync {
    /// Nanoseconds since the Unix epoch. Should not go back while the program runs: latencies
    /// are differences of it.
    fn now_ns(&self) -> u64;

    /// Returns after that time.
    fn sleep(&self, pause: Duration);
}
