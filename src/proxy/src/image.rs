//! An image of a result on its way into a trace: as it came, or drawn into the size that traces hold.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use reel_trace::robot::CameraImage;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame, FrameDigests};

/// An image on its way into a trace.
pub(crate) enum Image {
    /// A PNG file of the size that traces hold, in Base64. It is decoded when the episode ends:
    /// nobody waits for that.
    AsItCame(String),
    /// Of another kind or size: the file, and what a trace holds of it.
    Fitted(CameraImage, Box<Frame>),
}

impl Image {
    /// An image as a result brings it, in Base64.
    ///
    /// # Errors
    /// Why a trace cannot hold it.
    pub(crate) fn of(data: String) -> Result<Self, String> {
        if png_size(&data) == Some((FRAME_WIDTH, FRAME_HEIGHT)) {
            return Ok(Image::AsItCame(data));
        }
        let file = STANDARD
            .decode(&data)
            .map_err(|error| format!("it is not Base64 ({error})"))?;
        let (original, frame) = reel_import::robot::camera_image(file)?;
        Ok(Image::Fitted(original, Box::new(frame)))
    }

    /// The digests of what a trace holds of it, where it is decoded.
    pub(crate) fn digests(&self) -> Option<FrameDigests> {
        match self {
            Image::AsItCame(_) => None,
            Image::Fitted(_, frame) => Some(frame.digests()),
        }
    }
}

/// Width and height of a PNG file in Base64, as its head says.
fn png_size(text: &str) -> Option<(usize, usize)> {
    let head = STANDARD.decode(text.get(..32)?).ok()?;
    let side = |from: usize| Some(u32::from_be_bytes(*head.get(from..)?.first_chunk()?) as usize);
    head.starts_with(b"\x89PNG\r\n\x1a\n")
        .then(|| Some((side(16)?, side(20)?)))
        .flatten()
}
