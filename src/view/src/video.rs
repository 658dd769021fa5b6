//! An episode as a video: one a call, with the call, what came of it and the reward
//! beneath; two episodes side by side. Images come from whoever drew them; the film is a GIF or an MP4.

use std::{borrow::Cow, num::NonZeroU32, path::Path};

use reel_trace::Trace;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use crate::{
    ViewError,
    av1::{Av1Encoder, Mp4File, VideoSettings},
    canvas::{
        Canvas, Colour, Font,
        colours::{BLUE, CARD, FAINT, GREEN, INK, PAPER, RED},
        wrap,
    },
    contact_sheet,
};

const PADDING: usize = 10;
const TITLE: usize = 30;
const STRIP: usize = 4;
const LINE: usize = 22;
const TOLD_LINES: usize = 3;
/// Beneath an image: the call, what came of it, the reward.
const CAPTION: usize = STRIP + 2 * PADDING + (2 + TOLD_LINES) * LINE;
const GAP: usize = 8;
/// The last image stays so many times as long.
const LAST: usize = 3;

/// Ticks of a second in an MP4.
const TIMESCALE: NonZeroU32 = NonZeroU32::new(90_000).unwrap();
/// Images from one that decodes alone to the next, where a player may jump to.
const KEY_FRAME_INTERVAL: u64 = 30;
/// Texts stay sharp up to this quantizer.
const QUANTIZER: u8 = 60;

/// Moving images in memory.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Video {
    /// Width of every frame in pixels, an even number.
    pub width: usize,
    /// Height of every frame in pixels, an even number.
    pub height: usize,
    /// 8-bit RGB, row by row from the top left; one before the first call, then one a call.
    pub frames: Vec<Vec<u8>>,
}

/// An episode and its images before the first call and after each.
#[derive(Clone, Copy, Debug)]
pub struct VideoSegment<'a> {
    /// Trace of the episode, which the captions are taken from.
    pub trace: &'a Trace,
    /// 640 x 480, RGB.
    pub frames: &'a [Vec<u8>],
}

/// What stands beneath an image.
struct Caption {
    call: String,
    told: String,
    reward: String,
    reward_colour: Colour,
    colour: Colour,
}

