//! Video files against the episodes whose frames they hold.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

use reel_dataset::lint::Severity;
use shiguredo_mp4::{
    TrackKind,
    boxes::SampleEntry,
    demux::{Input, Mp4FileDemuxer},
};

use super::{
    findings::Check,
    folder::{Folder, VideoPart},
};

/// Most bytes of a video's index that are read at once.
const INDEX_BYTES_MAX: usize = 256 << 20;

/// The frames of a video file.
struct VideoTrack {
    frames: u64,
    seconds: f64,
    /// Width and height in pixels; none where the codec is not known.
    pixels: Option<(u16, u16)>,
}

/// Checks the files of every camera.
pub(super) fn check(folder: &Folder, check: &mut Check) {
    let mut files = 0;
    let cameras: Vec<&str> = folder.cameras().collect();
    for camera in &cameras {
        let mut parts: BTreeMap<PathBuf, Vec<(i64, i64, VideoPart)>> = BTreeMap::new();
        for episode in &folder.episodes {
            if let Some(part) = episode.videos.get(*camera) {
                let path = folder.path("video_path", camera, part.chunk, part.file);
                let entry = (episode.index, episode.length, *part);
                parts.entry(path).or_default().push(entry);
            }
        }
        files += parts.len();
        for (path, mut parts) in parts {
            parts.sort_by(|one, other| one.2.from_s.total_cmp(&other.2.from_s));
            let name = path
                .strip_prefix(&folder.root)
                .unwrap_or(&path)
                .display()
                .to_string();
            check_parts(folder, &name, &parts, check);
            let track = check_file(folder, &path, &name, &parts, check);
            if let Some(pixels) = track.and_then(|track| track.pixels) {
                check_pixels(folder, camera, &name, pixels, check);
            }
        }
    }
    if cameras.is_empty() {
        check.not_applicable("no videos");
    } else {
        check.note(format!("{files} files of {} cameras", cameras.len()));
    }
}

/// The parts of a file, by their beginnings: as long as their episodes, one after the other, and in the order of the
/// episodes, as every writer puts them; two exchanged ones of equal length are seen by nothing else.
fn check_parts(folder: &Folder, name: &str, parts: &[(i64, i64, VideoPart)], check: &mut Check) {
    for pair in parts.windows(2) {
        let ((before, ..), (after, ..)) = (&pair[0], &pair[1]);
        if before > after {
            let message = format!("{name} shows episode {before} before episode {after}");
            check.add("order", Severity::Warning, None, message);
        }
    }
    let mut end_s = 0.0;
    for (index, length, part) in parts {
        let frames = (part.to_s - part.from_s) * folder.fps;
        if (frames - *length as f64).abs() > 0.5 {
            let message = format!(
                "episode {index} has {length} frames, and {} s to {} s of {name} are {frames:.1}",
                part.from_s, part.to_s
            );
            check.add("length", Severity::Error, None, message);
        }
        if part.from_s < end_s - 0.5 / folder.fps {
            let message = format!(
                "episode {index} begins at {} s of {name}, before the end of another",
                part.from_s
            );
            check.add("overlap", Severity::Error, None, message);
        }
        end_s = part.to_s.max(end_s);
    }
}

/// The size of the images of a camera's file is that which `info.json` gives.
fn check_pixels(folder: &Folder, camera: &str, name: &str, pixels: (u16, u16), check: &mut Check) {
    let Some(feature) = folder.features.get(camera) else {
        return;
    };
    let [width, height] = [u64::from(pixels.0), u64::from(pixels.1)];
    let named = |side: &str| {
        let at = feature.names.iter().position(|name| name == side)?;
        feature.shape.get(at).copied()
    };
    let told = match (named("width"), named("height")) {
        (Some(told_width), Some(told_height)) => (told_width, told_height) == (width, height),
        // Without names, the channels may stand first or last.
        _ => {
            let shape = feature.shape.as_slice();
            shape.starts_with(&[height, width]) || shape.ends_with(&[height, width])
        }
    };
    if !told {
        let message = format!(
            "images of {name} are {width} wide and {height} high, and info.json says {:?} {:?}",
            feature.shape, feature.names
        );
        check.add("size", Severity::Error, None, message);
    }
}

/// The file: it is there, and as long as its parts.
fn check_file(
    folder: &Folder,
    path: &Path,
    name: &str,
    parts: &[(i64, i64, VideoPart)],
    check: &mut Check,
) -> Option<VideoTrack> {
    if !path.is_file() {
        let message = format!("{name} is not there; {} episodes are in it", parts.len());
        check.add("missing", Severity::Error, None, message);
        return None;
    }
    let track = match read(path) {
        Ok(track) => track,
        Err(reason) => {
            let message = format!("{name} is no whole MP4 with a video: {reason}");
            check.add("unreadable", Severity::Error, None, message);
            return None;
        }
    };
    let end_s = parts.iter().map(|(.., part)| part.to_s).fold(0.0, f64::max);
    let expected = (end_s * folder.fps).round();
    if (track.frames as f64) < expected {
        let message = format!(
            "{name} has {} frames, and its episodes need {expected}",
            track.frames
        );
        check.add("too-short", Severity::Error, None, message);
    } else if track.frames as f64 > expected {
        let message = format!(
            "{name} has {} frames, and its episodes use {expected}",
            track.frames
        );
        check.add("too-long", Severity::Warning, None, message);
    }
    let fps = track.frames as f64 / track.seconds;
    if (fps / folder.fps - 1.0).abs() > 0.01 {
        let message = format!(
            "{name} has {fps:.3} frames per second, and info.json says {}",
            folder.fps
        );
        check.add("fps", Severity::Error, None, message);
    }
    Some(track)
}

/// Reads the index of a file, not its images.
fn read(path: &Path) -> Result<VideoTrack, String> {
    let mut file = File::open(path).map_err(|error| error.to_string())?;
    let mut demuxer = Mp4FileDemuxer::new();
    while let Some(required) = demuxer.required_input() {
        let mut data = Vec::new();
        let size = required
            .size
            .unwrap_or(INDEX_BYTES_MAX)
            .min(INDEX_BYTES_MAX);
        let sought = file.seek(SeekFrom::Start(required.position));
        sought
            .and_then(|_| (&mut file).take(size as u64).read_to_end(&mut data))
            .map_err(|error| error.to_string())?;
        demuxer.handle_input(Input {
            position: required.position,
            data: &data,
        });
    }
    let tracks = demuxer.tracks().map_err(|error| error.to_string())?;
    let video = tracks.iter().find(|track| track.kind == TrackKind::Video);
    let id = video.ok_or("it has no video track")?.track_id;
    let mut track = VideoTrack {
        frames: 0,
        seconds: 0.0,
        pixels: None,
    };
    while let Some(sample) = demuxer.next_sample().map_err(|error| error.to_string())? {
        if sample.track.track_id == id {
            track.frames += 1;
            let entry = sample.sample_entry;
            track.pixels = track
                .pixels
                .or_else(|| entry.and_then(SampleEntry::video_resolution));
            track.seconds += f64::from(sample.duration) / f64::from(sample.track.timescale.get());
        }
    }
    Ok(track)
}
