//! The SQL functions of our own: their examples, what they say of known episodes, and that a query
//! reads no more of the steps than it names.

use std::{collections::BTreeSet, time::Duration};

use reel_query::{CacheScope, Parameters, QueryError, QuerySession, StopReason, functions};
use reel_tables::Store;
use reel_vectors::golden_traces;
use reel_world::{
    Family, TokenLogprobs,
    record::{EndReason, PolicyOutput},
};
use tempfile::TempDir;

use crate::{
    ask,
    play::{DISTRACTOR, Play, TARGET, success},
    store,
};

fn plays() -> Vec<Play> {
    let new = |policy: &str, family| Play::new(policy, family, 1);
    vec![
        success("oracle", Family::SUL, 1),
        new("hasty", Family::SUL)
            .nav("table_1")
            .find("alarm clock")
            .pick(DISTRACTOR)
            .nav("desk_1")
            .place("desk_1")
            .finish(),
        new("lost", Family::FDP)
            .nav("desk_1")
            .nav("desk_2")
            .nav("desk_1")
            .nav("desk_2")
            .nav("desk_1")
            .ended(EndReason::Horizon),
        new("idle", Family::FDP).finish(),
    ]
}

#[test]
fn an_answer_holds_as_long_as_what_it_was_asked_of() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays())).unwrap();
    let lasting = |sql: &str| session.run_each(sql, &Parameters::new(), |_| true).unwrap();
    for sql in [
        "SELECT policy, count(*), wilson_low(count(*), 10) FROM episodes GROUP BY policy",
        "SELECT sum(n) FROM (SELECT sequence_count(steps, 'nav_to') AS n FROM episodes)",
        "SELECT episode_id FROM episodes WHERE policy IN (SELECT policy FROM steps WHERE upper(tool) = 'PICK')",
    ] {
        assert_eq!(lasting(sql), CacheScope::StoreVersion, "{sql}");
    }
    for sql in [
        "SELECT now()",
        "SELECT random() FROM episodes",
        "SELECT policy FROM episodes WHERE replay(trace)['verdict'] = 'exact'",
        "SELECT policy FROM episodes WHERE success IN (SELECT random() > 0.5 FROM steps)",
    ] {
        assert_eq!(lasting(sql), CacheScope::Uncacheable, "{sql}");
    }
    let stopped = session
        .run_each("SELECT policy FROM episodes", &Parameters::new(), |_| false)
        .unwrap();
    assert_eq!(stopped, CacheScope::Uncacheable);
}

#[test]
fn every_function_has_an_example_that_runs() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays())).unwrap();
    for function in functions() {
        let rows = session.run(function.example);
        // hand-made episodes cannot be drawn: that alone may fail, and says so
        match rows {
            Err(QueryError::Engine(error)) if function.call.starts_with("frame") => {
                assert!(error.to_string().contains("frame"), "{error}");
            }
            rows => assert!(!rows.expect(function.call).is_empty()),
        }
        let name = function.call.split('(').next().unwrap();
        assert!(
            function.example.contains(name),
            "the example of {name} shows it"
        );
    }
}

#[test]
fn patterns_find_what_they_say() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays())).unwrap();
    let by_policy = |what: &str| {
        ask(
            &session,
            &format!("SELECT policy, {what} FROM episodes ORDER BY policy"),
        )
    };
    assert_eq!(
        by_policy("sequence_match(steps, '^ !ask* pick')"),
        ["hasty,true", "idle,false", "lost,false", "oracle,false"]
    );
    assert_eq!(
        by_policy("sequence_count(steps, 'nav_to')"),
        ["hasty,2", "idle,0", "lost,5", "oracle,2"]
    );
    assert_eq!(
        by_policy("sequence_find(steps, 'pick .. place').first"),
        ["hasty,2", "idle,", "lost,", "oracle,3"]
    );
    assert_eq!(
        by_policy("sequence_find(steps, 'pick .. place').last"),
        ["hasty,4", "idle,", "lost,", "oracle,5"]
    );
    assert_eq!(
        by_policy("first_step(steps, 'pick[not goal_object]')"),
        ["hasty,2", "idle,", "lost,", "oracle,"]
    );
    assert_eq!(
        by_policy(&format!("first_step(steps, 'pick[object = \"{TARGET}\"]')")),
        ["hasty,", "idle,", "lost,", "oracle,3"]
    );
    assert_eq!(
        by_policy("first_step(steps, 'ask[reply is not null]')"),
        ["hasty,", "idle,", "lost,", "oracle,2"]
    );
    let swing = "oscillation(steps).length, oscillation(steps).one, oscillation(steps).other";
    assert_eq!(
        by_policy(swing),
        ["hasty,,,", "idle,,,", "lost,5,desk_1,desk_2", "oracle,,,"]
    );
    let back = "sequence_match(steps, 'nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,}')";
    assert_eq!(
        by_policy(back),
        ["hasty,false", "idle,false", "lost,true", "oracle,false"]
    );
    let rows = ask(
        &session,
        "SELECT array_to_string(step_texts(steps, 'tool'), '>') FROM episodes WHERE policy = 'idle'",
    );
    assert_eq!(rows, ["finish"]);
    let equal = "SELECT count(*) FROM episodes e JOIN (SELECT episode_id, sum(reward) AS r FROM steps GROUP BY episode_id) s \
                 ON s.episode_id = e.episode_id WHERE abs(discounted(step_values(e.steps, 'reward'), 1.0) - s.r) < 1e-12";
    assert_eq!(ask(&session, equal), ["4"]);
}

