//! Links the library so that it calls its own functions.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // The simulator brings its own sin, cos, ... (docs/determinism.md). In a shared library these names
    // would be looked up in the process first, where the C library has functions with other bits.
    let os = std::env::var("CARGO_CFG_TARGET_OS").unwrap_or_default();
    if matches!(os.as_str(), "linux" | "freebsd") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-Bsymbolic-functions");
    }
}
