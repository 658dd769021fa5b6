//! Datasets published to a Hub on this machine.

use std::{collections::BTreeMap, ffi::OsString, fs, path::Path, time::Duration};

use reel_publish::{
    CommitOptions, FileStatus, Hub, MAIN, Plan, PublishError, PublishedCommit, RepositoryId,
};
use reel_vectors::hub::{StubHub, TOKEN};

use crate::sample::{export, files, list, open};

fn client(stub: &StubHub, token: &str) -> Hub {
    let read = |name: &str| match name {
        "HF_ENDPOINT" => Some(OsString::from(stub.address())),
        "HF_TOKEN" if !token.is_empty() => Some(OsString::from(token)),
        _ => None,
    };
    // nobody waits between two tries
    Hub::from_environment(&read, Box::new(|_: Duration| ())).unwrap()
}

fn id() -> RepositoryId {
    RepositoryId::parse("tester/household").unwrap()
}

fn options() -> CommitOptions {
    CommitOptions {
        branch: MAIN.to_owned(),
        message: "Publish".to_owned(),
        create_pr: false,
        delete: false,
    }
}

/// Publishes as the command does: looks, makes what is missing, sends.
fn publish(
    stub: &StubHub,
    source: &Path,
    options: &CommitOptions,
) -> Result<(Plan, PublishedCommit), PublishError> {
    let hub = client(stub, TOKEN);
    if hub.repository(&id())?.is_none() {
        hub.create(&id(), true)?;
    }
    let mut tree = hub.tree(&id(), &options.branch)?;
    if tree.commit.is_none() {
        hub.create_branch(&id(), &options.branch)?;
        tree = hub.tree(&id(), &options.branch)?;
    }
    let publication = open(source);
    let plan = Plan::new(publication.files(), &tree.files);
    let done = hub.publish(&id(), &publication, (&plan, &tree), options, &|_| ())?;
    Ok((plan, done))
}

fn sample() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    export(folder.path());
    folder
}

/// What has to be on the Hub: the folder, and what publishing adds.
fn expected(source: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut expected = files(source);
    let publication = open(source);
    let target = tempfile::tempdir().unwrap();
    let place = target.path().join("published");
    let plan = Plan::new(publication.files(), &BTreeMap::new());
    reel_publish::publish_to_folder(&publication, &plan, &place, false, |_| ()).unwrap();
    for name in [".gitattributes", "SHA256SUMS"] {
        expected.insert(name.to_owned(), fs::read(place.join(name)).unwrap());
    }
    expected
}

#[test]
fn a_repository_gets_the_files_of_the_plan_and_nothing_twice() {
    let (stub, source) = (StubHub::start(), sample());
    let (plan, done) = publish(&stub, source.path(), &options()).unwrap();
    assert_eq!(plan.count(FileStatus::New), plan.files.len() - 1);
    assert_eq!(
        plan.count(FileStatus::Changed),
        1,
        "the Hub's own .gitattributes"
    );
    assert_eq!((done.commits, done.url.is_some()), (1, true));
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
    assert!(stub.state().repositories["tester/household"].private);
    let main = stub.state().repositories["tester/household"].branches[MAIN].clone();
    assert_eq!(
        (main.message.as_str(), Some(main.commit)),
        ("Publish", done.commit)
    );
    let large = main.files.values().filter(|(_, is_large)| *is_large);
    assert_eq!(large.count(), 2);
    assert_eq!(stub.take_requests("PUT").len(), 2);

    let (plan, done) = publish(&stub, source.path(), &options()).unwrap();
    assert!(plan.is_done(true));
    assert_eq!(done, PublishedCommit::default());
    let requests = stub.take_requests("");
    assert!(
        requests.iter().all(|request| request.starts_with("GET ")),
        "{requests:?}"
    );

    fs::write(source.path().join("train/train-00000.jsonl"), "").unwrap();
    export(source.path());
    fs::write(source.path().join("images/b.png"), [7; 3000]).unwrap();
    list(source.path());
    let (plan, _) = publish(&stub, source.path(), &options()).unwrap();
    let written: Vec<&str> = plan.to_write().map(|file| file.path.as_str()).collect();
    assert_eq!(written, ["images/b.png", "manifest.json", "SHA256SUMS"]);
    assert_eq!(stub.take_requests("PUT").len(), 1);
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
}