#[test]
fn a_wrong_pattern_says_where_it_is_wrong() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays()[..1])).unwrap();
    for (sql, says) in [
        (
            "SELECT sequence_match(steps, 'nav_tu') FROM episodes",
            "did you mean `nav_to`",
        ),
        (
            "SELECT sequence_match(steps, 'pick[colour = 3]') FROM episodes",
            "no column `colour`",
        ),
        (
            "SELECT sequence_match(steps, 'pick[reward = \"a\"]') FROM episodes",
            "reward",
        ),
        (
            "SELECT sequence_match(policy, 'pick') FROM episodes",
            "takes the steps of an episode first",
        ),
        (
            "SELECT step_values(steps, 'tool') FROM episodes",
            "holds text",
        ),
        (
            "SELECT step_texts(steps, 'tol') FROM episodes",
            "no column 'tol'",
        ),
        (
            "SELECT paired_bootstrap([1.0], [1.0, 2.0], 10, 1)",
            "needs pairs",
        ),
        (
            "SELECT reward(trace, 'mine') FROM episodes",
            "no preset is called 'mine'",
        ),
        ("SELECT replay('/etc/passwd')", "no trace '/etc/passwd'"),
        ("SELECT frame('/etc/passwd', 0)", "no trace '/etc/passwd'"),
    ] {
        let error = session.run(sql).expect_err(sql).to_string();
        assert!(error.contains(says), "{sql}: {error}");
    }
}

#[test]
fn a_query_reads_only_the_fields_of_the_steps_that_it_names() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays())).unwrap();
    let reads = |sql: &str| {
        session
            .step_fields(sql)
            .expect(sql)
            .map(|fields| fields.into_iter().collect::<Vec<_>>())
    };
    let some = |fields: &[&str]| {
        Some(
            fields
                .iter()
                .map(|field| (*field).to_owned())
                .collect::<Vec<_>>(),
        )
    };
    assert_eq!(reads("SELECT policy FROM episodes"), some(&[]));
    assert_eq!(reads("SELECT array_length(steps) FROM episodes"), some(&[]));
    assert_eq!(
        reads("SELECT sequence_match(steps, 'pick[goal_object]') FROM episodes"),
        some(&["goal_object", "tool"])
    );
    assert_eq!(
        reads("SELECT count(*) FROM episodes WHERE oscillation(steps).length > 3"),
        some(&["argument", "tool"])
    );
    assert_eq!(
        reads("SELECT tool, count(*) FROM steps GROUP BY tool"),
        some(&["tool"])
    );
    assert_eq!(
        reads("SELECT event, count(*) FROM world_diffs GROUP BY event"),
        some(&["changes"])
    );
    assert_eq!(
        reads("SELECT e.policy FROM episodes e JOIN steps s ON s.episode_id = e.episode_id"),
        some(&[])
    );
    assert_eq!(
        reads("SELECT steps[1]['tool'] FROM episodes"),
        some(&["tool"])
    );
    for all in [
        "SELECT * FROM episodes",
        "SELECT steps FROM episodes",
        "SELECT steps[1] FROM episodes",
        "SELECT DISTINCT steps FROM episodes",
        "SELECT count(DISTINCT steps) FROM episodes",
        "SELECT count(*) FROM (SELECT DISTINCT steps FROM episodes)",
        "SELECT count(*) FROM episodes a JOIN episodes b ON a.steps = b.steps",
        "SELECT policy FROM episodes ORDER BY steps",
        "SELECT count(*) FROM (SELECT steps[1] AS s, count(*) FROM episodes GROUP BY 1)",
        "SELECT count(*) FROM (SELECT array_slice(steps, 1, 2) AS s, count(*) FROM episodes GROUP BY 1)",
        "SELECT sum(c) FROM (SELECT row_number() OVER (PARTITION BY steps[1] ORDER BY episode_id) AS c FROM episodes)",
        "SELECT count(*) FROM episodes a JOIN episodes b ON array_slice(a.steps, 1, 1) = array_slice(b.steps, 1, 1)",
    ] {
        assert_eq!(reads(all), None, "{all}");
    }
    // narrow and wide give the same
    let narrow = "SELECT policy, first_step(steps, 'pick') AS f FROM episodes ORDER BY policy";
    let wide = "SELECT policy, f FROM (SELECT policy, first_step(steps, 'pick') AS f, steps FROM episodes) ORDER BY policy, steps";
    assert_eq!(ask(&session, narrow), ask(&session, wide));
}

