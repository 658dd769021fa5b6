//! What is wrong with a training set, ours or anybody's: reads the formats of SPEC section 11 and reports with examples.
//!
//! Never changes a file and never asks a model.
