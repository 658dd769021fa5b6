//! An episode for human eyes: a transcript, a contact sheet, a film, two side by side, a Rerun
//! recording, a glTF scene, annotations of its frames. A leaf: Rerun brings an Arrow of its own.
//!
//! Shows what the trace holds; never runs physics, never judges.

mod av1;
mod canvas;
mod coco;
mod contact_sheet;
mod gltf_scene;
mod image_difference;
mod player_page;
#[cfg(feature = "rerun")]
mod rerun_recording;
mod scene_bodies;
mod sheet;
mod side_by_side;
mod state_text;
mod transcript;
mod video;

pub use av1::{Av1Encoder, EncodedFrames, Mp4Error, Mp4File, SIDE_MAX, SIDE_MIN, VideoSettings};
pub use coco::{CocoCounts, CocoDataset, CocoError};
pub use contact_sheet::contact_sheet;
pub use gltf_scene::glb;
pub use image_difference::image_difference;
pub use player_page::{EmbeddedEpisode, OPEN_EPISODES, PlayerPage};
#[cfg(feature = "rerun")]
pub use rerun_recording::rrd;
pub use sheet::{SheetImage, sheet};
pub use side_by_side::side_by_side;
pub use state_text::state_text;
pub use transcript::{step, transcript};
pub use video::{Video, VideoSegment};

/// Why an episode cannot be shown.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ViewError {
    /// An image of the trace is damaged.
    #[error(transparent)]
    Trace(#[from] reel_trace::TraceError),
    /// A PNG cannot be made.
    #[error("cannot encode an image: {0}")]
    Png(#[from] png::EncodingError),
    /// A film cannot be encoded.
    #[error("cannot encode the film: {0}")]
    Gif(#[from] gif::EncodingError),
    /// A film is too large.
    #[error("a GIF has at most 65,535 x 65,535 pixels, not {width} x {height}")]
    VideoSize { width: usize, height: usize },
    /// A film cannot be encoded or written as MP4.
    #[error(transparent)]
    Mp4(#[from] Mp4Error),
    /// The Rerun recording cannot be made.
    #[error("cannot make the Rerun recording: {reason}")]
    Rerun { reason: String },
}
