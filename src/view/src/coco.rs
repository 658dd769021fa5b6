//! Frames of traces that replay exactly, annotated as COCO has it: instances as run-length encoded
//! masks with their visible share, and panoptic images.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

use reel_replay::{Verdict, View, Viewpoint, views};
use reel_trace::{Trace, encode_png};
use reel_world::{Digest, FRAME_HEIGHT, FRAME_WIDTH, FrameInstance, InstanceKind, instances};
use serde_json::{Value, json};

/// Why frames are not annotated.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum CocoError {
    /// The trace does not replay, or not exactly.
    #[error("{path}: not annotated: {verdict}", path = path.display())]
    NotExact {
        path: PathBuf,
        verdict: Box<Verdict>,
    },
    /// A file cannot be written.
    #[error("cannot write {path}: {source}", path = path.display())]
    Write { path: PathBuf, source: io::Error },
}

/// A folder that is being filled: `images/`, `panoptic/`, `instances.json`, `panoptic.json`.
pub struct CocoDataset {
    folder: PathBuf,
    /// The traces that were added, by the last link of their chain.
    known: BTreeSet<Digest>,
    images: Vec<Value>,
    annotations: Vec<Annotation>,
    panoptic: Vec<(Value, Vec<Segment>)>,
}

/// How much a dataset holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CocoCounts {
    /// Number of annotated frames.
    pub images: usize,
    /// Number of masks, one an instance and frame.
    pub annotations: usize,
    /// Number of different categories.
    pub categories: usize,
}

/// A category, before all are known and numbered.
type Category = (InstanceKind, String);

struct Annotation {
    category: Category,
    value: Value,
}

struct Segment {
    category: Category,
    value: Value,
}

impl CocoDataset {
    /// A dataset in this folder, which is made.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn create(folder: &Path) -> Result<Self, CocoError> {
        make(folder)?;
        Ok(Self {
            folder: folder.to_owned(),
            known: BTreeSet::new(),
            images: Vec::new(),
            annotations: Vec::new(),
            panoptic: Vec::new(),
        })
    }

    /// Adds the frames of a trace from a viewpoint: before the first call and after each. Images are
    /// without marks, unless `marks` asks for those that the agent got.
    ///
    /// # Errors
    /// When the trace does not replay exactly, and then nothing of it is added, or a file cannot be
    /// written. A trace that was added before adds nothing.
    pub fn add(
        &mut self,
        trace: &Trace,
        viewpoint: &Viewpoint,
        marks: bool,
    ) -> Result<(), CocoError> {
        let (mut seen, mut problem) = (Vec::new(), Ok(()));
        let known = instances(&trace.task, &trace.scene);
        // A name of ours: what a trace says of itself is no path.
        let stem = trace.chain().to_string();
        if self.known.contains(&trace.chain()) {
            return Ok(());
        }
        let refused = |verdict: Verdict| CocoError::NotExact {
            path: trace.path.clone(),
            verdict: Box::new(verdict),
        };
        trace.verify_images().map_err(|error| {
            refused(Verdict::Refused {
                reason: error.to_string(),
            })
        })?;
        let replayed = views(trace, viewpoint, |view| {
            if problem.is_ok() {
                let clean = *viewpoint == Viewpoint::Head && !marks;
                problem = self
                    .files(&stem, &view, clean)
                    .map(|name| seen.push((view.step, name, visible(&known, &view))));
            }
        });
        problem?;
        if let Err(verdict) = replayed {
            for folder in ["images", "panoptic"] {
                // Nothing of it was promised.
                let _ = fs::remove_dir_all(self.folder.join(folder).join(&stem));
            }
            return Err(refused(verdict));
        }
        for (step, name, visible) in seen {
            self.frame(trace, step, &name, visible);
        }
        self.known.insert(trace.chain());
        Ok(())
    }

    /// Writes the two images of a frame; their name in both folders.
    fn files(&self, stem: &str, view: &View<'_>, clean: bool) -> Result<String, CocoError> {
        let call = view
            .step
            .map_or_else(|| "start".to_owned(), |step| format!("call_{step:03}"));
        let name = format!("{stem}/{call}.png");
        let panoptic: Vec<u8> = view
            .frame
            .ids
            .iter()
            .flat_map(|id| [id.to_le_bytes()[0], id.to_le_bytes()[1], 0])
            .collect();
        let unmarked = clean.then(|| view.simulator.render_from(&view.camera));
        let rgb = &unmarked.as_ref().unwrap_or(&view.frame).rgb;
        for (folder, rgb) in [("images", rgb), ("panoptic", &panoptic)] {
            let path = self.folder.join(folder).join(&name);
            make(path.parent().unwrap_or(&self.folder))?;
            write(
                &path,
                &encode_png(rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32),
            )?;
        }
        Ok(name)
    }

    fn frame(&mut self, trace: &Trace, step: Option<u32>, name: &str, visible: Vec<Visible>) {
        let image_id = self.images.len() + 1;
        self.images.push(json!({
            "id": image_id, "file_name": name, "width": FRAME_WIDTH, "height": FRAME_HEIGHT,
            "episode_id": trace.header.episode_id, "trace_digest": trace.chain().to_string(), "step": step,
        }));
        let mut segments = Vec::new();
        for it in visible {
            let category = (it.instance.kind, it.instance.category.clone());
            segments.push(Segment {
                category: category.clone(),
                value: json!({"id": it.instance.id, "area": it.area, "bbox": it.bbox, "iscrowd": 0}),
            });
            if it.instance.kind == InstanceKind::Shell {
                continue;
            }
            self.annotations.push(Annotation {
                category,
                value: json!({
                    "id": self.annotations.len() + 1, "image_id": image_id, "iscrowd": 0, "area": it.area, "bbox": it.bbox,
                    "segmentation": {"size": [FRAME_HEIGHT, FRAME_WIDTH], "counts": it.counts},
                    "instance": it.instance.name, "visible_share": it.visible_share,
                }),
            });
        }
        let value = json!({"image_id": image_id, "file_name": name});
        self.panoptic.push((value, segments));
    }

    /// Writes `instances.json` and `panoptic.json`, with the categories numbered over all frames.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn finish(self) -> Result<CocoCounts, CocoError> {
        let segments = self.panoptic.iter().flat_map(|(_, segments)| segments);
        let mut ids: BTreeMap<Category, usize> = segments
            .map(|segment| (segment.category.clone(), 0))
            .collect();
        let mut categories = Vec::new();
        for (index, ((kind, name), id)) in ids.iter_mut().enumerate() {
            *id = index + 1;
            let is_thing = u8::from(*kind != InstanceKind::Shell);
            categories.push(json!({
                "id": *id, "name": name, "supercategory": kind, "isthing": is_thing, "color": colour(*id),
            }));
        }
        let numbered = |category: &Category, mut value: Value| {
            value["category_id"] = json!(ids[category]);
            value
        };
        let annotations: Vec<Value> = self
            .annotations
            .into_iter()
            .map(|it| numbered(&it.category, it.value))
            .collect();
        let panoptic: Vec<Value> = self
            .panoptic
            .into_iter()
            .map(|(mut value, segments)| {
                let segments = segments.into_iter();
                let segments: Vec<Value> = segments
                    .map(|it| numbered(&it.category, it.value))
                    .collect();
                value["segments_info"] = json!(segments);
                value
            })
            .collect();
        let counts = CocoCounts {
            images: self.images.len(),
            annotations: annotations.len(),
            categories: categories.len(),
        };
        let info = json!({"description": "frames of episodes, by Reel", "version": env!("CARGO_PKG_VERSION")});
        for (name, annotations) in [("instances", annotations), ("panoptic", panoptic)] {
            let document = json!({
                "info": info, "images": self.images, "annotations": annotations, "categories": categories,
            });
            let path = self.folder.join(format!("{name}.json"));
            write(&path, document.to_string().as_bytes())?;
        }
        Ok(counts)
    }
}

