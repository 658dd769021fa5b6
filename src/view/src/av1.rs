//! Frames as AV1 video in MP4 files. Equal frames and settings give equal bytes on every machine: one
//! thread encodes without assembler, and no file says when it was made.

use std::{
    fs::File,
    io::{Seek, SeekFrom, Write},
    num::NonZeroU32,
    path::{Path, PathBuf},
};

use rav1e::prelude::{
    ChromaSampling, ColorDescription, ColorPrimaries, Config, Context, EncoderConfig,
    EncoderStatus, FrameType, MatrixCoefficients, PixelRange, Rational, SceneDetectionSpeed,
    SpeedSettings, TransferCharacteristics,
};
use shiguredo_mp4::{
    TrackKind, Uint,
    boxes::{Av01Box, Av1cBox, SampleEntry, VisualSampleEntryFields},
    mux::{Mp4FileMuxer, MuxError, Sample},
};

/// Fewest pixels of a side of a video.
pub const SIDE_MIN: usize = 16;
/// Most pixels of a side of a video.
pub const SIDE_MAX: usize = 8192;
/// The fastest preset; the slower ones make these small synthetic images little smaller.
const SPEED: u8 = 10;

/// Why a video cannot be made.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum Mp4Error {
    /// Sides that AV1 in 4:2:0 does not have here.
    #[error(
        "a video has even sides of {SIDE_MIN} to {SIDE_MAX} pixels, not {width} x {height}; choose another size"
    )]
    Size { width: usize, height: usize },
    /// A frame that does not fill the video.
    #[error("a frame has {found} bytes, and {expected} fill the video")]
    Frame { expected: usize, found: usize },
    /// The encoder gave up.
    #[error("the AV1 encoder failed: {reason}")]
    Encode { reason: String },
    /// The container cannot hold it.
    #[error("cannot make an MP4 of the video: {reason}: {path}", path = path.display())]
    Mux { path: PathBuf, reason: String },
    /// A file cannot be written.
    #[error("cannot write the video: {source}: {path}", path = path.display())]
    Write {
        path: PathBuf,
        source: std::io::Error,
    },
}

/// How a video is encoded.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct VideoSettings {
    /// Width of a frame in pixels, an even number.
    pub width: usize,
    /// Height of a frame in pixels, an even number.
    pub height: usize,
    /// Frames from one that decodes alone to the next, at least 1.
    pub key_frame_interval: u64,
    /// Quantizer from 0 (best) to 255 (smallest).
    pub quantizer: u8,
}

/// Encoded frames, which begin with one that decodes alone; such runs can follow one another in a file.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EncodedFrames {
    /// AV1 temporal units in the order of the frames, and whether each decodes alone.
    units: Vec<(Vec<u8>, bool)>,
}

impl EncodedFrames {
    /// Number of frames that were encoded.
    pub fn len(&self) -> usize {
        self.units.len()
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.units.is_empty()
    }

    /// Size of all frames in bytes.
    pub fn bytes(&self) -> usize {
        self.units.iter().map(|(unit, _)| unit.len()).sum()
    }
}

/// Takes frames one by one and encodes them.
pub struct Av1Encoder {
    context: Context<u8>,
    settings: VideoSettings,
    encoded: EncodedFrames,
}

impl Av1Encoder {
    /// An encoder without frames.
    ///
    /// # Errors
    /// When a side is odd, too short or too long.
    pub fn new(settings: VideoSettings) -> Result<Self, Mp4Error> {
        let VideoSettings { width, height, .. } = settings;
        let fits = |side: usize| (SIDE_MIN..=SIDE_MAX).contains(&side) && side.is_multiple_of(2);
        if !fits(width) || !fits(height) {
            return Err(Mp4Error::Size { width, height });
        }
        let mut speed_settings = SpeedSettings::from_preset(SPEED);
        speed_settings.scene_detection_mode = SceneDetectionSpeed::None;
        let config = EncoderConfig {
            width,
            height,
            time_base: Rational::new(1, 30),
            chroma_sampling: ChromaSampling::Cs420,
            pixel_range: PixelRange::Limited,
            color_description: Some(ColorDescription {
                color_primaries: ColorPrimaries::BT601,
                transfer_characteristics: TransferCharacteristics::BT601,
                matrix_coefficients: MatrixCoefficients::BT601,
            }),
            min_key_frame_interval: settings.key_frame_interval.max(1),
            max_key_frame_interval: settings.key_frame_interval.max(1),
            low_latency: true,
            quantizer: usize::from(settings.quantizer),
            speed_settings,
            ..EncoderConfig::default()
        };
        let context = Config::new()
            .with_encoder_config(config)
            .with_threads(1)
            .new_context()
            .map_err(|error| Mp4Error::Encode {
                reason: error.to_string(),
            })?;
        Ok(Self {
            context,
            settings,
            encoded: EncodedFrames::default(),
        })
    }

