//! Stars, tags and comments on episodes, by the command and by the service.

use serde_json::{Value, json};

use crate::{complaint, expect, failed_episode, server::Server};

fn remarks(told: &Value) -> Vec<(String, String, Option<i64>)> {
    let text = |one: &Value, field: &str| one[field].as_str().unwrap().to_owned();
    let remark = |one: &Value| (text(one, "kind"), text(one, "text"), one["step"].as_i64());
    told.as_array().unwrap().iter().map(remark).collect()
}

#[test]
fn remarks_are_kept_once_and_taken_back() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(folder, "ingest traces --store data/store");
    let listed = reel!(
        folder,
        "query --store data/store --format csv | SELECT episode_id FROM episodes"
    );
    let episode = listed.lines().nth(1).unwrap().to_owned();
    for _ in 0..2 {
        reel!(
            folder,
            "store remark star {episode} --author ann --store data/store"
        );
        reel!(
            folder,
            "store remark tag {episode} --text talk --author ann --store data/store"
        );
    }
    let server = Server::start(folder);
    let path = format!("remarks?episode={episode}");
    let told = server.get(&path);
    let star = ("star".to_owned(), String::new(), None);
    let tag = ("tag".to_owned(), "talk".to_owned(), None);
    assert_eq!(remarks(&told), [star.clone(), tag.clone()]);
    assert_eq!(told[0]["author"], "ann");
    let comment = json!({"episode": episode[..8], "kind": "comment", "text": "Why this one?", "step": 1, "author": "bo"});
    let (status, kept) = server.send("POST", "remarks", Some(&comment));
    assert_eq!((status, &kept["author"]), (201, &json!("bo")), "{kept}");
    let said = ("comment".to_owned(), "Why this one?".to_owned(), Some(1));
    assert_eq!(
        remarks(&server.get(&path)),
        [star.clone(), tag.clone(), said]
    );
    assert!(reel!(folder, "store remark list --store data/store").contains("Why this one? at 1"));
    // Somebody else's, and what was never said, is not taken back.
    for query in [
        "author=ann&kind=comment&text=Why+this+one%3F&step=1",
        "author=bo&kind=star",
    ] {
        let (status, answer) = server.send("DELETE", &format!("remarks/{episode}?{query}"), None);
        assert_eq!(
            (status, &answer["error"]["code"]),
            (422, &json!("bad_remark")),
            "{answer}"
        );
    }
    let query = "author=bo&kind=comment&text=Why+this+one%3F&step=1";
    let (status, _) = server.send("DELETE", &format!("remarks/{episode}?{query}"), None);
    assert_eq!(status, 204);
    assert_eq!(remarks(&server.get(&path)), [star, tag]);
}

#[test]
fn what_is_no_remark_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(folder, "ingest traces --store data/store");
    let server = Server::start(folder);
    let refused = [
        json!({"kind": "tag", "text": "one, two"}),
        json!({"kind": "tag", "text": " "}),
        json!({"kind": "tag", "text": "none"}),
        json!({"kind": "tag"}),
        json!({"kind": "tag", "text": "x".repeat(61)}),
        json!({"kind": "comment", "text": "x".repeat(4001)}),
        json!({"kind": "comment", "text": "there is no such step", "step": 999}),
        json!({"kind": "comment", "text": "there is no such step", "step": -1}),
        json!({"kind": "star", "text": "words"}),
        json!({"kind": "star", "step": 1}),
        json!({"kind": "star", "author": " "}),
        json!({"kind": "star", "episode": "nobody"}),
    ];
    for mut remark in refused {
        for (field, value) in [("author", json!("ann")), ("episode", json!(""))] {
            if remark.get(field).is_none() {
                remark[field] = value;
            }
        }
        let (status, answer) = server.send("POST", "remarks", Some(&remark));
        assert_eq!(status, 422, "{remark}: {answer}");
    }
    assert_eq!(server.get("remarks"), json!([]));
    let said = complaint(folder, 2, "store remark star e --store data/store");
    assert!(said.contains("--author"), "{said}");
}

/// With tokens the author is whose token it is, whatever the request says; nobody takes back
/// another's remark, and who may only read remarks nothing.
#[test]
fn a_token_speaks_for_its_owner_alone() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(folder, "ingest traces --store data/store");
    let token = |name: &str, role: &str| {
        let said = expect(
            folder,
            0,
            &format!("server token create {name} --role {role} --data data --json"),
        );
        let said: Value = serde_json::from_str(&said).unwrap();
        said["token"].as_str().unwrap().to_owned()
    };
    let (ann, bo, reader) = (
        token("ann", "admin"),
        token("bo", "admin"),
        token("eve", "read"),
    );
    let server = Server::start(folder);
    let (_, episodes) = server.send_as(&ann, "GET", "episodes", None);
    let episode = episodes["episodes"][0]["episode_id"]
        .as_str()
        .unwrap()
        .to_owned();
    let star = json!({"episode": episode, "kind": "star", "author": "bo"});
    let (status, kept) = server.send_as(&ann, "POST", "remarks", Some(&star));
    assert_eq!((status, &kept["author"]), (201, &json!("ann")), "{kept}");
    let path = format!("remarks/{episode}?kind=star&author=ann");
    assert_eq!(server.send_as(&bo, "DELETE", &path, None).0, 422);
    for token in [&reader, ""] {
        let status = if token.is_empty() { 401 } else { 403 };
        assert_eq!(
            server.send_as(token, "POST", "remarks", Some(&star)).0,
            status
        );
        assert_eq!(server.send_as(token, "DELETE", &path, None).0, status);
    }
    let (_, remarks) = server.send_as(&reader, "GET", "remarks", None);
    assert_eq!(remarks[0]["author"], "ann");
    assert_eq!(server.send_as(&ann, "DELETE", &path, None).0, 204);
}
