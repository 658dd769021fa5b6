//! Reward presets and metrics as pure functions of recorded steps.
