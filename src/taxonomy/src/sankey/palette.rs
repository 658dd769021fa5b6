//! Owns the colours of the diagram: four hues of Okabe and Ito's colour-blind-safe set for the
//! classes, their tints for sub-classes, greys for the rest.

use reel_world::FailureClass;

/// An opaque colour as 8-bit red, green and blue.
pub type Color = [u8; 3];

pub const BACKGROUND: Color = [255, 255, 255];
/// Names and the title.
pub const INK: Color = [15, 23, 42];
/// Everything that explains: 4.8 to 1 on the background.
pub const MUTED: Color = [100, 116, 139];
/// Light grey: the successes in the bar of all episodes.
pub const PALE: Color = [226, 232, 240];
/// Slate grey: the nodes of the task families.
pub const FAMILY: Color = [71, 85, 105];
/// Failures of no class, and classes we do not know.
pub const UNKNOWN: Color = [148, 163, 184];
/// Green: the mark that is drawn when no episode failed.
pub const GOOD: Color = [0, 158, 115];

/// The classes of the taxonomy in their order, with their hues.
pub const CLASSES: [(&str, Color); 4] = [
    (FailureClass::ObjectConfusion.as_str(), [0, 114, 178]),
    (FailureClass::KeyActionMissing.as_str(), [230, 159, 0]),
    (FailureClass::LostMemory.as_str(), [0, 158, 115]),
    (FailureClass::Other.as_str(), [204, 121, 167]),
];

/// The hue of a class.
pub fn class_color(class: &str) -> Color {
    CLASSES
        .iter()
        .find(|(name, _)| *name == class)
        .map_or(UNKNOWN, |&(_, color)| color)
}

/// The tint of the `rank`-th largest sub-class: the class's hue, ever lighter, never so light that
/// it is lost on white.
pub fn tint(hue: Color, rank: usize) -> Color {
    let white_percent = (rank * 12).min(48) as u32;
    hue.map(|channel| {
        ((u32::from(channel) * (100 - white_percent) + 255 * white_percent) / 100) as u8
    })
}