#[test]
fn the_simulator_answers_in_sql() {
    let mut traces = golden_traces();
    traces.truncate(6);
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&traces, &|_, _| ()).unwrap();
    let session = QuerySession::new(store).unwrap();
    let rows = ask(
        &session,
        "SELECT count(*) FROM episodes WHERE replay(trace).verdict = 'exact'",
    );
    assert_eq!(rows, [traces.len().to_string()]);
    assert_eq!(session.control().simulated(), traces.len() as u64);
    let rows = ask(
        &session,
        "SELECT count(*) FROM episodes WHERE replay(trace).digest = trace_digest",
    );
    assert_eq!(rows, [traces.len().to_string()]);
    let rows = ask(
        &session,
        "SELECT count(*) FROM episodes WHERE reward(trace, preset).total_reward = total_reward",
    );
    assert_eq!(
        rows,
        [traces.len().to_string()],
        "scored again under its own preset"
    );
    let rows = session
        .run("SELECT frame(trace, -1) AS start, frame(trace, 0) AS first FROM episodes LIMIT 1")
        .unwrap();
    for column in rows[0].columns() {
        let image = arrow::array::AsArray::as_binary::<i32>(column.as_ref()).value(0);
        assert_eq!(
            &image[..8],
            b"\x89PNG\r\n\x1a\n",
            "lean traces are drawn again"
        );
    }
    for function in functions() {
        assert!(
            session.run(function.example).is_ok(),
            "{}: {:?}",
            function.call,
            session.run(function.example).err()
        );
    }
    assert_eq!(
        ask(
            &session,
            "SELECT count(*) FROM episodes WHERE REPLAY(trace).verdict = 'exact'"
        ),
        ["6"]
    );
    assert!(
        session
            .run("EXPLAIN SELECT replay(trace).verdict, steps[1].tool FROM episodes")
            .is_ok()
    );
    session
        .run("SELECT a.steps[1].tool AS one, a.steps[1]['tool'] AS other FROM episodes a")
        .unwrap();
    session
        .run("SELECT s.changes[1].event, s.tool FROM (SELECT unnest(steps) AS s FROM episodes)")
        .unwrap();
    let error = session
        .run("SELECT frame(trace, 999) FROM episodes")
        .unwrap_err()
        .to_string();
    assert!(error.contains("unknown call 999"), "{error}");
}

#[test]
fn a_running_query_can_be_stopped() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays())).unwrap();
    let control = session.control();
    let stopper = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(300));
        control.cancel();
    });
    let endless =
        "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT count(*) FROM r";
    let stopped = session.run(endless);
    assert!(
        matches!(stopped, Err(QueryError::Stopped(StopReason::Cancelled))),
        "{stopped:?}"
    );
    stopper.join().unwrap();
    let functions: BTreeSet<&str> = functions().map(|function| function.call).collect();
    assert!(functions.len() > 10);
}

