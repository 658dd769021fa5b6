//! What pages that the command line writes have in common.

use reel_world::printable_lines;

/// A text as it stands in HTML, in attributes too: nothing in it is markup, or makes its neighbours read otherwise.
pub fn escaped(text: &str) -> String {
    printable_lines(text)
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
