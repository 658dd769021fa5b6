//! The walk-through of `docs/datasets.md`, from an empty folder to a loaded dataset: every command
//! that stands there prints what stands below it.

use std::{env, fs, path::Path, process::Command};

use crate::expect;

#[test]
fn from_generated_tasks_to_a_loaded_dataset() {
    let text =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/datasets.md"))
            .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let commands = sessions(&text, "console", "$ reel ");
    assert!(commands.len() >= 6, "{commands:?}");
    for (command, shown) in commands {
        let said = expect(folder.path(), 0, &command.split(' ').collect::<Vec<_>>());
        assert_shown(&command, &said, &shown);
    }
    let Some(python) = env::var_os("REEL_PYTHON") else {
        return println!("skipped: no REEL_PYTHON that could load it");
    };
    let expressions = sessions(&text, "python", ">>> ");
    assert!(!expressions.is_empty());
    for (expression, shown) in expressions {
        let program = format!("import datasets\nprint(repr({expression}))");
        let output = Command::new(&python)
            .current_dir(folder.path())
            .args(["-c", &program])
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{expression}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        assert_shown(
            &expression,
            &String::from_utf8_lossy(&output.stdout),
            &shown,
        );
    }
}

/// What is typed behind a prompt in the blocks of a language, each with the lines shown below it.
fn sessions(text: &str, language: &str, prompt: &str) -> Vec<(String, Vec<String>)> {
    let mut sessions: Vec<(String, Vec<String>)> = Vec::new();
    let mut inside = false;
    for line in text.lines() {
        if let Some(fence) = line.strip_prefix("```") {
            inside = fence == language;
        } else if inside {
            match (line.strip_prefix(prompt), sessions.last_mut()) {
                (Some(typed), _) => sessions.push((typed.to_owned(), Vec::new())),
                (None, Some((_, shown))) => shown.push(line.to_owned()),
                (None, None) => panic!("{line:?} stands below nothing that was typed"),
            }
        }
    }
    sessions
}

/// Every line that is shown was said, in this order; `...` stands for lines left out, and only
/// there may be some.
fn assert_shown(typed: &str, said: &str, shown: &[String]) {
    let mut rest: Vec<&str> = said.trim_end().lines().collect();
    let mut gap = false;
    for line in shown {
        if line == "..." {
            gap = true;
            continue;
        }
        let at = rest
            .iter()
            .position(|it| it == line)
            .filter(|at| gap || *at == 0);
        let Some(at) = at else {
            panic!("{typed}: {line:?} is not where it is shown; it said:\n{said}")
        };
        rest.drain(..=at);
        gap = false;
    }
    assert!(
        gap || rest.is_empty(),
        "{typed}: it said more than is shown:\n{said}"
    );
}
