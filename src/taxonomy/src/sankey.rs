//! Owns the Sankey diagram of failures, family -> class -> sub-class, as SVG and as PNG from one
//! layout. Never decides why an episode failed, and reads and writes no file.

mod layout;
mod palette;
mod png;
mod scene;
mod svg;
mod text;

#[cfg(test)]
mod tests;

use layout::Layout;
use scene::Scene;

/// Failed episodes of one family with one primary class and sub-class.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Flow {
    /// Task family: `FDP`, `FODP`, `FDO`, `SUL` or any other name.
    pub family: String,
    /// Class of the taxonomy, e.g. `Object Confusion`.
    pub class: String,
    /// Sub-class of these failures within their class, e.g. `wrong_attribute`.
    pub sub_class: String,
    /// How many episodes; flows of the same names add up, flows of none are left out.
    pub episodes: u64,
}

/// The diagram, laid out. Same input, same bytes.
///
/// Names may be anything: what cannot be shown is replaced, what is too long is shortened in labels
/// (the tooltips of the SVG have all of it), and where there are very many names the smallest are
/// drawn together as "n more".
pub struct Sankey {
    scene: Scene,
}

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum SankeyError {
    /// The scale is outside [`Sankey::SCALES`], or not a number.
    #[error(
        "a Sankey diagram cannot be drawn at scale {found}: choose one from {smallest} to {largest}"
    )]
    Scale {
        found: f32,
        smallest: f32,
        largest: f32,
    },
    /// There is no memory for an image of this size.
    #[error("an image of {width_px} x {height_px} pixels is too large; choose a smaller scale")]
    Size { width_px: u32, height_px: u32 },
    /// The PNG could not be written.
    #[error("the diagram could not be encoded as PNG: {0}")]
    Encoding(#[from] ::png::EncodingError),
}

impl Sankey {
    /// The scales that [`Sankey::png`] takes.
    pub const SCALES: std::ops::RangeInclusive<f32> = 0.5..=4.0;

    /// Lays out the failures of a set of runs; `successes` of the `episodes_total` episodes did not
    /// fail. Failures in no flow count as not classified.
    pub fn new(
        title: &str,
        subtitle: &str,
        flows: &[Flow],
        episodes_total: u64,
        successes: u64,
    ) -> Self {
        let layout = Layout::of(flows);
        Self {
            scene: Scene::of(title, subtitle, &layout, episodes_total, successes),
        }
    }

    /// The diagram as an SVG document: accessible, with exact counts in the tooltips, without
    /// scripts or outside fonts.
    pub fn svg(&self) -> String {
        svg::write(&self.scene)
    }

    /// The diagram as a PNG file, `scale` pixels to a unit of the SVG. Text is ASCII from a bitmap
    /// font, sharpest at scales 1 and 2; other characters become `?`.
    pub fn png(&self, scale: f32) -> Result<Vec<u8>, SankeyError> {
        if !Self::SCALES.contains(&scale) {
            return Err(SankeyError::Scale {
                found: scale,
                smallest: *Self::SCALES.start(),
                largest: *Self::SCALES.end(),
            });
        }
        png::draw(&self.scene, scale)
    }
}
