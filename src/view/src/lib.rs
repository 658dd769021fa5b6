//! Pictures and Rerun recordings of an episode.
