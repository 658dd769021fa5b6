//! `reel trace recover` and `reel trace doctor` from outside: what they say, what they leave,
//! and their exit codes.

use std::{fs, path::Path};

use crate::{complaint, expect, first_trace};

/// A trace, and the part of a recording of it that was killed after some steps.
fn recorded(folder: &Path) -> (std::path::PathBuf, std::path::PathBuf) {
    reel!(folder, "task draw --count 1 --families FDP --out tasks");
    reel!(folder, "run --tasks tasks --out traces --durability fsync");
    let trace = first_trace(folder);
    let part = trace.with_extension("mcap.part");
    (trace, part)
}

#[test]
fn doctor_and_recover_by_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (trace, part) = recorded(folder);
    let name = trace.to_str().unwrap();
    assert!(reel!(folder, "trace doctor traces").contains(": healthy, "));
    assert!(reel!(folder, "trace recover {name}").contains("whole, nothing to recover"));

    // Torn: the doctor says where, recovery names what is lost and keeps the evidence.
    let whole = fs::read(&trace).unwrap();
    fs::write(&trace, &whole[..whole.len() * 2 / 3]).unwrap();
    let verdict = expect(folder, 1, &format!("trace doctor {name}"));
    assert!(
        verdict.contains("at byte") && verdict.contains("`reel trace recover`"),
        "{verdict}"
    );
    let report = expect(folder, 3, &format!("trace recover {name}"));
    assert!(
        report.contains("lost: ") && report.contains(".recovered.mcap"),
        "{report}"
    );
    assert!(trace.exists());
    let recovered = trace.with_extension("recovered.mcap");
    assert!(
        expect(
            folder,
            0,
            &["trace", "doctor", recovered.to_str().unwrap(), "--json"]
        )
        .contains(r#""findings":[]"#)
    );
    // Once it is said, it is no news.
    let again = reel!(folder, "trace recover {name}");
    assert!(
        again.contains("already in") && again.contains("lost before: "),
        "{again}"
    );

    // Cut only in the index: everything is there. In another folder, and as JSON.
    fs::write(&trace, &whole[..whole.len() - 20]).unwrap();
    let report = reel!(folder, "trace recover {name} --out restored --json");
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(
        (&report["restored"], &report["end_recorded"]),
        (&"written".into(), &true.into()),
        "{report}"
    );
    let restored = report["trace"].as_str().unwrap();
    assert!(reel!(folder, "replay {restored}").contains("exact"));

    // A part of which nothing can be read, and a file of another program.
    fs::write(&part, b"").unwrap();
    fs::remove_file(&trace).unwrap();
    fs::remove_file(&recovered).unwrap();
    assert!(expect(folder, 1, "trace doctor traces").contains("not healthy"));
    assert!(expect(folder, 3, "trace recover traces").contains("nothing can be restored"));
    assert!(reel!(folder, "trace doctor {name}").contains("no part of the recording"));
    let missing = complaint(folder, 2, "trace recover nowhere");
    assert!(
        missing.contains("no such recording or folder: nowhere"),
        "{missing}"
    );
    complaint(folder, 2, "trace doctor tasks");
    let unknown = complaint(folder, 2, "run --tasks tasks --durability hope");
    assert!(unknown.contains("there are write and fsync"), "{unknown}");
}
