//! Hostile questions of `src/query/tests/hostile` over REST, as those who mean harm ask them: each
//! is answered within the limits, and two seconds later the server and its processes are idle and
//! small.
//!
//! `REEL_SEEDS` says how many (`make hostile-sql`: 2,000), `REEL_SEED` the first; a line names the
//! worst.

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use tempfile::TempDir;

use crate::expect;

#[path = "../../../query/tests/hostile/questions.rs"]
mod questions;

/// Seeds of a daily run: one of each kind.
const DAILY: u64 = 12;
/// What a question may cost here: seconds, and MiB before it spills.
const TIME_S: u64 = 2;
const MEMORY_MIB: u64 = 64;
/// How long after its limit on time an answer may come: planning is ended from outside after five
/// seconds, and a machine that does other things as well takes its time.
const LATE: Duration = Duration::from_secs(10);
/// How soon after an answer nothing may run any more.
const QUIET: Duration = Duration::from_secs(2);
/// How much larger the server and its processes may stay, in bytes: a process that waits for the
/// next question, with the store open and what its last one left.
const GROWTH_MAX: u64 = 512 << 20;

struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn hostile_questions_end_and_leave_nothing() {
    let folder = TempDir::new().unwrap();
    let data = folder.path().join("data");
    let golden = concat!(env!("CARGO_MANIFEST_DIR"), "/../../traces/golden");
    expect(
        folder.path(),
        0,
        &format!("ingest --store data/store {golden}"),
    );
    let config = folder.path().join("reel.toml");
    let limits =
        format!("[limits]\nsql_timeout_s = {TIME_S}\nsql_mib = {MEMORY_MIB}\nsql_rows = 100000\n");
    fs::write(&config, limits).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_reel"))
        .args(["serve", "--listen", "127.0.0.1:0", "--config"])
        .arg(&config)
        .arg("--data")
        .arg(&data)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let said = child.stdout.take().unwrap();
    let server = Server(child);
    BufReader::new(said).read_line(&mut line).unwrap();
    let address = line
        .split_once("http://")
        .and_then(|(_, rest)| rest.split_once(": "))
        .unwrap_or_else(|| panic!("{line}"))
        .0
        .to_owned();
    let plain = "SELECT count(*) AS n FROM steps";
    assert_eq!(ask(&address, plain).0, 200);
    let number = |name: &str, other: u64| {
        std::env::var(name).map_or(other, |text| text.parse().expect("a number"))
    };
    let (first, seeds) = (number("REEL_SEED", 0), number("REEL_SEEDS", DAILY));
    let before = resident_bytes(server.0.id());
    let (mut slowest, mut largest, mut answered) = ((Duration::ZERO, 0), (0, 0), 0);
    let mut wrong = Vec::new();
    for seed in first..first + seeds {
        let sql = questions::question(seed);
        if seeds > DAILY {
            eprintln!("seed {seed}: {sql:.150}");
        }
        let begun = Instant::now();
        let (status, body) = ask(&address, &sql);
        let took = begun.elapsed();
        answered += u64::from(status == 200);
        let quiet = becomes_quiet(server.0.id());
        let grown = resident_bytes(server.0.id()).saturating_sub(before);
        slowest = slowest.max((took, seed));
        largest = largest.max((grown, seed));
        let late = took > Duration::from_secs(TIME_S) + LATE;
        if ![200, 422].contains(&status) || late || !quiet || grown > GROWTH_MAX {
            wrong.push(format!(
                "seed {seed}: {status} after {took:.1?}, quiet {quiet}, {} MiB larger, {body:.200}: {sql:.300}",
                grown >> 20
            ));
        }
    }
    println!(
        "{seeds} questions over REST, {answered} answered; slowest {:.1?} (seed {}), largest {} MiB more (seed {})",
        slowest.0,
        slowest.1,
        largest.0 >> 20,
        largest.1
    );
    assert!(
        wrong.is_empty(),
        "{} questions:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
    assert_eq!(ask(&address, plain).0, 200);
}

/// Status and body of a question; 0 where the answer broke off.
fn ask(address: &str, sql: &str) -> (u16, String) {
    let body = serde_json::json!({ "sql": sql }).to_string();
    let mut stream = TcpStream::connect(address).unwrap();
    let head = format!(
        "POST /api/sql HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(body.as_bytes()).unwrap();
    let mut answer = Vec::new();
    // What broke off is heard as far as it came.
    let _ = stream.read_to_end(&mut answer);
    let text = String::from_utf8_lossy(&answer).into_owned();
    let status = text
        .split(' ')
        .nth(1)
        .and_then(|status| status.parse().ok());
    let body = text.split_once("\r\n\r\n").map(|(_, body)| body.to_owned());
    (status.unwrap_or(0), body.unwrap_or_default())
}

/// Whether a server and its processes stop computing soon.
fn becomes_quiet(server: u32) -> bool {
    let until = Instant::now() + QUIET;
    loop {
        let before = ticks(server);
        thread::sleep(Duration::from_millis(100));
        // A tick is 10 ms; a process that ended takes its own along.
        if ticks(server).saturating_sub(before) <= 2 {
            return true;
        }
        if Instant::now() > until {
            return false;
        }
    }
}

/// The fields of `/proc/PID/stat` from the third on, of a server and of its processes.
fn stats(server: u32) -> Vec<Vec<String>> {
    let fields = |process: u32| -> Option<Vec<String>> {
        let text = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
        let rest = text.rsplit(')').next()?;
        Some(rest.split_whitespace().map(str::to_owned).collect())
    };
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let processes = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    processes
        .filter_map(|process: u32| {
            let fields = fields(process)?;
            let parent = fields.get(1)?.parse() == Ok(server);
            (process == server || parent).then_some(fields)
        })
        .collect()
}

/// Ticks of the processor that they took so far.
fn ticks(server: u32) -> u64 {
    let of = |fields: &Vec<String>| -> u64 {
        let ticks = fields.iter().skip(11).take(2);
        ticks.filter_map(|ticks| ticks.parse::<u64>().ok()).sum()
    };
    stats(server).iter().map(of).sum()
}

/// What of them lies in RAM, in bytes.
fn resident_bytes(server: u32) -> u64 {
    let of = |fields: &Vec<String>| fields.get(21).and_then(|pages| pages.parse::<u64>().ok());
    stats(server).iter().filter_map(of).sum::<u64>() * 4096
}
