//! What exports of traces into formats of other tools share: one trace after the other, those that cannot be read
//! named and left out, and what an import would not give back.

use std::{collections::BTreeSet, path::Path, path::PathBuf};

use anyhow::bail;
use indicatif::ProgressBar;
use reel_trace::{Trace, TraceFiles, trace_stem};
use serde_json::{Value, json};

use crate::{ExitStatus, inputs, progress};

/// Traces that are exported one after the other.
pub(super) struct Traces {
    files: TraceFiles,
    paths: Vec<PathBuf>,
    unread: usize,
}

impl Traces {
    pub(super) fn find(paths: &[PathBuf]) -> anyhow::Result<Self> {
        let files = inputs::trace_files();
        let paths = inputs::traces(&files, paths)?;
        Ok(Self {
            files,
            paths,
            unread: 0,
        })
    }

    /// Refuses two traces whose files would have one name.
    pub(super) fn expect_distinct_names(&self) -> anyhow::Result<()> {
        let mut stems = BTreeSet::new();
        match self
            .paths
            .iter()
            .find(|path| !stems.insert(trace_stem(path)))
        {
            None => Ok(()),
            Some(twice) => bail!(
                "two traces are called {}; export them into different folders, or rename one: {}",
                trace_stem(twice),
                twice.display()
            ),
        }
    }

    /// Exports each trace that can be read; the others are named on stderr.
    pub(super) fn each(
        &mut self,
        mut export: impl FnMut(&Path, Trace, &ProgressBar) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let bar = progress::bar(self.paths.len(), "export");
        for path in &self.paths {
            match self.files.read(path) {
                Ok(trace) => {
                    export(path, trace, &bar)?;
                    bar.inc(1);
                }
                Err(error) => {
                    bar.suspend(|| eprintln!("reel: not exported: {error}"));
                    self.unread += 1;
                }
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Number of traces that were read.
    pub(super) fn exported(&self) -> usize {
        self.paths.len() - self.unread
    }

    pub(super) fn status(&self) -> ExitStatus {
        match self.exported() {
            _ if self.unread == 0 => ExitStatus::Success,
            0 => ExitStatus::BadInput,
            _ => ExitStatus::Partial,
        }
    }
}

/// Fields that an import does not give back, each with what becomes of it, as JSON.
pub(super) fn lost_fields(lost: &[(&str, &str)]) -> Value {
    let lost = lost
        .iter()
        .map(|(field, what)| json!({"field": field, "becomes": what}));
    lost.collect()
}

/// Prints what `reel import FORMAT` does not give back.
pub(super) fn tell_lost(format: &str, lost: &[(&str, &str)], json: bool) {
    if json {
        println!("{}", json!({ "lost": lost_fields(lost) }));
        return;
    }
    println!("reel import {format} gives back all but:");
    for (field, what) in lost {
        println!("  {field}: {what}");
    }
}