#[test]
fn large_files_go_in_parts() {
    let (stub, source) = (StubHub::start(), sample());
    stub.state().part_bytes = 999;
    publish(&stub, source.path(), &options()).unwrap();
    // 5000 bytes of the image, and the rows in one piece
    assert_eq!(stub.take_requests("PUT").len(), 6 + 1);
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
}

#[test]
fn a_broken_upload_is_gone_on_with() {
    let (stub, source) = (StubHub::start(), sample());
    for number in 0..9 {
        let bytes = vec![number; 2000 + usize::from(number)];
        fs::write(source.path().join(format!("images/{number}.png")), bytes).unwrap();
    }
    list(source.path());
    // the storage takes some files, refuses one, and the command ends
    let some = client(&stub, TOKEN);
    some.create(&id(), false).unwrap();
    let digest = open(source.path()).files()["images/5.png"].sha256.clone();
    stub.state().faults.push((digest.clone(), 403, 1));
    let error = publish(&stub, source.path(), &options()).unwrap_err();
    assert!(
        matches!(error, PublishError::Status { status: 403, .. }),
        "{error}"
    );
    assert!(!error.to_string().contains("signature"), "{error}");
    assert_eq!(stub.files("tester/household", MAIN).len(), 1, "no commit");
    let arrived = stub.state().storage.len();
    assert!(arrived >= 1 && !stub.state().storage.contains_key(&digest));
    stub.take_requests("");
    publish(&stub, source.path(), &options()).unwrap();
    assert_eq!(stub.take_requests("PUT").len(), 11 - arrived);
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
}

#[test]
fn passing_faults_are_waited_out() {
    let (stub, source) = (StubHub::start(), sample());
    let faults = [
        ("PUT", 503, 3),
        ("whoami", 500, 1),
        ("preupload", 429, 4),
        ("tree", 502, 2),
    ];
    for (part, status, count) in faults {
        stub.state().faults.push((part.to_owned(), status, count));
    }
    assert_eq!(
        client(&stub, TOKEN).user().unwrap().as_deref(),
        Some("tester")
    );
    publish(&stub, source.path(), &options()).unwrap();
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
    // a commit is sent once
    stub.state().faults.push(("commit".to_owned(), 503, 1));
    fs::write(source.path().join("images/b.png"), [7; 30]).unwrap();
    list(source.path());
    let error = publish(&stub, source.path(), &options())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("503") && error.contains("run the command again"),
        "{error}"
    );
}

#[test]
fn many_files_come_in_several_commits_and_the_checksums_last() {
    let (stub, source) = (StubHub::start(), sample());
    for number in 0..300_u32 {
        let name = format!("images/{number:03}.png");
        fs::write(source.path().join(name), number.to_be_bytes()).unwrap();
    }
    list(source.path());
    let (plan, done) = publish(&stub, source.path(), &options()).unwrap();
    assert_eq!((plan.files.len(), done.commits), (306, 2));
    assert_eq!(plan.to_write().last().unwrap().path, "SHA256SUMS");
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
}

#[test]
fn branches_and_pull_requests_leave_the_main_branch_alone() {
    let (stub, source) = (StubHub::start(), sample());
    let branch = CommitOptions {
        branch: "v1/draft".to_owned(),
        ..options()
    };
    publish(&stub, source.path(), &branch).unwrap();
    assert_eq!(
        stub.files("tester/household", "v1/draft"),
        expected(source.path())
    );
    let proposed = CommitOptions {
        create_pr: true,
        ..options()
    };
    let (_, done) = publish(&stub, source.path(), &proposed).unwrap();
    assert!(done.url.unwrap().ends_with("/discussions/1"));
    assert_eq!(
        stub.files("tester/household", "refs/pr/1"),
        expected(source.path())
    );
    assert_eq!(stub.files("tester/household", MAIN).len(), 1);
}

