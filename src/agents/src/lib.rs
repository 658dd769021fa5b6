//! Policies and the runner that records their episodes.
