//! The service: the tool server for policies, REST for people and trainers, read-only analysis for
//! assistants, jobs, and what keeps all of it safe.
//!
//! Puts together what other crates do; what an episode is, they know. Every way in passes
//! the same gate (`gate`).

#[cfg(feature = "tables")]
mod analysis;
mod archive;
mod audit;
mod config;
mod connections;
mod files;
mod gate;
mod in_memory;
#[cfg(feature = "tables")]
mod intake;
#[cfg(feature = "tables")]
mod jobs;
mod metrics;
mod mock_llm;
mod openenv;
mod otlp;
#[cfg(feature = "tables")]
mod pages;
mod replay;
mod rest;
mod routes;
mod run;
mod service;
mod snapshots;
#[cfg(feature = "tables")]
mod sql_process;
#[cfg(any(feature = "tables", feature = "rerun"))]
mod static_file;
#[cfg(feature = "tables")]
mod store;
mod tls;
mod tokens;
#[cfg(feature = "rerun")]
mod viewer;

pub use audit::{AuditEntry, AuditLog};
pub use config::{Config, ConfigError, Limits, LogFormat, MatcherConfig, Order, Play};
#[doc(hidden)]
pub use in_memory::InMemoryServer;
pub use mock_llm::{MockOptions, mock_llm};
pub use reel_mcp::{AnswerSources, AskResponder, AskUser, LookUp};
pub use reel_tape::{
    Deviation, EpisodeReport as TapeReport, EpisodeStatus as TapeStatus, Tape, TapeError,
    TapeSessions, TapeSettings, Tapes, deviation,
};
pub use replay::{ReplayServer, run_replay_stdio};
pub use rest::openapi;
pub use run::{OnTrace, run, run_stdio};
pub use service::{ServeError, Service, start_logs};
#[cfg(feature = "tables")]
pub use sql_process::answer_sql;
pub use tls::{TlsError, TlsFiles};
pub use tokens::{Role, TokenEntry, TokenError, Tokens};
#[cfg(feature = "rerun")]
pub use viewer::view;
