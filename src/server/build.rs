//! Builds the crate anew when the web pages were built anew: they are embedded.

use std::path::Path;

fn main() {
    let pages = "../../dashboards/dist";
    // A path that is not there would make every build a new one.
    let watched = if Path::new(pages).exists() {
        pages
    } else {
        "../../dashboards/index.html"
    };
    println!("cargo:rerun-if-changed={watched}");
    println!("cargo:rerun-if-changed=../../dashboards/definitions");
    println!("cargo:rerun-if-changed=build.rs");
}
