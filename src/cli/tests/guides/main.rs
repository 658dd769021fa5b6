//! README, CONTRIBUTING and the guides of `docs`, held against the binary: every command of theirs
//! runs or is parsed, what they show is what it prints, and the reference pages are generated.
#![cfg(all(feature = "analytics", feature = "cluster", feature = "rerun"))]

mod page;
mod reference;
mod shell;
mod spans;

use std::{
    env, fs,
    path::{Path, PathBuf},
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Instant,
};

use page::Page;
use shell::Session;

/// The root of the repository.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// All pages, or those that `REEL_PAGES` names: `REEL_PAGES=README.md,docs/play.md`.
fn pages() -> Vec<Page> {
    let root = root();
    let mut paths = vec!["README.md".to_owned(), "CONTRIBUTING.md".to_owned()];
    for entry in fs::read_dir(root.join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") {
            paths.push(format!("docs/{name}"));
        }
    }
    paths.sort();
    if let Ok(only) = env::var("REEL_PAGES") {
        paths = only.split(',').map(str::to_owned).collect();
    }
    let page = |path: String| {
        let text = fs::read_to_string(root.join(&path)).unwrap_or_else(|e| panic!("{path}: {e}"));
        Page::parse(path, text)
    };
    paths.into_iter().map(page).collect()
}

#[test]
fn every_command_of_the_pages_works() {
    let pages = pages();
    let python = reel_vectors::python("datasets");
    let next = AtomicUsize::new(0);
    let sessions: Mutex<Vec<Session>> = Mutex::default();
    let workers = thread::available_parallelism().map_or(2, |count| count.get().clamp(2, 8));
    thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(page) = pages.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let begun = Instant::now();
                    let mut session = Session::new(page, python.as_deref());
                    session.play();
                    println!(
                        "{:24} {:5.1} s  {} run, {} parsed, {} not ours",
                        page.path,
                        begun.elapsed().as_secs_f64(),
                        session.run,
                        session.parsed,
                        session.foreign.len()
                    );
                    sessions.lock().unwrap().push(session);
                }
            });
        }
    });
    let sessions = sessions.into_inner().unwrap();
    let sum = |count: fn(&Session) -> usize| sessions.iter().map(count).sum::<usize>();
    println!(
        "{} commands run, {} parsed, {} not ours",
        sum(|it| it.run),
        sum(|it| it.parsed),
        sum(|it| it.foreign.len())
    );
    for session in &sessions {
        for command in &session.foreign {
            println!("  not ours: {command}");
        }
    }
    let failures: Vec<&str> = sessions
        .iter()
        .flat_map(|session| session.failures.iter().map(String::as_str))
        .collect();
    assert!(failures.is_empty(), "\n{}", failures.join("\n\n"));
}
