//! What can be wrong with a task or scene file: always where, and what.

/// A file that could not be taken.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TaskError {
    /// It could not be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        file: String,
        source: std::io::Error,
    },
    /// It is larger than any task.
    #[error("{file}: larger than {most} bytes, which no task file is")]
    TooLarge {
        file: String,
        /// Most bytes that a task or scene file may have.
        most: u64,
    },
    /// A folder without a task in it.
    #[error("{file}: no file in it ends with .yaml or .yml")]
    Empty { file: String },
    /// It is no YAML or JSON, or a kind of it that no honest writer makes.
    #[error("{file}:{line}: {problem}")]
    Syntax {
        file: String,
        /// The line, from 1.
        line: usize,
        problem: String,
    },
    /// A field is missing or wrong.
    #[error("{file}:{line}: {field}: {problem}")]
    Field {
        file: String,
        /// The line, from 1: of the field, or of the mapping that lacks it.
        line: usize,
        /// Where in the document, e.g. `episodes[0].dest`.
        field: String,
        problem: String,
    },
    /// A scene that reads well but cannot be.
    #[error("{file}: {field}: {problem}")]
    Scene {
        file: String,
        /// Where in the document, e.g. `receptacles[3] (table_1)`.
        field: String,
        problem: String,
    },
    /// A folder that holds no published tasks.
    #[error(
        "{folder}: no REAL-Bench tasks in it; give a checkout of github.com/InternRobotics/REAL, or its folder benchmark, which holds \
         tasks/<family>/<task>.yaml"
    )]
    NoBenchmark { folder: String },
    /// A published bundle whose files do not fit together.
    #[error("{file}: {problem}")]
    Bundle { file: String, problem: String },
    /// The scene of a task was not found.
    #[error(
        "{file}:{line}: its scene {scene_id} does not come with Reel, and no scene file (*.json) has this id in {} or their folders \
         `scenes`; name its file with --scene, its folder as `scenes` in reel.toml, or let `reel task real-bench CHECKOUT --out DIR` \
         rebuild a published one",
        searched.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    NoScene {
        file: String,
        /// The line of its `scene_id`, from 1.
        line: usize,
        scene_id: String,
        searched: Vec<std::path::PathBuf>,
    },
    /// Two files hold a task of the same name.
    #[error("{file}: task {task_id} stands in {first} already")]
    DuplicateTask {
        file: String,
        first: String,
        task_id: String,
    },
}

/// A [`TaskError`] before the file is known. Without a field it is one of syntax.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    pub line: usize,
    pub field: String,
    pub problem: String,
}

impl Problem {
    pub fn syntax(line: usize, problem: impl Into<String>) -> Self {
        Self {
            line,
            field: String::new(),
            problem: problem.into(),
        }
    }

    pub fn in_file(self, file: &str) -> TaskError {
        let Problem {
            line,
            field,
            problem,
        } = self;
        let file = file.to_owned();
        if field.is_empty() {
            TaskError::Syntax {
                file,
                line,
                problem,
            }
        } else {
            TaskError::Field {
                file,
                line,
                field,
                problem,
            }
        }
    }
}
