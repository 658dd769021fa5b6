//! SQL that means harm, or that nobody thought through: refused or stopped, each time with a
//! message that says why.

use std::time::Duration;

use reel_query::{Limits, QueryError, QuerySession, StopReason};
use reel_world::Family;
use tempfile::TempDir;

use crate::{play::success, store};

fn session(dir: &TempDir, limits: Limits) -> QuerySession {
    let plays: Vec<_> = (1..=20)
        .map(|seed| success("oracle", Family::FDP, seed))
        .collect();
    QuerySession::with_limits(store(dir.path(), &plays), limits).unwrap()
}

fn limits() -> Limits {
    Limits {
        memory_bytes: 64 << 20,
        time: Duration::from_secs(2),
        rows: 10_000,
    }
}

#[test]
fn what_never_ends_is_stopped_in_time() {
    let dir = TempDir::new().unwrap();
    let session = session(&dir, limits());
    for sql in [
        "SELECT count(*) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b WHERE a.value + b.value > 7",
        "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r",
    ] {
        let begun = std::time::Instant::now();
        let stopped = session.run(sql).expect_err(sql);
        assert!(
            matches!(
                stopped,
                QueryError::Stopped(StopReason::Time { seconds: 2 } | StopReason::Memory { .. })
            ),
            "{sql}: {stopped}"
        );
        assert!(begun.elapsed() < Duration::from_secs(30), "{sql}");
    }
    assert!(
        session.run("SELECT 1").is_ok(),
        "a stopped query leaves the session as it was"
    );
}

#[test]
fn what_no_limit_on_time_would_let_end_is_not_started() {
    let dir = TempDir::new().unwrap();
    // Time for a machine that has other things to do: what is refused is refused by what it is.
    let patient = Limits {
        time: Duration::from_secs(60),
        ..limits()
    };
    let session = session(&dir, patient);
    let tables: Vec<String> = (0..40).map(|number| format!("steps t{number}")).collect();
    let joins = format!("SELECT count(*) FROM {}", tables.join(", "));
    // Quoted names are names.
    let doubled = |quote: &str| {
        let name = |number: usize| format!("{quote}c{number}{quote}");
        let mut text = format!("WITH {} AS (SELECT 1 AS x)", name(0));
        for number in 1..24 {
            let before = name(number - 1);
            text += &format!(
                ", {} AS (SELECT * FROM {before} UNION ALL SELECT * FROM {before})",
                name(number)
            );
        }
        text + " SELECT count(*) FROM " + &name(23)
    };
    // On one thread, without a pause, already while it is planned.
    let mut nested = "SELECT step FROM steps".to_owned();
    for _ in 0..20 {
        nested = format!("SELECT step FROM steps WHERE step IN ({nested})");
    }
    let compared = "SELECT levenshtein(repeat('a', 120000), repeat('b', 120000))";
    for sql in [
        joins.as_str(),
        &doubled(""),
        &doubled("\""),
        &nested,
        compared,
    ] {
        let begun = std::time::Instant::now();
        let refused = session.run(sql).expect_err(sql);
        assert!(
            matches!(
                refused,
                QueryError::Stopped(
                    StopReason::Estimate { .. }
                        | StopReason::Expansion { .. }
                        | StopReason::Nesting { .. }
                        | StopReason::Comparisons { .. }
                )
            ),
            "{sql:.80}: {refused}"
        );
        assert!(begun.elapsed() < Duration::from_secs(30), "{sql:.80}");
    }
    // What people ask is none of it.
    let mut chain = "WITH c0 AS (SELECT * FROM steps)".to_owned();
    for number in 1..40 {
        chain += &format!(", c{number} AS (SELECT * FROM c{})", number - 1);
    }
    chain += " SELECT count(*) FROM c39";
    let named = "WITH a AS (SELECT * FROM steps), b AS (SELECT * FROM a), c AS (SELECT x.step FROM b x JOIN b y USING (episode_id, step)) \
                 SELECT count(*) FROM c WHERE step IN (SELECT step FROM c)";
    for sql in [
        chain.as_str(),
        named,
        "SELECT median(step) OVER (PARTITION BY episode_id ORDER BY step ROWS BETWEEN 4 PRECEDING AND CURRENT ROW) FROM steps",
        "SELECT array_agg(tool) OVER (PARTITION BY episode_id ORDER BY step) FROM steps",
        "SELECT episode_id, array_distinct(array_agg(tool)) FROM steps GROUP BY 1",
        "SELECT concat('x', text, repeat('y', 100)), replace(text, chr(10), ' ') FROM steps",
        "SELECT count(*) FROM (SELECT concat('a', repeat('x', 20000 * CAST(step = 0 AS INT))) FROM steps)",
        "SELECT count(*) FROM steps WHERE levenshtein(repeat('a', 150), concat(tool, repeat('b', 140))) > 0",
        "SELECT array_length(range(100, 0, -1)), array_length(range(TIMESTAMP '2026-01-01', TIMESTAMP '2026-02-01', INTERVAL '1' DAY))",
        "SELECT array_length(range(step * 1000000, step * 1000000 + 10)) FROM steps",
        "SELECT array_length(range(DATE '2026-01-01', DATE '2026-02-01', INTERVAL '1' MONTH)), length(repeat('x', 100000))",
        "SELECT count(*) FROM steps WHERE step IN (SELECT step FROM steps WHERE step IN (SELECT step FROM steps WHERE step IN (SELECT 1)))",
        "SELECT count(*) FROM (SELECT unnest(range(0, 16000)) AS a FROM steps)",
        "SELECT a.step FROM steps a WHERE EXISTS (SELECT 1 FROM steps b WHERE b.step > a.step) LIMIT 5",
    ] {
        session.run(sql).expect(sql);
    }
}