impl Video {
    /// A film of one episode, or of several side by side, call by call; who is through first waits
    /// in its last image.
    pub fn new(parts: &[VideoSegment<'_>]) -> Self {
        let length = parts
            .iter()
            .map(|part| part.frames.len())
            .max()
            .unwrap_or(0);
        let width = parts.len() * FRAME_WIDTH + parts.len().saturating_sub(1) * GAP;
        let height = TITLE + FRAME_HEIGHT + CAPTION;
        let captions: Vec<Vec<Caption>> = parts.iter().map(|part| captions(part.trace)).collect();
        let image = |moment: usize| {
            let mut canvas = Canvas::new(width, height, PAPER);
            for (index, (part, captions)) in parts.iter().zip(&captions).enumerate() {
                let at = moment.min(part.frames.len().min(captions.len()).saturating_sub(1));
                if let (Some(image), Some(caption)) = (part.frames.get(at), captions.get(at)) {
                    draw(
                        &mut canvas,
                        index * (FRAME_WIDTH + GAP),
                        part.trace,
                        image,
                        caption,
                    );
                }
            }
            canvas.into_rgb()
        };
        Self {
            width,
            height,
            frames: (0..length).map(image).collect(),
        }
    }

    /// As an animated GIF that plays for ever, so many images a second; the last one stays
    /// three times as long.
    ///
    /// # Errors
    /// When it is larger than a GIF can be.
    pub fn gif(&self, fps: f64) -> Result<Vec<u8>, ViewError> {
        let size = |pixels: usize| {
            u16::try_from(pixels).map_err(|_| ViewError::VideoSize {
                width: self.width,
                height: self.height,
            })
        };
        let (width, height) = (size(self.width)?, size(self.height)?);
        let delay = (100.0 / fps.clamp(0.01, 50.0)).round();
        let mut bytes = Vec::new();
        let mut encoder = gif::Encoder::new(&mut bytes, width, height, &[])?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        for (index, image) in self.frames.iter().enumerate() {
            let times = if index + 1 == self.frames.len() {
                LAST
            } else {
                1
            };
            let mut frame = gif::Frame::from_rgb_speed(width, height, image, 10);
            frame.delay = (delay * times as f64).min(f64::from(u16::MAX)) as u16;
            encoder.write_frame(&frame)?;
        }
        drop(encoder);
        Ok(bytes)
    }

    /// Writes an MP4 with AV1 that shows so many images a second; the last one stays three times as long.
    ///
    /// # Errors
    /// When it is larger than a video can be, or the file cannot be written.
    pub fn write_mp4(&self, fps: f64, path: &Path) -> Result<(), ViewError> {
        let settings = VideoSettings {
            width: self.width,
            height: self.height,
            key_frame_interval: KEY_FRAME_INTERVAL,
            quantizer: QUANTIZER,
        };
        let mut encoder = Av1Encoder::new(settings)?;
        for image in self.stream() {
            encoder.push(image)?;
        }
        let duration = (f64::from(TIMESCALE.get()) / fps.clamp(0.01, 50.0)).round() as u32;
        let mut file = Mp4File::create(path, settings, TIMESCALE, duration)?;
        file.append(&encoder.finish()?)?;
        Ok(file.finish()?)
    }

    /// The images as a stream for an encoder that takes each equally long.
    pub fn stream(&self) -> impl Iterator<Item = &[u8]> {
        let last = self
            .frames
            .last()
            .into_iter()
            .flat_map(|image| std::iter::repeat_n(image.as_slice(), LAST - 1));
        self.frames.iter().map(Vec::as_slice).chain(last)
    }
}

/// One before the first call, and one a call.
fn captions(trace: &Trace) -> Vec<Caption> {
    let mut total = 0.0;
    let mut captions = vec![Caption {
        call: "start".into(),
        told: trace.task.instruction.clone(),
        reward: String::new(),
        reward_colour: BLUE,
        colour: BLUE,
    }];
    for (index, record) in trace.steps.iter().enumerate() {
        let reward = record.reward_total();
        total += reward;
        let is_last = index + 1 == trace.steps.len();
        let success = trace
            .end
            .as_ref()
            .filter(|_| is_last)
            .map(|end| end.metrics.success);
        let (verdict, verdict_colour) = match success {
            Some(true) => ("   SUCCESS", GREEN),
            Some(false) => ("   FAILURE", RED),
            None if reward < 0.0 => ("", RED),
            None => ("", GREEN),
        };
        captions.push(Caption {
            call: format!("{}  {}", record.step, record.input.call),
            told: contact_sheet::outcome(record),
            reward: format!("reward {reward:+.2}, in all {total:+.2}{verdict}"),
            reward_colour: verdict_colour,
            colour: if record.outcome.is_ok() { GREEN } else { RED },
        });
    }
    captions
}

fn draw(canvas: &mut Canvas, x: usize, trace: &Trace, image: &[u8], caption: &Caption) {
    let left = x + PADDING;
    let columns = (FRAME_WIDTH - 2 * PADDING) / Font::Medium.width();
    let branch = trace
        .header
        .parent
        .as_ref()
        .map_or(Cow::Borrowed(""), |parent| {
            format!(" from call {}", parent.call).into()
        });
    let title = format!(
        "{}  {}{branch}",
        trace.header.task_id, trace.header.policy.name
    );
    let shorten = |text: &str, font: Font, lines: usize| {
        wrap(text, (FRAME_WIDTH - 2 * PADDING) / font.width(), lines)
    };
    for line in shorten(&title, Font::MediumBold, 1) {
        canvas.text(
            left,
            (TITLE - Font::MediumBold.height()) / 2,
            &line,
            Font::MediumBold,
            INK,
        );
    }
    canvas.paste(x, TITLE, image, FRAME_WIDTH);
    let top = TITLE + FRAME_HEIGHT;
    canvas.fill(x, top, FRAME_WIDTH, CAPTION, CARD);
    canvas.fill(x, top, FRAME_WIDTH, STRIP, caption.colour);
    let mut y = top + STRIP + PADDING;
    let mut write = |lines: Vec<String>, font: Font, colour: Colour| {
        for line in lines {
            canvas.text(left, y, &line, font, colour);
            y += LINE;
        }
    };
    write(
        shorten(&caption.call, Font::MediumBold, 1),
        Font::MediumBold,
        INK,
    );
    write(
        wrap(&caption.told, columns, TOLD_LINES),
        Font::Medium,
        FAINT,
    );
    let last = top + CAPTION - PADDING - LINE;
    canvas.text(
        left,
        last,
        &caption.reward,
        Font::MediumBold,
        caption.reward_colour,
    );
}
