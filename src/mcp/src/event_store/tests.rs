//! Tests of the module above.

use serde_json::json;

use super::*;

/// An answer, or something said before one.
fn message(is_answer: bool) -> Arc<ServerJsonRpcMessage> {
    let message = match is_answer {
        true => json!({"jsonrpc": "2.0", "id": 1, "result": {}}),
        false => json!({"jsonrpc": "2.0", "method": "notifications/tools/list_changed"}),
    };
    Arc::new(serde_json::from_value(message).unwrap())
}

/// The same, of so many bytes.
fn of(is_answer: bool, bytes: usize) -> Option<(Arc<ServerJsonRpcMessage>, usize)> {
    Some((message(is_answer), bytes))
}

/// Ids of the events after one of them, as far as they are kept.
fn after(logs: &Logs, session: u64, id: &str) -> Vec<String> {
    let mut after: EventId = id.parse().unwrap();
    let mut ids = Vec::new();
    while let Next::Event(index, event) = logs.next(session, after) {
        ids.push(event.event_id.unwrap());
        after.index = index;
    }
    ids
}

/// That the counts are those of what is there.
fn check(logs: &Logs) {
    let mut kept = EventStoreUsage::default();
    for log in logs.sessions.values() {
        assert!(
            log.kept().fits(OF_SESSION) && log.streams.len() <= STREAMS,
            "{:?}",
            log.kept()
        );
        assert!(
            log.streams
                .values()
                .all(|stream| stream.kept().fits(OF_STREAM))
        );
        log.streams
            .values()
            .flat_map(|stream| &stream.events)
            .for_each(|event| kept.add(event));
    }
    assert_eq!(kept, logs.kept);
    assert!(kept.fits(OF_ALL), "{kept:?}");
}

#[test]
fn ids() {
    for (text, stream, index) in [("0", 0, 0), ("7", 0, 7), ("7/3", 3, 7)] {
        let id = EventId { stream, index };
        assert_eq!((text.parse(), id.to_string().as_str()), (Ok(id), text));
    }
    for text in [
        "",
        "/",
        "7/",
        "/3",
        "7/3/1",
        "-1",
        "7 ",
        "x",
        "18446744073709551616",
        "\u{667}",
    ] {
        assert_eq!(text.parse::<EventId>(), Err(()), "{text}");
    }
}

#[test]
fn an_answer_that_nobody_took_outlives_requests_and_one_that_was_taken_does_not() {
    let (mut logs, now) = (Logs::default(), Instant::now());
    let (session, other) = (logs.open(), logs.open());
    let primed = logs.store(session, "a", None, now);
    assert_eq!(primed.to_string(), "1/1");
    assert_eq!(logs.kept, EventStoreUsage::default());
    logs.store(session, "a", of(false, 9), now);
    let answer = logs.store(session, "a", of(true, 9), now);
    assert_eq!(after(&logs, session, "1/1"), ["2/1", "3/1"]);
    assert_eq!(after(&logs, session, "2/1"), ["3/1"]);
    assert!(matches!(logs.next(session, answer), Next::End));
    assert!(
        matches!(logs.next(other, primed), Next::End),
        "another session's"
    );
    logs.begin_request(session);
    assert_eq!(after(&logs, session, "1/1"), ["2/1", "3/1"]);
    // Also while another request is under way, whose stream goes on.
    let second = logs.store(session, "b", None, now);
    assert!(matches!(logs.next(session, second), Next::Wait));
    logs.take(session, answer, now);
    assert_eq!(
        after(&logs, session, "1/1"),
        ["2/1", "3/1"],
        "it may have been lost on the way"
    );
    logs.begin_request(session);
    assert!(matches!(logs.next(session, primed), Next::End));
    assert!(matches!(logs.next(session, second), Next::Wait));
    assert_eq!(logs.kept, EventStoreUsage::default());
    logs.close(session);
    logs.store(session, "b", of(true, 9), now);
    assert!(matches!(logs.next(session, second), Next::End));
    check(&logs);
}

#[test]
fn nothing_is_kept_for_long() {
    let (mut logs, begun) = (Logs::default(), Instant::now());
    let session = logs.open();
    let taken = logs.store(session, "a", of(true, 9), begun);
    let untaken = logs.store(session, "b", of(true, 9), begun);
    let standalone = logs.store(session, "x:common", of(false, 9), begun);
    logs.take(session, taken, begun);
    logs.take(session, standalone, begun);
    logs.take(
        session,
        EventId {
            stream: 9,
            index: 1,
        },
        begun,
    );
    logs.take(
        session,
        EventId {
            index: 2,
            ..untaken
        },
        begun,
    );
    assert_eq!(logs.kept.events, 3);
    logs.expire(begun + TAKEN_FOR - Duration::from_millis(1));
    assert_eq!(logs.kept.events, 3);
    logs.expire(begun + TAKEN_FOR);
    assert_eq!(
        (after(&logs, session, "0/2"), logs.kept.events),
        (vec!["1/2".to_owned()], 1)
    );
    logs.expire(begun + UNTAKEN_FOR);
    assert_eq!(
        (logs.kept, logs.sessions[&session].streams.len()),
        (EventStoreUsage::default(), 1)
    );
    check(&logs);
    // The standalone stream goes on where it was.
    assert_eq!(
        logs.store(session, "x:common", None, begun).to_string(),
        "2"
    );
}

