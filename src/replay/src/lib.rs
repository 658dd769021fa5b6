//! Re-executes traces and names the first difference.
