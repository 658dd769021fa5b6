//! Reasoning, History, schedule and subtask for trajectories that came without words (SPEC sections 3, 4 and 8).
//!
//! Owns the rule-based writer and the one that asks a model. Never changes a trace: what is written lies beside it.
