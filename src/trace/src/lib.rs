//! Episodes to MCAP and back.