    /// Takes the next frame: 8-bit RGB, row by row from the top left.
    ///
    /// # Errors
    /// When it has another size, or the encoder fails.
    pub fn push(&mut self, rgb: &[u8]) -> Result<(), Mp4Error> {
        let VideoSettings { width, height, .. } = self.settings;
        if rgb.len() != width * height * 3 {
            return Err(Mp4Error::Frame {
                expected: width * height * 3,
                found: rgb.len(),
            });
        }
        let [luma, blue, red] = yuv420(rgb, width);
        let mut frame = self.context.new_frame();
        for (plane, (values, stride)) in
            frame
                .planes
                .iter_mut()
                .zip([(luma, width), (blue, width / 2), (red, width / 2)])
        {
            plane.copy_from_raw_u8(&values, stride, 1);
        }
        self.context.send_frame(frame).map_err(failed)?;
        self.receive()
    }

    /// The frames, encoded.
    ///
    /// # Errors
    /// When the encoder fails.
    pub fn finish(mut self) -> Result<EncodedFrames, Mp4Error> {
        self.context.flush();
        self.receive()?;
        Ok(self.encoded)
    }

    /// Takes what is encoded by now.
    fn receive(&mut self) -> Result<(), Mp4Error> {
        loop {
            match self.context.receive_packet() {
                Ok(packet) => {
                    let alone = packet.frame_type == FrameType::KEY;
                    self.encoded.units.push((packet.data, alone));
                }
                Err(EncoderStatus::Encoded) => {}
                Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(()),
                Err(status) => return Err(failed(status)),
            }
        }
    }
}

fn failed(status: EncoderStatus) -> Mp4Error {
    Mp4Error::Encode {
        reason: status.to_string(),
    }
}

/// Luma and both chroma planes of an image, by BT.601 in its limited range; chroma is the mean of four pixels.
fn yuv420(rgb: &[u8], width: usize) -> [Vec<u8>; 3] {
    let height = rgb.len() / 3 / width;
    let mut luma = Vec::with_capacity(width * height);
    for pixel in rgb.as_chunks::<3>().0 {
        let [red, green, blue] = pixel.map(i32::from);
        luma.push(((66 * red + 129 * green + 25 * blue + 128) / 256 + 16) as u8);
    }
    let [mut blue_difference, mut red_difference] =
        [(); 2].map(|()| Vec::with_capacity(width * height / 4));
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let mut sum = [0i32; 3];
            for at in [y * width + x, (y + 1) * width + x] {
                for (channel, sum) in sum.iter_mut().enumerate() {
                    *sum += i32::from(rgb[at * 3 + channel]) + i32::from(rgb[at * 3 + 3 + channel]);
                }
            }
            let [red, green, blue] = sum;
            let chroma = |value: i32| ((value + 512).div_euclid(1024) + 128) as u8;
            blue_difference.push(chroma(-38 * red - 74 * green + 112 * blue));
            red_difference.push(chroma(112 * red - 94 * green - 18 * blue));
        }
    }
    [luma, blue_difference, red_difference]
}

/// An MP4 file that is being written, each frame equally long.
pub struct Mp4File {
    path: PathBuf,
    file: File,
    muxer: Mp4FileMuxer,
    settings: VideoSettings,
    /// Ticks of a second, and of a frame.
    timescale: NonZeroU32,
    duration: u32,
    position: u64,
    frames: u64,
}