#[test]
fn nothing_is_deleted_unless_asked() {
    let (stub, source) = (StubHub::start(), sample());
    publish(&stub, source.path(), &options()).unwrap();
    fs::rename(
        source.path().join("images/a.png"),
        source.path().join("images/b.png"),
    )
    .unwrap();
    list(source.path());
    let (plan, _) = publish(&stub, source.path(), &options()).unwrap();
    assert_eq!(plan.only_at_target, ["images/a.png"]);
    assert!(
        stub.files("tester/household", MAIN)
            .contains_key("images/a.png")
    );
    let delete = CommitOptions {
        delete: true,
        ..options()
    };
    let (plan, done) = publish(&stub, source.path(), &delete).unwrap();
    assert_eq!((plan.to_write().count(), done.commits), (0, 1));
    assert_eq!(
        stub.files("tester/household", MAIN),
        expected(source.path())
    );
}

#[test]
fn a_repository_that_changed_meanwhile_is_not_overwritten() {
    let (stub, source) = (StubHub::start(), sample());
    publish(&stub, source.path(), &options()).unwrap();
    let hub = client(&stub, TOKEN);
    let tree = hub.tree(&id(), MAIN).unwrap();
    fs::write(source.path().join("images/b.png"), [7; 30]).unwrap();
    list(source.path());
    publish(&stub, source.path(), &options()).unwrap();
    let publication = open(source.path());
    let plan = Plan::new(publication.files(), &tree.files);
    let error = hub
        .publish(&id(), &publication, (&plan, &tree), &options(), &|_| ())
        .unwrap_err();
    assert!(
        matches!(error, PublishError::Status { status: 412, .. }),
        "{error}"
    );
    assert!(
        error.to_string().contains("changed since it was compared"),
        "{error}"
    );
}

#[test]
fn errors_say_what_to_do() {
    let (stub, source) = (StubHub::start(), sample());
    let told = |hub: &Hub| hub.user().unwrap_err().to_string();
    let wrong = told(&client(&stub, "wrong-token"));
    assert!(
        wrong.contains("401") && wrong.contains("set HF_TOKEN to another"),
        "{wrong}"
    );
    assert!(!wrong.contains("wrong-token"), "{wrong}");
    let nobody = client(&stub, "");
    assert_eq!(nobody.user().unwrap(), None);
    let hidden = nobody.repository(&id()).unwrap_err().to_string();
    assert!(hidden.contains("hf auth login"), "{hidden}");
    for (status, words) in [
        (403, "--create-pr"),
        (404, "check the name"),
        (409, "run the command again"),
        (413, "fewer rows"),
        (500, "run the command again later"),
        (307, "another name"),
    ] {
        stub.state().faults = vec![("commit".to_owned(), status, 1)];
        let error = publish(&stub, source.path(), &options()).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains(&status.to_string()) && text.contains(words),
            "{text}"
        );
    }
    stub.state().card_errors = vec!["\"license\" must be one of".to_owned()];
    let errors = client(&stub, TOKEN).validate_card("x").unwrap().unwrap();
    assert_eq!(errors, ["\"license\" must be one of"]);
    stub.state().faults = vec![("validate".to_owned(), 404, 1)];
    assert_eq!(client(&stub, TOKEN).validate_card("x").unwrap(), None);
    let read = |name: &str| (name == "HF_ENDPOINT").then(|| "http://127.0.0.1:9".into());
    let dead = Hub::from_environment(&read, Box::new(|_| ())).unwrap();
    let error = dead.repository(&id()).unwrap_err().to_string();
    assert!(error.contains("no answer"), "{error}");
}