#[test]
fn a_stream_and_a_session_have_bounds() {
    let (mut logs, now) = (Logs::default(), Instant::now());
    let session = logs.open();
    for _ in 0..20 {
        logs.store(session, "a", of(false, 9), now);
    }
    assert_eq!(
        after(&logs, session, "1/1").len(),
        OF_STREAM.events,
        "the last ones"
    );
    assert_eq!(after(&logs, session, "19/1"), ["20/1"]);
    // Requests that are never answered, and answers that are never taken.
    for number in 0..100 {
        logs.store(session, &format!("open {number}"), None, now);
        logs.store(
            session,
            &format!("answered {number}"),
            of(true, 100_000),
            now,
        );
        check(&logs);
    }
    let kept = logs.sessions[&session].kept();
    assert_eq!(after(&logs, session, "0/201"), ["1/201"], "{kept:?}");
    // An answer larger than a session may have is nowhere, and disturbs
    // nothing that comes later.
    logs.store(session, "large", of(true, OF_SESSION.bytes), now);
    logs.store(session, "small", of(true, 9), now);
    assert_eq!(
        (
            after(&logs, session, "0/202"),
            after(&logs, session, "0/203")
        ),
        (vec![], vec!["1/203".to_owned()])
    );
    check(&logs);
}

#[test]
fn all_sessions_together_have_a_bound() {
    let (mut logs, now) = (Logs::default(), Instant::now());
    let sessions: Vec<u64> = (0..1_000).map(|_| logs.open()).collect();
    for session in &sessions {
        logs.store(*session, "a", of(true, 130_000), now);
    }
    check(&logs);
    let room = OF_ALL.bytes / 130_000;
    assert_eq!(logs.kept.events, room);
    let holds = |session: &u64| logs.sessions[session].kept().events;
    assert!(
        sessions[1_000 - room..]
            .iter()
            .all(|session| holds(session) == 1),
        "the last ones"
    );
    assert!(
        sessions[..1_000 - room]
            .iter()
            .all(|session| holds(session) == 0)
    );
    sessions.iter().for_each(|session| logs.close(*session));
    assert_eq!(
        (logs.kept, logs.sessions.len()),
        (EventStoreUsage::default(), 0)
    );
}

#[tokio::test]
async fn a_replay_goes_on_until_the_answer_or_the_end_of_the_session() {
    use futures_util::StreamExt as _;

    let events = Events::default();
    let session = events.open();
    let say = async |name: &str, message| {
        let event = ServerSseMessage::from_message(Arc::unwrap_or_clone(message));
        session.store_event(name, &event).await.unwrap()
    };
    let primed = session
        .store_event("a", &ServerSseMessage::retry(Duration::from_secs(3)))
        .await
        .unwrap();
    let replay = session.replay_events_after(&primed).await.unwrap();
    let replay = tokio::spawn(
        replay
            .map(|event| event.event_id.unwrap())
            .collect::<Vec<_>>(),
    );
    tokio::task::yield_now().await;
    say("a", message(false)).await;
    tokio::task::yield_now().await;
    say("b", message(true)).await;
    say("a", message(true)).await;
    assert_eq!(replay.await.unwrap(), ["2/1", "3/1"]);
    let mut standalone = session.replay_events_after("0").await.unwrap();
    say("x:common", message(false)).await;
    assert_eq!(
        standalone.next().await.unwrap().event_id.as_deref(),
        Some("1")
    );
    let ended = tokio::spawn(async move { standalone.next().await.is_none() });
    tokio::task::yield_now().await;
    session.close();
    assert!(ended.await.unwrap());
    for id in ["0", "2/1", "1/9", "x"] {
        assert!(session.replay_events_after(id).await.is_err(), "{id}");
    }
    assert_eq!(events.usage(), EventStoreUsage::default());
}

#[test]
fn bytes_are_those_of_the_json() {
    assert_eq!(
        json_bytes(&message(true)),
        r#"{"jsonrpc":"2.0","id":1,"result":{}}"#.len()
    );
}
