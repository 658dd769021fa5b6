//! What can be wrong with a task or scene file: always where, and what.

/// A file that could not be taken.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// It could not be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The file or folder.
        file: String,
        /// The file system's error, or that folders are nested too deep.
        source: std::io::Error,
    },
    /// It is larger than any task.
    #[error("{file}: larger than {most} bytes, which no task file is")]
    TooLarge {
        /// Path of the file that is too large.
        file: String,
        /// Most bytes that a task or scene file may have.
        most: u64,
    },
    /// A folder without a task in it.
    #[error("{file}: no file in it ends with .yaml or .yml")]
    Empty {
        /// Path of the folder that holds no YAML file.
        file: String,
    },
    /// It is no YAML or JSON, or a kind of it that no honest writer makes.
    #[error("{file}:{line}: {problem}")]
    Syntax {
        /// Path of the file that cannot be parsed.
        file: String,
        /// The line, from 1.
        line: usize,
        /// What is wrong with the syntax, in words for people.
        problem: String,
    },
    /// A field is missing or wrong.
    #[error("{file}:{line}: {field}: {problem}")]
    Field {
        /// Path of the file with the missing or wrong field.
        file: String,
        /// The line, from 1: of the field, or of the mapping that lacks it.
        line: usize,
        /// Where in the document, e.g. `episodes[0].dest`.
        field: String,
        /// What is wrong with the field, in words for people.
        problem: String,
    },
    /// A scene that reads well but cannot be.
    #[error("{file}: {field}: {problem}")]
    Scene {
        /// Path of the scene file that contradicts itself.
        file: String,
        /// Where in the document, e.g. `receptacles[3] (table_1)`.
        field: String,
        /// What is wrong at that place, in words for people.
        problem: String,
    },
    /// A folder that holds no published tasks.
    #[error(
        "{folder}: no REAL-Bench tasks in it; give a checkout of github.com/InternRobotics/REAL, or its folder benchmark, which holds \
         tasks/<family>/<task>.yaml"
    )]
    NoBenchmark {
        /// The folder in which tasks were searched.
        folder: String,
    },
    /// A published bundle whose files do not fit together.
    #[error("{file}: {problem}")]
    Bundle {
        /// The file that shows it.
        file: String,
        /// What the check found wrong, for people.
        problem: String,
    },
    /// The scene of a task was not found.
    #[error(
        "{file}:{line}: its scene {scene_id} does not come with Reel, and no scene file (*.json) has this id in {} or their folders \
         `scenes`; name its file with --scene, its folder as `scenes` in reel.toml, or let `reel task real-bench CHECKOUT --out DIR` \
         rebuild a published one",
        searched.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    NoScene {
        /// The task file whose scene is missing.
        file: String,
        /// The line of its `scene_id`, from 1.
        line: usize,
        /// The id of the scene that no file and no built-in scene has.
        scene_id: String,
        /// The folders that were searched.
        searched: Vec<std::path::PathBuf>,
    },
    /// Two files hold a task of the same name.
    #[error("{file}: task {task_id} stands in {first} already")]
    DuplicateTask {
        /// Path of the later file, which repeats the task id.
        file: String,
        /// Path of the file that was loaded first with this task id.
        first: String,
        /// The task id that both files use.
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