/// An instance in a frame.
struct Visible {
    instance: FrameInstance,
    area: usize,
    /// x, y, width, height.
    bbox: [usize; 4],
    /// Run lengths as COCO writes them.
    counts: String,
    /// Pixels of it of those that would be seen if nothing stood before it; `None` for what is not drawn
    /// alone, the robot and what it holds.
    visible_share: Option<f64>,
}

fn visible(known: &[FrameInstance], view: &View<'_>) -> Vec<Visible> {
    let ids = &view.frame.ids;
    let mut found = Vec::new();
    for instance in known {
        let pixels = ids.iter().enumerate().filter(|(_, id)| **id == instance.id);
        let mut area = 0;
        let [mut left, mut top, mut right, mut bottom] = [FRAME_WIDTH, FRAME_HEIGHT, 0, 0];
        for (at, _) in pixels {
            let (x, y) = (at % FRAME_WIDTH, at / FRAME_WIDTH);
            area += 1;
            (left, right) = (left.min(x), right.max(x));
            (top, bottom) = (top.min(y), bottom.max(y));
        }
        if area == 0 {
            continue;
        }
        let whole = view.simulator.unoccluded_pixels(&view.camera, instance.id);
        found.push(Visible {
            instance: instance.clone(),
            area,
            bbox: [left, top, right - left + 1, bottom - top + 1],
            counts: run_lengths(ids, instance.id),
            visible_share: (whole > 0).then(|| area as f64 / whole.max(area) as f64),
        });
    }
    found
}

/// The mask of an instance as COCO's compressed run lengths: columns from the left, each from the
/// top, background first.
fn run_lengths(ids: &[u16], instance: u16) -> String {
    let pixels = (0..FRAME_WIDTH).flat_map(|x| (0..FRAME_HEIGHT).map(move |y| y * FRAME_WIDTH + x));
    let (mut runs, mut inside) = (vec![0_i64], false);
    for pixel in pixels {
        if (ids[pixel] == instance) != inside {
            inside = !inside;
            runs.push(0);
        }
        *runs.last_mut().expect("there is a first run") += 1;
    }
    let mut text = String::new();
    for (index, run) in runs.iter().enumerate() {
        // From the fourth on, the difference to the run of the same kind before.
        let mut value = if index > 2 {
            run - runs[index - 2]
        } else {
            *run
        };
        loop {
            let mut bits = (value & 0x1f) as u8;
            value >>= 5;
            let more = if bits & 0x10 != 0 {
                value != -1
            } else {
                value != 0
            };
            bits |= u8::from(more) << 5;
            text.push(char::from(bits + 48));
            if !more {
                break;
            }
        }
    }
    text
}

/// A colour of its own for each of some hundred categories.
fn colour(id: usize) -> [usize; 3] {
    [67 * id % 256, 139 * id % 256, 211 * id % 256]
}

fn make(folder: &Path) -> Result<(), CocoError> {
    fs::create_dir_all(folder).map_err(|source| CocoError::Write {
        path: folder.to_owned(),
        source,
    })
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), CocoError> {
    fs::write(path, bytes).map_err(|source| CocoError::Write {
        path: path.to_owned(),
        source,
    })
}
