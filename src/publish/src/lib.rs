//! Publishing datasets: a folder is checked, compared with a target and written there, to a folder
//! or to the Hugging Face Hub.
//!
//! Owns the checks (names, checksums, card, license, secrets, local paths, verdicts), the generated
//! files and the Hub's HTTP API. Never changes the dataset, reads no environment, owns no clock and
//! deletes nothing unless asked.
//!
//! ```no_run
//! use std::path::Path;
//! use reel_publish::{Plan, Publication, existing_files, publish_to_folder};
//!
//! let (source, target) = (Path::new("sft"), Path::new("published"));
//! let publication = Publication::open(source, |_bytes| ())?;
//! if !publication.problems().forbid(&[]) {
//!     let plan = Plan::new(publication.files(), &existing_files(source, target)?);
//!     publish_to_folder(&publication, &plan, target, false, |_bytes| ())?;
//! }
//! # Ok::<(), reel_publish::PublishError>(())
//! ```

mod card;
mod error;
mod folder;
mod generated;
mod hub;
mod local;
mod plan;
mod problem;
mod publication;
mod secrets;
mod target;
mod texts;
mod verdicts;

pub use error::PublishError;
pub use folder::PublishedFile;
pub use generated::{CHECKSUMS, GIT_ATTRIBUTES};
pub use hub::{
    CommitOptions, ENDPOINT, Hub, HubToken, MAIN, Pause, PublishedCommit, RepositoryInfo,
    RepositoryTree, is_branch_name,
};
pub use local::{existing_files, publish_to_folder};
pub use plan::{ExistingFile, FileDigest, FileStatus, Plan, PlannedFile};
pub use problem::{Check, Problem, Problems, printable_path};
pub use publication::{DatasetKind, Publication};
pub use target::{RepositoryId, Target};
