//! Training sets from verified traces.
