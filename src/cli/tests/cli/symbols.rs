//! The binary takes no mathematics from the C library: C libraries differ, and so would replays.

use std::{collections::BTreeSet, fs};

use object::{Object, ObjectSymbol};

/// Mathematics whose result is not exact by definition, for `double`; the others by suffix.
const MATHEMATICS: &[&str] = &reel_world::words! {
    acos acosh asin asinh atan atan2 atanh cbrt cos cosh erf erfc exp exp10 exp2 expm1 gamma hypot
    j0 j1 jn ldexp lgamma log log10 log1p log2 pow sin sincos sinh tan tanh tgamma y0 y1 yn drem
    remainder remquo scalb significand nexttoward
};

#[test]
fn no_mathematics_comes_from_the_c_library() {
    let bytes = fs::read(env!("CARGO_BIN_EXE_reel")).unwrap();
    let binary = object::File::parse(&*bytes).unwrap();
    let imported: BTreeSet<String> = binary
        .dynamic_symbols()
        .filter(|symbol| symbol.is_undefined())
        .filter_map(|symbol| Some(symbol.name().ok()?.split('@').next()?.to_owned()))
        .collect();
    assert!(
        imported.contains("malloc"),
        "the dynamic symbols were not read: {imported:?}"
    );
    let foreign: Vec<&String> = imported
        .iter()
        .filter(|name| is_mathematics(name))
        .collect();
    assert!(
        foreign.is_empty(),
        "define these in src/sim/src/math.rs: {foreign:?}"
    );
}

#[test]
fn the_list_knows_what_it_looks_for() {
    for name in [
        "sinf",
        "acosf",
        "log2f",
        "pow",
        "sincosf",
        "atan2",
        "tgammaf",
        "lgamma_r",
        "__expf_finite",
        "expl",
    ] {
        assert!(is_mathematics(name), "{name}");
    }
    for name in [
        "malloc",
        "logger",
        "signal",
        "expand",
        "fesetround",
        "cosmos",
        "write",
    ] {
        assert!(!is_mathematics(name), "{name}");
    }
}

/// Whether a symbol is one of those functions, for any width of float and in
/// the C libraries' spellings.
fn is_mathematics(symbol: &str) -> bool {
    let name = symbol.strip_prefix("__").unwrap_or(symbol);
    let name = name
        .strip_suffix("_finite")
        .or_else(|| name.strip_suffix("_r"))
        .unwrap_or(name);
    let widths = ["", "f", "l", "f32", "f64", "f128"];
    widths.iter().any(|width| {
        name.strip_suffix(width)
            .is_some_and(|name| MATHEMATICS.contains(&name))
    })
}
