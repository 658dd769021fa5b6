//! The named queries over a store of hand-made episodes, and what the session refuses.

mod answers;
mod functions;
mod hostile;

use reel_vectors::play;
use std::{fs, path::Path};

use play::{DISTRACTOR, Play, TARGET, success};
use reel_query::{Format, QueryError, QuerySession, format, named};
use reel_tables::{Store, schema};
use reel_trace::Images;
use reel_world::{ErrorCode, Family, record::EndReason};
use tempfile::TempDir;

/// Episodes of every class, ingested; returns the store.
fn store(dir: &Path, plays: &[Play]) -> Store {
    let paths = play::record_all(dir, plays);
    let mut store = Store::open_or_create(dir.join("store")).unwrap();
    let report = store.ingest(&paths, &|_, _| ()).unwrap();
    assert_eq!((report.added, report.quarantined), (plays.len(), vec![]));
    store
}

/// The rows as CSV, without the header line.
fn ask(session: &QuerySession, sql: &str) -> Vec<String> {
    let text = format(&session.run(sql).unwrap(), Format::Csv).unwrap();
    text.lines().skip(1).map(str::to_owned).collect()
}

#[test]
fn the_benchmark_counts_by_policy_and_family() {
    let dir = TempDir::new().unwrap();
    let plays = [
        success("oracle", Family::FDP, 1),
        success("oracle", Family::SUL, 2),
        Play::new("hasty", Family::FDP, 1).finish(),
        success("hasty", Family::FDP, 2),
        Play::new("hasty", Family::FDP, 3).nav("table_1"),
    ];
    let mut plays = plays.to_vec();
    let broken_off = plays.pop().unwrap();
    let mut store = store(dir.path(), &plays);
    let part = broken_off.record_as(&dir.path().join("broken.mcap"), Images::None);
    assert_eq!(store.ingest(&[part], &|_, _| ()).unwrap().added, 1);
    let session = QuerySession::new(store).unwrap();
    let rows = ask(
        &session,
        "SELECT policy, family, episodes, success, asks FROM benchmark ORDER BY policy, family",
    );
    assert_eq!(
        rows,
        [
            "hasty,FDP,2,0.5,0.0",
            "hasty,all,2,0.5,0.0",
            "oracle,FDP,1,1.0,0.0",
            "oracle,SUL,1,1.0,1.0",
            "oracle,all,2,1.0,0.5"
        ]
    );
    let rows = ask(
        &session,
        "SELECT policy, fdp, fodp, fdo, sul, \"all\", success FROM main_results ORDER BY success DESC",
    );
    assert_eq!(
        rows,
        ["oracle,1/1,-,-,1/1,2/2,1.0", "hasty,1/2,-,-,-,1/2,0.5"]
    );
    let rows = ask(
        &session,
        "SELECT round(low, 4), round(high, 4) FROM main_results WHERE policy = 'hasty'",
    );
    assert_eq!(rows, ["0.0945,0.9055"], "Wilson's interval of 1 of 2");
}

