//! The results of `reel test` as JUnit XML.

use anyhow::Context;
use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};
use std::time::Duration;

use super::{Case, Status};

/// One suite for the agent, a test case for each recording.
///
/// # Errors
/// When a text cannot be written as XML.
pub fn report(agent: &str, cases: &[Case]) -> anyhow::Result<String> {
    let mut suite = TestSuite::new(agent);
    suite.add_test_cases(cases.iter().map(|case| test_case(agent, case)));
    let mut report = Report::new("reel test");
    report.add_test_suite(suite);
    report
        .to_string()
        .context("the results cannot be written as XML")
}

fn test_case(agent: &str, case: &Case) -> TestCase {
    let status = match case.status {
        Status::Passed => TestCaseStatus::success(),
        Status::Failed => unsuccessful(NonSuccessKind::Failure, "deviation", case),
        Status::Error => unsuccessful(NonSuccessKind::Error, "error", case),
    };
    let name = reel_trace::trace_stem(&case.trace);
    let mut written = TestCase::new(name, status);
    written.set_classname(agent);
    written.set_time(Duration::from_secs_f64(case.seconds.max(0.0)));
    written
}

fn unsuccessful(kind: NonSuccessKind, what: &str, case: &Case) -> TestCaseStatus {
    let mut status = TestCaseStatus::non_success(kind);
    status.set_message(case.message());
    status.set_type(what);
    let details = serde_json::to_string_pretty(case).unwrap_or_default();
    status.set_description(details);
    status
}
