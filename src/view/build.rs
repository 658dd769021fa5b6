//! Takes the player's page into the library, where it was built (`make web`).

use std::{env, fs, path::PathBuf};

fn main() {
    let page = "../../web/dist/player.html";
    // A path that is not there would make every build a new one.
    let built = fs::exists(page).unwrap_or(false);
    let watched = if built {
        page
    } else {
        "../../web/package.json"
    };
    println!("cargo:rerun-if-changed={watched}");
    println!("cargo:rerun-if-changed=build.rs");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo names it")).join("player.html");
    let bytes = if built {
        fs::read(page).expect("the page can be read")
    } else {
        Vec::new()
    };
    fs::write(out, bytes).expect("the output folder can be written");
}
