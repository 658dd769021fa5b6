//! Traces to columnar tables.