#[test]
fn failures_are_counted_by_what_went_wrong() {
    let dir = TempDir::new().unwrap();
    let new = |policy: &str, family| Play::new(policy, family, 1);
    let swing = |play: Play| {
        play.nav("desk_1")
            .nav("desk_2")
            .nav("desk_1")
            .nav("desk_2")
            .nav("desk_1")
    };
    #[rustfmt::skip]
    let plays = [
        new("01", Family::SUL)
            .nav("table_1")
            .find("alarm clock")
            .pick(DISTRACTOR)
            .nav("desk_1")
            .place("desk_1")
            .finish(),
        new("02", Family::FDP)
            .nav("table_1")
            .find("alarm clock")
            .pick(DISTRACTOR)
            .nav("desk_1")
            .place("desk_1")
            .finish(),
        new("03", Family::FDP)
            .nav("table_1")
            .pick(TARGET)
            .nav("desk_2")
            .place("desk_2")
            .finish(),
        new("04", Family::FDO)
            .nav("table_1")
            .pick(TARGET)
            .nav("cabinet_1")
            .fails("place", ErrorCode::DoorClosed)
            .finish(),
        swing(new("05", Family::FDP).nav("table_1").pick(TARGET)).ended(EndReason::Horizon),
        new("06", Family::FDO)
            .nav("table_1")
            .pick(TARGET)
            .nav("cabinet_1")
            .ended(EndReason::Horizon),
        new("07", Family::SUL) .nav("table_1") .find("alarm clock") .ended(EndReason::Horizon),
        new("08", Family::FDP).nav("table_1").pick(TARGET).finish(),
        new("09", Family::FDP)
            .nav("table_1")
            .nav("desk_1")
            .nav("table_1")
            .ended(EndReason::Horizon),
        new("10", Family::FDP) .nav("table_1") .pick(TARGET) .ended(EndReason::Fault),
        // asked, so that no question is missing; picked the wrong one first and put it back
        new("11", Family::SUL)
            .ask("Which?", "The white one.")
            .pick(DISTRACTOR)
            .place("table_1")
            .pick(TARGET)
            .place("desk_2")
            .finish(),
        success("12", Family::FDP, 1),
    ];
    let session = QuerySession::new(store(dir.path(), &plays)).unwrap();
    // nobody has classified them yet, and it says so
    let rows = ask(
        &session,
        "SELECT class, count(*), count(sub_class) FROM failed_episodes GROUP BY class",
    );
    assert_eq!(rows, ["not classified,11,0"]);
    assert_eq!(
        ask(&session, "SELECT sum(episodes), sum(share) FROM failures"),
        ["11,11.0"]
    );
    let rows = ask(
        &session,
        "SELECT length, first_step, one, other, policy FROM oscillations ORDER BY length DESC",
    );
    assert_eq!(rows, ["5,2,desk_1,desk_2,05", "3,0,desk_1,table_1,09"]);
    assert_eq!(
        ask(&session, "SELECT * FROM errors"),
        ["04,place,door_closed,moderate,1,1.0"]
    );
    let rows = ask(
        &session,
        "SELECT component, mean, low, high, terms FROM reward_components WHERE policy = '03' ORDER BY component",
    );
    assert_eq!(rows, ["task,1.5,1.5,1.5,1", "time,-0.15,-0.03,-0.03,5"]);
}

#[test]
fn the_steps_are_a_flat_view() {
    let dir = TempDir::new().unwrap();
    let session =
        QuerySession::new(store(dir.path(), &[success("oracle", Family::FDP, 1)])).unwrap();
    let rows = ask(
        &session,
        "SELECT step, tool, argument FROM steps WHERE policy = 'oracle' ORDER BY step LIMIT 2",
    );
    assert_eq!(
        rows,
        ["0,nav_to,table_1", "1,show_object_by_category,alarm clock"]
    );
    let columns = session.run("SELECT * FROM steps").unwrap()[0].num_columns();
    assert_eq!(columns, schema::STEP.len() + 6);
}

#[test]
fn an_empty_store_answers_every_named_query_with_its_columns() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(Store::open_or_create(dir.path()).unwrap()).unwrap();
    for query in named::ALL {
        let batches = session.run(&query.with_defaults()).unwrap();
        assert_eq!(
            batches.iter().map(|batch| batch.num_rows()).sum::<usize>(),
            0
        );
        for column in batches[0].schema().fields() {
            assert!(
                query.help().contains(column.name()),
                "{}: the header does not tell of {}",
                query.name,
                column.name()
            );
        }
    }
}