#[test]
fn log_probabilities_of_two_policies() {
    let dir = TempDir::new().unwrap();
    let words = |words: &[&str]| {
        words
            .iter()
            .map(|word| (*word).to_owned())
            .collect::<Vec<_>>()
    };
    let mut pick = TokenLogprobs::sampled(words(&["pick", " 1"]), vec![-1.0, -0.5]).unwrap();
    pick.add("new", vec![-0.5, -0.5], None).unwrap();
    let finish = TokenLogprobs::sampled(words(&["finish"]), vec![-2.0]).unwrap();
    let said = |logprobs| PolicyOutput {
        logprobs: Some(logprobs),
        ..PolicyOutput::default()
    };
    let play = Play::new("model", Family::SUL, 1)
        .nav("table_1")
        .find("alarm clock")
        .thinking(said(pick));
    let session = QuerySession::new(store(
        dir.path(),
        &[play.pick(DISTRACTOR).thinking(said(finish)).finish()],
    ))
    .unwrap();
    let rows = ask(
        &session,
        "SELECT step, policy, array_to_string(tokens, '|') AS t, logprobs[1] AS l FROM logprobs ORDER BY step, policy",
    );
    assert_eq!(rows.len(), 3, "{rows:?}");
    assert!(
        rows[0].contains("new,pick| 1,-0.5")
            && rows[1].contains("old,pick| 1,-1.0")
            && rows[2].contains("old,finish,-2.0"),
        "{rows:?}"
    );
    let ratio = "SELECT sequence_ratio(n.logprobs, o.logprobs) > 1.28 AS r FROM logprobs n JOIN logprobs o \
                 ON o.step = n.step AND o.policy = 'old' WHERE n.policy = 'new'";
    assert_eq!(ask(&session, ratio), ["true"]);
    assert_eq!(
        ask(&session, "SELECT sequence_ratio(NULL, [-1.0]) IS NULL AS n"),
        ["true"]
    );
    assert_eq!(
        ask(
            &session,
            "SELECT estimated_advantages([[1.0, 3.0]], 'rloo', 'none')[1][2] AS a"
        ),
        ["2.0"]
    );
    assert_eq!(
        ask(
            &session,
            "SELECT clip_share([0.5, 1.5], [-1.0, 1.0], 0.2, 0.6).low AS a"
        ),
        ["0.5"]
    );
    for (sql, words) in [
        (
            "SELECT sequence_ratio([-1.0], [-1.0, -2.0])",
            "1 values on one side and 2",
        ),
        (
            "SELECT token_ratios([-1.0, NULL], [-1.0, -2.0])",
            "holds null",
        ),
        ("SELECT kl([-1.0], [-1.0], 'k4')", "there are k1, k2, k3"),
        ("SELECT clip_share([1.0], [1.0], -0.2, 0.2)", "clip radius"),
        (
            "SELECT gspo([1.0], [1.0, 2.0], [0.0], 0.2, 0.2, 0.0)",
            "values on one side",
        ),
        (
            "SELECT estimated_advantages([[1.0]], 'grpo', 'group')",
            "one rollout",
        ),
        (
            "SELECT estimated_advantages([[1.0]], 'best', 'group')",
            "no estimator is called 'best'",
        ),
    ] {
        let error = session.run(sql).unwrap_err().to_string();
        assert!(error.contains(words), "{sql}: {error}");
    }
}

/// The engine would compute a key when it sorts a batch, and again for each merge.
#[test]
fn a_key_of_a_sort_is_computed_once() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &plays())).unwrap();
    let plans = ask(
        &session,
        "EXPLAIN SELECT trace FROM episodes ORDER BY md5(trace)",
    )
    .join("\n");
    let physical = plans.split("physical_plan").nth(1).unwrap();
    let sorts: Vec<_> = physical.match_indices("SortExec: expr=[").collect();
    assert!(!sorts.is_empty(), "{physical}");
    for (at, _) in sorts {
        let sort = physical[at..].lines().next().unwrap();
        assert!(!sort.contains("md5("), "{physical}");
    }
    for (computed, named) in [
        (
            "SELECT trace FROM episodes ORDER BY md5(trace) DESC, trace",
            "SELECT trace FROM (SELECT trace, md5(trace) AS key FROM episodes) ORDER BY key DESC",
        ),
        (
            "SELECT tool FROM steps GROUP BY tool ORDER BY -count(*), tool LIMIT 3",
            "SELECT tool FROM (SELECT tool, -count(*) AS key FROM steps GROUP BY tool) ORDER BY key, tool LIMIT 3",
        ),
        (
            "SELECT DISTINCT tool FROM steps ORDER BY tool || 'a' NULLS FIRST",
            "SELECT DISTINCT tool FROM steps ORDER BY tool NULLS FIRST",
        ),
        (
            "SELECT a.step, b.step FROM steps a JOIN steps b USING (episode_id) ORDER BY a.step - b.step, a.episode_id, a.step LIMIT 9",
            "SELECT one, two FROM (SELECT a.episode_id, a.step AS one, b.step AS two, a.step - b.step AS key FROM steps a JOIN steps b USING (episode_id)) ORDER BY key, episode_id, one LIMIT 9",
        ),
        (
            "SELECT trace AS __sort_key_0 FROM episodes ORDER BY md5(__sort_key_0)",
            "SELECT trace FROM (SELECT trace, md5(trace) AS key FROM episodes) ORDER BY key",
        ),
        (
            "SELECT episode_id, step FROM steps ORDER BY row_number() OVER (ORDER BY -step, episode_id) + 1 LIMIT 5",
            "SELECT episode_id, step FROM steps ORDER BY step DESC, episode_id LIMIT 5",
        ),
        (
            "SELECT (SELECT tool FROM steps ORDER BY step * -1, episode_id LIMIT 1)",
            "SELECT tool FROM steps ORDER BY step DESC, episode_id LIMIT 1",
        ),
    ] {
        assert_eq!(ask(&session, computed), ask(&session, named), "{computed}");
    }
    assert_eq!(
        session
            .run("SELECT * FROM episodes ORDER BY md5(trace)")
            .unwrap()[0]
            .schema(),
        session.run("SELECT * FROM episodes").unwrap()[0].schema()
    );
}
