//! What a part of this process costs: wall time, CPU time and memory, the latter two where
//! the system tells (Linux).

use std::{fmt, time::Instant};

/// Stopwatch for wall and CPU time per round; prints the process's peak memory too.
pub struct Cost {
    began: Instant,
    cpu_s: Option<f64>,
    rounds: u32,
}

impl Cost {
    /// Starts to measure something that is done so many times.
    pub fn of(rounds: u32) -> Self {
        Self {
            began: Instant::now(),
            cpu_s: cpu_s(),
            rounds,
        }
    }
}

impl fmt::Display for Cost {
    /// Until now, a round.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rounds = f64::from(self.rounds);
        write!(
            f,
            "{:.4} s wall",
            self.began.elapsed().as_secs_f64() / rounds
        )?;
        if let (Some(now), Some(before)) = (cpu_s(), self.cpu_s) {
            write!(f, ", {:.4} s CPU", (now - before) / rounds)?;
        }
        if let Some(peak) = peak_mib() {
            write!(f, ", {peak} MiB at most")?;
        }
        Ok(())
    }
}

/// User and system time of the process, which counts in hundredths of a second.
fn cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// Most memory that the process had so far.
fn peak_mib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? / 1024)
}