impl Mp4File {
    /// Begins a file whose frames last `duration` ticks, of which a second has `timescale`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn create(
        path: &Path,
        settings: VideoSettings,
        timescale: NonZeroU32,
        duration: u32,
    ) -> Result<Self, Mp4Error> {
        let muxer = Mp4FileMuxer::new().map_err(|error| muxing(path, &error))?;
        let file = File::create(path).map_err(|source| Mp4Error::Write {
            path: path.to_owned(),
            source,
        })?;
        let mut begun = Self {
            path: path.to_owned(),
            file,
            settings,
            timescale,
            duration,
            position: 0,
            frames: 0,
            muxer,
        };
        let head = begun.muxer.initial_boxes_bytes().to_vec();
        begun.write(&head)?;
        Ok(begun)
    }

    /// Number of frames that were appended so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Size of the file so far, in bytes.
    pub fn bytes(&self) -> u64 {
        self.position
    }

    /// Appends frames that were encoded with the settings of the file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, encoded: &EncodedFrames) -> Result<(), Mp4Error> {
        for (unit, alone) in &encoded.units {
            let data_offset = self.position;
            self.write(unit)?;
            let sample = Sample {
                track_kind: TrackKind::Video,
                sample_entry: (self.frames == 0).then(|| entry(self.settings)),
                keyframe: *alone,
                timescale: self.timescale,
                duration: self.duration,
                composition_time_offset: None,
                data_offset,
                data_size: unit.len(),
            };
            let appended = self.muxer.append_sample(&sample);
            appended.map_err(|error| muxing(&self.path, &error))?;
            self.frames += 1;
        }
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// When the file cannot be written, or has no frame.
    pub fn finish(mut self) -> Result<(), Mp4Error> {
        let boxes = self.muxer.finalize();
        let boxes = boxes.map_err(|error| muxing(&self.path, &error))?.clone();
        for (offset, bytes) in boxes.offset_and_bytes_pairs() {
            let written = self.file.seek(SeekFrom::Start(offset));
            written
                .and_then(|_| self.file.write_all(bytes))
                .map_err(|source| Mp4Error::Write {
                    path: self.path.clone(),
                    source,
                })?;
        }
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Mp4Error> {
        self.position += bytes.len() as u64;
        self.file
            .write_all(bytes)
            .map_err(|source| Mp4Error::Write {
                path: self.path.clone(),
                source,
            })
    }
}

fn muxing(path: &Path, error: &MuxError) -> Mp4Error {
    Mp4Error::Mux {
        path: path.to_owned(),
        reason: error.to_string(),
    }
}

/// What a player reads of the stream before its first frame. Level 31 sets no limits; each frame that decodes alone
/// brings its sequence header along.
fn entry(settings: VideoSettings) -> SampleEntry {
    let side = |pixels: usize| u16::try_from(pixels).unwrap_or(u16::MAX);
    SampleEntry::Av01(Av01Box {
        visual: VisualSampleEntryFields {
            data_reference_index: VisualSampleEntryFields::DEFAULT_DATA_REFERENCE_INDEX,
            width: side(settings.width),
            height: side(settings.height),
            horizresolution: VisualSampleEntryFields::DEFAULT_HORIZRESOLUTION,
            vertresolution: VisualSampleEntryFields::DEFAULT_VERTRESOLUTION,
            frame_count: VisualSampleEntryFields::DEFAULT_FRAME_COUNT,
            compressorname: VisualSampleEntryFields::NULL_COMPRESSORNAME,
            depth: VisualSampleEntryFields::DEFAULT_DEPTH,
        },
        av1c_box: Av1cBox {
            seq_profile: Uint::new(0),
            seq_level_idx_0: Uint::new(31),
            seq_tier_0: Uint::new(0),
            high_bitdepth: Uint::new(0),
            twelve_bit: Uint::new(0),
            monochrome: Uint::new(0),
            chroma_subsampling_x: Uint::new(1),
            chroma_subsampling_y: Uint::new(1),
            chroma_sample_position: Uint::new(0),
            initial_presentation_delay_minus_one: None,
            config_obus: Vec::new(),
        },
        unknown_boxes: Vec::new(),
    })
}