/// Texts are read as views, tables without a file are not read at all: no answer shows it.
#[test]
fn how_tables_are_read_changes_no_answer() {
    let dir = TempDir::new().unwrap();
    let session =
        QuerySession::new(store(dir.path(), &[success("oracle", Family::FDP, 1)])).unwrap();
    let unions = [
        "SELECT author AS who FROM labels UNION ALL SELECT DISTINCT policy FROM episodes",
        "SELECT author AS who FROM labels UNION ALL (SELECT policy FROM episodes ORDER BY policy LIMIT 3)",
        "SELECT author AS who FROM labels UNION ALL (SELECT author FROM remarks UNION ALL SELECT policy FROM episodes)",
        "SELECT who FROM (SELECT author AS who FROM labels UNION SELECT policy FROM episodes) GROUP BY who",
    ];
    for sql in unions {
        let batches = session.run(sql).unwrap();
        assert_eq!(batches[0].schema().field(0).name(), "who", "{sql}");
        assert_eq!(ask(&session, sql), ["oracle"], "{sql}");
    }
    let joins = [
        (
            "SELECT e.policy, l.author FROM episodes e LEFT JOIN labels l ON l.episode_id = e.episode_id",
            "oracle,",
        ),
        (
            "SELECT e.policy, l.author FROM labels l RIGHT JOIN episodes e ON l.episode_id = e.episode_id",
            "oracle,",
        ),
        (
            "SELECT policy FROM episodes WHERE episode_id NOT IN (SELECT episode_id FROM labels)",
            "oracle",
        ),
        ("SELECT count(*), max(author) FROM labels", "0,"),
        (
            "SELECT policy, (SELECT count(*) FROM labels l WHERE l.episode_id = e.episode_id) AS n FROM episodes e",
            "oracle,0",
        ),
    ];
    for (sql, row) in joins {
        assert_eq!(ask(&session, sql), [row], "{sql}");
    }
    // one value beside a text of the table and one of the steps
    let parameters = [("x".to_owned(), "oracle".to_owned())].into();
    let both = "SELECT count(*) > 0 FROM steps WHERE policy = $x OR tool = $x";
    let batches = session.run_with(both, &parameters).unwrap();
    assert!(format(&batches, Format::Csv).unwrap().ends_with("true\n"));
    for sql in [
        "-- what is there?\nSHOW COLUMNS FROM labels",
        "DESCRIBE labels",
        "SELECT data_type FROM information_schema.columns WHERE table_name = 'labels'",
    ] {
        let told = ask(&session, sql).join("\n");
        assert!(told.contains("Utf8") && !told.contains("View"), "{told}");
    }
}

#[test]
fn only_questions_are_answered() {
    let dir = TempDir::new().unwrap();
    let session =
        QuerySession::new(store(dir.path(), &[success("oracle", Family::FDP, 1)])).unwrap();
    let out = dir.path().join("out.csv");
    let refused = [
        "CREATE TABLE x AS SELECT 1".to_owned(),
        "CREATE VIEW x AS SELECT 1".into(),
        format!(
            "CREATE EXTERNAL TABLE x STORED AS CSV LOCATION '{}'",
            dir.path().display()
        ),
        "DROP TABLE episodes".into(),
        "INSERT INTO episodes SELECT * FROM episodes".into(),
        "DELETE FROM episodes".into(),
        "UPDATE episodes SET success = true".into(),
        format!("COPY (SELECT 1) TO '{}'", out.display()),
        format!("EXPLAIN ANALYZE COPY (SELECT 1) TO '{}'", out.display()),
        "SET datafusion.execution.batch_size = 1".into(),
        "PREPARE p AS SELECT 1".into(),
        "SELECT 1; SELECT 2".into(),
    ];
    for sql in refused {
        let error = session.run(&sql).expect_err(&sql);
        assert!(
            matches!(error, QueryError::ReadOnly { .. }),
            "{sql}: {error}"
        );
    }
    assert!(!out.exists());
    assert_eq!(ask(&session, "SELECT count(*) FROM episodes"), ["1"]);
    for sql in [
        "SELECT nothing FROM episodes",
        "SELEKT",
        "SELECT * FROM '/etc/passwd'",
    ] {
        assert!(
            matches!(session.run(sql), Err(QueryError::Engine(_))),
            "{sql}"
        );
    }
    assert_eq!(
        ask(
            &session,
            "SELECT table_name FROM information_schema.tables WHERE table_name = 'steps'"
        ),
        ["steps"]
    );
}

#[test]
fn every_file_of_queries_is_built_in_and_documented() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../queries");
    let mut files: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    let mut built_in: Vec<String> = named::ALL
        .iter()
        .map(|query| format!("{}.sql", query.name))
        .collect();
    // the folder of the failure rules
    files.retain(|name| name != "taxonomy");
    files.sort();
    built_in.sort();
    assert_eq!(files, built_in);
    for query in named::ALL {
        assert!(
            query
                .sql
                .starts_with(&format!("-- {}\n--\n-- ", query.name)),
            "{}: the header begins with its name",
            query.name
        );
        assert!(
            query.help().contains("\nColumns:\n")
                && query.help().contains("\nExample: reel query "),
            "{}",
            query.name
        );
        assert!(
            !query.summary().is_empty() && !query.summary().contains('\n'),
            "{}",
            query.summary()
        );
        assert_eq!(named::by_name(query.name), Some(query));
    }
}
