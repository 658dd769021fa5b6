//! The tests of the Python package, which are Python (`make test-python` runs the long ones, too).

#[test]
fn todo() {}