#[test]
fn long_answers_and_large_values_are_refused() {
    let dir = TempDir::new().unwrap();
    let session = session(&dir, limits());
    let stopped = session
        .run("SELECT a.step FROM steps a, steps b, steps c")
        .unwrap_err();
    assert!(
        matches!(
            stopped,
            QueryError::Stopped(StopReason::Rows { rows: 10_000 })
        ),
        "{stopped}"
    );
    for sql in [
        "SELECT length(repeat('x', 2000000000))",
        "SELECT length(repeat(repeat('x', 1000000), 1000))",
        "SELECT lpad('x', 2000000000)",
        "SELECT rpad('x', 2000000000, 'y')",
        "SELECT array_length(range(0, 100000000000))",
        "SELECT array_length(generate_series(0, 100000000000, 2))",
        "SELECT array_length(array_repeat(1, 2000000000))",
        "SELECT array_length(range(TIMESTAMP '1970-01-01', TIMESTAMP '2100-01-01', INTERVAL '1' SECOND))",
        "SELECT array_sort(range(0, 2000000)) FROM steps",
        "SELECT sum(length(repeat('x', step + 1000000000))) FROM steps",
    ] {
        let refused = session.run(sql).expect_err(sql);
        assert!(
            matches!(refused, QueryError::Stopped(StopReason::Value { .. })),
            "{sql}: {refused}"
        );
    }
    let many =
        "SELECT sum(array_length(range(0, value % 7 + 15000))) FROM generate_series(1, 100000)";
    let refused = session.run(many).expect_err(many);
    assert!(
        matches!(refused, QueryError::Stopped(StopReason::Batch { .. })),
        "{refused}"
    );
    let text = format!("SELECT '{}'", "x".repeat(2 << 20));
    assert!(matches!(
        session.run(&text),
        Err(QueryError::TooLong { .. })
    ));
}

#[test]
fn memory_has_an_end() {
    let dir = TempDir::new().unwrap();
    let session = session(
        &dir,
        Limits {
            time: Duration::from_secs(120),
            memory_bytes: 16 << 20,
            ..limits()
        },
    );
    for sql in [
        "SELECT sum(m - value) FROM (SELECT value, max(value) OVER () AS m FROM generate_series(1, 100000000))",
        "SELECT count(DISTINCT concat('a long text to be kept ', value)) FROM generate_series(1, 100000000)",
        "SELECT array_length(array_agg(concat('a long text to be kept ', value))) FROM generate_series(1, 100000000)",
    ] {
        let refused = session.run(sql).expect_err(sql);
        let text = refused.to_string();
        let by_limit = matches!(refused, QueryError::Stopped(StopReason::Memory { .. }))
            || text.contains("memory")
            || text.contains("disk");
        assert!(by_limit, "{sql}: {text}");
    }
}

#[test]
fn nothing_outside_the_store_is_read_and_nothing_is_written() {
    let dir = TempDir::new().unwrap();
    let session = session(&dir, limits());
    let file = dir.path().join("episodes.parquet");
    for sql in [
        "SELECT * FROM '/etc/passwd'".to_owned(),
        format!("SELECT * FROM '{}'", file.display()),
        "SELECT * FROM read_csv('/etc/passwd')".into(),
        "SELECT * FROM parquet_metadata('/etc/passwd')".into(),
        "SELECT * FROM \"file:///etc/passwd\"".into(),
        format!("COPY episodes TO '{}'", file.display()),
        "CREATE EXTERNAL TABLE t STORED AS CSV LOCATION '/etc/passwd'".into(),
        "INSERT INTO episodes SELECT * FROM episodes".into(),
        "SET datafusion.execution.target_partitions = 1000".into(),
    ] {
        assert!(session.run(&sql).is_err(), "{sql}");
    }
    assert!(!file.exists());
}

#[test]
fn gibberish_and_depth_are_errors() {
    let dir = TempDir::new().unwrap();
    let session = session(&dir, limits());
    let deep = format!("SELECT {}1{}", "(".repeat(5_000), ")".repeat(5_000));
    let nested = format!(
        "SELECT * FROM {}episodes{}",
        "(SELECT * FROM ".repeat(300),
        ")".repeat(300)
    );
    let sums = |count| format!("SELECT {}", vec!["1"; count].join(" + "));
    let unions = |count| vec!["SELECT 1"; count].join(" UNION ALL ");
    for sql in [
        deep.as_str(),
        nested.as_str(),
        "",
        ";",
        "SELECT",
        "\u{0}",
        "SELECT '",
        "SELECT $1",
        "SELECT $missing FROM episodes",
    ] {
        let failed = session.run(sql);
        assert!(failed.is_err(), "{:.60}", sql);
    }
    for long in [sums(20_000), unions(20_000)] {
        assert!(matches!(
            session.run(&long),
            Err(QueryError::TooDeep { .. })
        ));
    }
    session.run(&sums(300)).unwrap();
    // deep, but allowed: answered or refused, and the process lives
    let _ = session.run(&unions(500));
}
