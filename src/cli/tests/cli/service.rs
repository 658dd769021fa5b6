//! `reel serve` and `reel record` from outside: the scripts of `tests/service` and `tests/proxy`,
//! which talk to them as clients do.

pub(crate) fn script(name: &str, arguments: &[&str]) {
    // Any Python will do.
    let Some(python) = reel_vectors::python("sys") else {
        return;
    };
    let mut command = reel_vectors::script(python, name);
    let command = command
        .args(arguments)
        .env("REEL", env!("CARGO_BIN_EXE_reel"));
    if std::env::var_os("REEL_REAL_BENCH").is_none() {
        let shared = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/real-bench");
        command.env("REEL_REAL_BENCH", shared);
    }
    reel_vectors::run(command);
}

/// The faults of every day; `make service` has all of them.
const FAULTS: &[&str] = &reel_world::words! {
    names_are_taken_once disk_full file_too_large upload_breaks_off halves
    large_bodies bodies_as_large_as_they_may_be deep_json_and_invalid_utf8 hostile_calls
    hosts_and_origins last_token what_is_anothers more_than_their_share revoked_in_the_midst
    tls audit words_of_the_protocol words_of_the_newest_protocol sessions_that_are_not_there
    methods_that_a_path_does_not_have advice_for_somebody_else answers_that_are_cut_off restored_in_part
    questions_that_end_their_process
};

#[test]
fn agents_in_processes_of_their_own_play() {
    script("service/players.py", &[]);
}

#[test]
fn the_published_contract_to_the_letter() {
    script("service/real_repo_texts.py", &[]);
}

/// The unmodified client of OpenEnv, and clients that are rude.
#[test]
fn openenv_clients_reset_and_step() {
    script("service/openenv_contract.py", &[]);
}

#[test]
fn nothing_privileged_reaches_a_policy() {
    script("service/leaks.py", &["--episodes", "40"]);
}

/// Every answer that the OpenAPI document has; `make service` adds what Schemathesis makes up.
#[test]
fn every_documented_answer_comes() {
    script("service/openapi.py", &["--short"]);
}

#[test]
fn faults_have_clear_answers() {
    script("service/faults.py", &[&["--quick"], FAULTS].concat());
}

/// Twelve kills; `make kills` has a thousand.
#[test]
fn kills_lose_nothing_that_was_acknowledged() {
    script("service/kills.py", &["--quick"]);
}

/// The published suites of the protocol against the service itself; `src/mcp` has the fixtures.
#[test]
fn the_conformance_suites_pass_where_they_apply() {
    let mut command = reel_vectors::script("bash", "conformance.sh");
    let said = reel_vectors::run(command.arg("serve").env("REEL", env!("CARGO_BIN_EXE_reel")));
    assert!(
        said.contains("conformance: reel serve, /mcp") || said.contains("skipped: "),
        "{said}"
    );
}

/// All of `make proxy`.
#[test]
fn whoever_is_recorded_hears_the_same() {
    script("proxy/proxy.py", &[]);
}
