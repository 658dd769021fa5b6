//! Owns Set-of-Mark overlays: tints, outlines and numbers drawn into the RGB of a frame. Never
//! changes ids or depth, and never chooses what is marked.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame, MarkerBox};

use super::text::{TextSize, blend, draw_text};
use super::{OverlayMark, Region};

/// Draws numbered Set-of-Mark overlays into the RGB of a frame; ids and depth stay.
///
/// Entities without a visible pixel get nothing. Labels lie inside the image and do not overlap, as
/// long as there is room for all of them. The frame tells where the numbers are.
pub fn overlay(frame: &mut Frame, marks: &[OverlayMark]) {
    overlay_tinted(frame, marks, ENTITY_TINT);
}

/// [`overlay`] with entities tinted to a coverage of 0 to 255.
pub fn overlay_tinted(frame: &mut Frame, marks: &[OverlayMark], entity_tint: u16) {
    let masks: Vec<Option<Mask>> = marks
        .iter()
        .map(|mark| Mask::of(mark.region, &frame.ids))
        .collect();
    for (mark, mask) in marks.iter().zip(&masks) {
        if let Some(mask) = mask {
            let tint = if matches!(mark.region, Region::Entity(_)) {
                entity_tint
            } else {
                RECTANGLE_TINT
            };
            mask.paint(&mut frame.rgb, color_of(mark.number), tint);
        }
    }
    let labels = place_labels(marks, &masks);
    for label in &labels {
        label.draw_pointer(&mut frame.rgb);
    }
    for label in &labels {
        label.draw(&mut frame.rgb);
    }
    let marked = marks.iter().zip(&masks);
    let marked = marked.filter_map(|(mark, mask)| Some((mark.number, mask.as_ref()?)));
    let boxes = marked.zip(&labels).map(|((id, mask), label)| MarkerBox {
        id,
        bbox: mask.bbox(),
        label: label.bbox(),
    });
    frame.marker_boxes.extend(boxes);
}

/// Coverage of tints and outlines, of 255.
const ENTITY_TINT: u16 = 48;
const RECTANGLE_TINT: u16 = 36;
const OUTLINE: u16 = 235;
const OUTLINE_PX: i32 = 2;

/// Colours that differ well from each other and, tinted, from most furniture.
const PALETTE: [[u8; 3]; 20] = [
    [230, 25, 75],
    [60, 180, 75],
    [0, 130, 200],
    [255, 225, 25],
    [245, 130, 48],
    [145, 30, 180],
    [70, 240, 240],
    [240, 50, 230],
    [210, 245, 60],
    [0, 128, 128],
    [250, 190, 212],
    [170, 110, 40],
    [128, 0, 0],
    [170, 255, 195],
    [0, 0, 160],
    [220, 190, 255],
    [128, 128, 0],
    [255, 250, 200],
    [255, 90, 60],
    [40, 220, 130],
];

fn color_of(number: u32) -> [u8; 3] {
    PALETTE[number.wrapping_sub(1) as usize % PALETTE.len()]
}

/// The pixels of a region over its bounding box.
struct Mask {
    left: i32,
    top: i32,
    width: i32,
    /// City-block distance of each pixel to the nearest one outside the mask; 0
    /// outside. Row by row.
    depths: Vec<i32>,
    anchor: Anchor,
}

/// Where a label is wished.
#[derive(Clone, Copy)]
enum Anchor {
    /// The label's centre lies here.
    Centre([i32; 2]),
    /// The mask is too small for a label: it goes above this point, with a line to it.
    Beside([i32; 2]),
    /// The label hangs from here.
    Top([i32; 2]),
}

impl Mask {
    fn of(region: Region, ids: &[u16]) -> Option<Self> {
        match region {
            Region::Entity(id) => Self::of_entity(id, ids),
            Region::Rectangle(corners) => Some(Self::of_rectangle(corners)),
        }
    }

    fn of_entity(id: u16, ids: &[u16]) -> Option<Self> {
        let (mut left, mut right, mut top, mut bottom) = (FRAME_WIDTH, 0, FRAME_HEIGHT, 0);
        for (y, row) in ids.chunks_exact(FRAME_WIDTH).enumerate() {
            // Counting is fast, searching is not, and most rows lack most things.
            if row.iter().map(|&other| u16::from(other == id)).sum::<u16>() == 0 {
                continue;
            }
            let first = row.iter().position(|&other| other == id)?;
            let last = row.iter().rposition(|&other| other == id)?;
            (left, right) = (left.min(first), right.max(last));
            (top, bottom) = (top.min(y), bottom.max(y));
        }
        if left > right {
            return None;
        }
        let rows = ids
            .chunks_exact(FRAME_WIDTH)
            .skip(top)
            .take(bottom - top + 1);
        let inside = rows.flat_map(|row| row[left..=right].iter().map(|&other| other == id));
        let depths = distances_to_border(inside, right - left + 1);
        let (left, top, width) = (left as i32, top as i32, (right - left + 1) as i32);
        let mut mask = Self {
            left,
            top,
            width,
            depths,
            anchor: Anchor::Centre([left, top]),
        };
        mask.anchor = mask.find_anchor();
        Some(mask)
    }

    fn of_rectangle([x0, y0, x1, y1]: [u16; 4]) -> Self {
        let clip = |value: u16, size: usize| i32::from(value).min(size as i32 - 1);
        let (left, right) = (clip(x0.min(x1), FRAME_WIDTH), clip(x0.max(x1), FRAME_WIDTH));
        let (top, bottom) = (
            clip(y0.min(y1), FRAME_HEIGHT),
            clip(y0.max(y1), FRAME_HEIGHT),
        );
        let across = |y: i32| {
            (left..=right).map(move |x| (x - left).min(right - x).min(y - top).min(bottom - y) + 1)
        };
        let depths = (top..=bottom).flat_map(across).collect();
        Self {
            left,
            top,
            width: right - left + 1,
            depths,
            anchor: Anchor::Top([(left + right) / 2, top]),
        }
    }

    fn bbox(&self) -> [u16; 4] {
        let height = self.depths.len() as i32 / self.width;
        corners(self.left, self.top, self.width, height)
    }

    /// Pixels of the mask in the image, with their distances to its border.
    fn pixels(&self) -> impl Iterator<Item = ([i32; 2], i32)> {
        (self.top..)
            .zip(self.depths.chunks_exact(self.width as usize))
            .flat_map(|(y, row)| {
                (self.left..)
                    .zip(row)
                    .filter(|&(_, &depth)| depth > 0)
                    .map(move |(x, &depth)| ([x, y], depth))
            })
    }

    /// Tints the mask and draws its border, inside the mask.
    fn paint(&self, rgb: &mut [u8], color: [u8; 3], tint: u16) {
        for ([x, y], depth) in self.pixels() {
            let at = (y as usize * FRAME_WIDTH + x as usize) * 3;
            blend(
                &mut rgb[at..at + 3],
                color,
                if depth > OUTLINE_PX { tint } else { OUTLINE },
            );
        }
    }

    /// The place nearest to the mask's centroid where a label has room, or else the widest place.
    fn find_anchor(&self) -> Anchor {
        let (mut count, mut sum) = (0i64, [0i64; 2]);
        for ([x, y], _) in self.pixels() {
            count += 1;
            sum = [sum[0] + i64::from(x), sum[1] + i64::from(y)];
        }
        let centroid = sum.map(|s| (s / count.max(1)) as i32);
        let (mut best, mut place) = ((0, i32::MIN), centroid);
        for (point, depth) in self.pixels() {
            let (dx, dy) = (point[0] - centroid[0], point[1] - centroid[1]);
            let value = (depth.min(ROOMY_PX), -(dx * dx + dy * dy));
            if value > best {
                (best, place) = (value, point);
            }
        }
        if best.0 < SMALL_PX {
            Anchor::Beside([place[0], self.top])
        } else {
            Anchor::Centre(place)
        }
    }
}

/// The first and the last pixel of a rectangle inside the image.
fn corners(left: i32, top: i32, width: i32, height: i32) -> [u16; 4] {
    [left, top, left + width - 1, top + height - 1].map(|value| value as u16)
}

/// City-block distances of the pixels of a mask to the nearest one outside; outside the
/// bounding box is outside.
fn distances_to_border(inside: impl Iterator<Item = bool>, width: usize) -> Vec<i32> {
    let mut distances: Vec<i32> = inside
        .map(|inside| if inside { i32::MAX } else { 0 })
        .collect();
    let count = distances.len();
    for i in 0..count {
        let before = if i % width > 0 { distances[i - 1] } else { 0 };
        let above = if i >= width { distances[i - width] } else { 0 };
        distances[i] = distances[i].min(before.min(above) + 1);
    }
    for i in (0..count).rev() {
        let after = if i % width + 1 < width {
            distances[i + 1]
        } else {
            0
        };
        let below = if i + width < count {
            distances[i + width]
        } else {
            0
        };
        distances[i] = distances[i].min(after.min(below) + 1);
    }
    distances
}

/// A mask this far from its border has room for a label.
const ROOMY_PX: i32 = 20;
/// A mask whose middle is nearer to its border than this is too small to write on.
const SMALL_PX: i32 = 9;

/// A number in a box.
#[derive(Clone, Debug)]
struct Label {
    text: String,
    color: [u8; 3],
    left: i32,
    top: i32,
    width: i32,
    /// What it points at, when it lies away from it.
    target: Option<[i32; 2]>,
}

const LABEL_SIZE: TextSize = TextSize::Medium;
const LABEL_HEIGHT: i32 = 22;
const LABEL_PADDING: i32 = 5;
/// Least gap between two labels, in pixels.
const LABEL_GAP: i32 = 1;

fn place_labels(marks: &[OverlayMark], masks: &[Option<Mask>]) -> Vec<Label> {
    let mut placed: Vec<Label> = Vec::new();
    for (mark, mask) in marks.iter().zip(masks) {
        let Some(mask) = mask else { continue };
        let text = mark.number.to_string();
        let width = LABEL_SIZE.width(&text) as i32 + 2 * LABEL_PADDING;
        let (centre, target) = match mask.anchor {
            Anchor::Centre(point) => (point, None),
            Anchor::Beside([x, y]) => ([x, y - LABEL_HEIGHT / 2 - 6], Some([x, y])),
            Anchor::Top([x, y]) => ([x, y + LABEL_HEIGHT / 2 + 3], None),
        };
        let mut label = Label {
            text,
            color: color_of(mark.number),
            left: 0,
            top: 0,
            width,
            target,
        };
        let free = spiral(centre).find(|&centre| {
            label.centre_on(centre);
            placed.iter().all(|other| !label.overlaps(other))
        });
        if free.is_none() {
            label.centre_on(centre);
        }
        placed.push(label);
    }
    placed
}

impl Label {
    /// Moves the label there, or as near as the image lets it.
    fn centre_on(&mut self, [x, y]: [i32; 2]) {
        self.left = (x - self.width / 2).clamp(0, FRAME_WIDTH as i32 - self.width);
        self.top = (y - LABEL_HEIGHT / 2).clamp(0, FRAME_HEIGHT as i32 - LABEL_HEIGHT);
    }

    fn bbox(&self) -> [u16; 4] {
        corners(self.left, self.top, self.width, LABEL_HEIGHT)
    }

    fn overlaps(&self, other: &Label) -> bool {
        self.left < other.left + other.width + LABEL_GAP
            && other.left < self.left + self.width + LABEL_GAP
            && self.top < other.top + LABEL_HEIGHT + LABEL_GAP
            && other.top < self.top + LABEL_HEIGHT + LABEL_GAP
    }

    fn draw(&self, rgb: &mut [u8]) {
        for y in 0..LABEL_HEIGHT {
            for x in 0..self.width {
                let edge = x.min(self.width - 1 - x).min(y).min(LABEL_HEIGHT - 1 - y);
                let corner = x.min(self.width - 1 - x) + y.min(LABEL_HEIGHT - 1 - y);
                if corner < 3 {
                    continue;
                }
                let border = edge < 2 || corner < 5;
                let at = ((self.top + y) as usize * FRAME_WIDTH + (self.left + x) as usize) * 3;
                let (color, coverage) = if border {
                    (self.color, 255)
                } else {
                    ([18, 19, 24], 225)
                };
                blend(&mut rgb[at..at + 3], color, coverage);
            }
        }
        let (x, y) = (
            self.left + LABEL_PADDING,
            self.top + (LABEL_HEIGHT - LABEL_SIZE.height() as i32) / 2,
        );
        draw_text(
            rgb,
            FRAME_WIDTH,
            FRAME_HEIGHT,
            x,
            y,
            LABEL_SIZE,
            [255; 3],
            &self.text,
        );
    }

    /// A two-pixel line from the middle of the label to what it marks, if it lies away from it.
    fn draw_pointer(&self, rgb: &mut [u8]) {
        let Some([to_x, to_y]) = self.target else {
            return;
        };
        let (from_x, from_y) = (self.left + self.width / 2, self.top + LABEL_HEIGHT / 2);
        let steps = (to_x - from_x).abs().max((to_y - from_y).abs()).max(1);
        for step in 0..=steps {
            let x = from_x + (to_x - from_x) * step / steps;
            let y = from_y + (to_y - from_y) * step / steps;
            for column in [x, x + 1] {
                if (0..FRAME_WIDTH as i32).contains(&column)
                    && (0..FRAME_HEIGHT as i32).contains(&y)
                {
                    let at = (y as usize * FRAME_WIDTH + column as usize) * 3;
                    blend(&mut rgb[at..at + 3], self.color, 255);
                }
            }
        }
    }
}

/// Points around a centre, ring by ring, until the whole image is covered.
fn spiral([x, y]: [i32; 2]) -> impl Iterator<Item = [i32; 2]> {
    const STEP_PX: i32 = 4;
    let rings = FRAME_WIDTH as i32 / STEP_PX;
    (0..=rings).flat_map(move |ring| {
        let d = ring * STEP_PX;
        (-ring..=ring).map(|i| i * STEP_PX).flat_map(move |i| {
            [
                [x + i, y - d],
                [x + i, y + d],
                [x - d, y + i],
                [x + d, y + i],
            ]
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame_with(squares: &[(u16, [usize; 4])]) -> Frame {
        let mut frame = Frame::new();
        for &(id, [x0, y0, x1, y1]) in squares {
            for y in y0..=y1 {
                frame.ids[y * FRAME_WIDTH + x0..=y * FRAME_WIDTH + x1].fill(id);
            }
        }
        frame
    }

    fn labels(frame: &Frame, marks: &[OverlayMark]) -> Vec<Label> {
        let masks: Vec<Option<Mask>> = marks
            .iter()
            .map(|mark| Mask::of(mark.region, &frame.ids))
            .collect();
        place_labels(marks, &masks)
    }

    fn assert_apart_and_inside(labels: &[Label]) {
        for (i, label) in labels.iter().enumerate() {
            assert!(
                label.left >= 0 && label.left + label.width <= FRAME_WIDTH as i32,
                "{label:?}"
            );
            assert!(
                label.top >= 0 && label.top + LABEL_HEIGHT <= FRAME_HEIGHT as i32,
                "{label:?}"
            );
            assert!(
                labels[..i].iter().all(|other| !label.overlaps(other)),
                "{label:?} overlaps"
            );
        }
    }

    #[test]
    fn crowded_labels_are_inside_and_apart() {
        // Forty specks in a corner, and the same place marked again and again.
        let squares: Vec<(u16, [usize; 4])> = (0..40u16)
            .map(|i| (i + 1, [usize::from(i) * 3, 0, usize::from(i) * 3 + 1, 2]))
            .collect();
        let mut marks: Vec<OverlayMark> = (1..=40)
            .map(|i| OverlayMark {
                number: i,
                region: Region::Entity(i as u16),
            })
            .collect();
        marks.extend((41..=120).map(|number| OverlayMark {
            number,
            region: Region::Rectangle([600, 470, 639, 479]),
        }));
        let frame = frame_with(&squares);
        let labels = labels(&frame, &marks);
        assert_eq!(labels.len(), 120);
        assert_apart_and_inside(&labels);
    }

    #[test]
    fn a_label_sits_on_its_mask_where_there_is_room() {
        // An L: its centroid lies outside of it.
        let frame = frame_with(&[(5, [100, 100, 150, 400]), (5, [100, 350, 400, 400])]);
        let label = &labels(
            &frame,
            &[OverlayMark {
                number: 12,
                region: Region::Entity(5),
            }],
        )[0];
        for (x, y) in [
            (label.left, label.top),
            (label.left + label.width - 1, label.top + LABEL_HEIGHT - 1),
        ] {
            assert_eq!(frame.ids[y as usize * FRAME_WIDTH + x as usize], 5);
        }
        assert!(label.target.is_none());
    }

    #[test]
    fn overlay_colours_the_mask_only_and_keeps_ids_and_depth() {
        let before = frame_with(&[(7, [200, 200, 299, 299])]);
        let mut after = before.clone();
        overlay(
            &mut after,
            &[
                OverlayMark {
                    number: 1,
                    region: Region::Entity(7),
                },
                OverlayMark {
                    number: 2,
                    region: Region::Entity(9),
                },
            ],
        );
        let [drawn] = &after.marker_boxes[..] else {
            panic!("{:?}", after.marker_boxes);
        };
        assert_eq!((drawn.id, drawn.bbox), (1, [200, 200, 299, 299]));
        let [left, top, right, bottom] = drawn.label;
        assert!(
            200 <= left
                && left < right
                && right <= 299
                && 200 <= top
                && top < bottom
                && bottom <= 299
        );
        assert_eq!(
            (&after.ids, &after.depth_mm),
            (&before.ids, &before.depth_mm)
        );
        let changed = |x: usize, y: usize| after.rgb[(y * FRAME_WIDTH + x) * 3..][..3] != [0; 3];
        assert!(changed(200, 200) && changed(210, 290));
        assert!(
            !changed(199, 200) && !changed(300, 250),
            "the mark of an entity out of sight draws nothing"
        );
    }

    #[test]
    fn strange_rectangles_are_clipped() {
        let mut frame = Frame::new();
        let wild = [
            [u16::MAX; 4],
            [9, 9, 3, 3],
            [0, 0, 0, 0],
            [0, 0, u16::MAX, u16::MAX],
        ];
        let marks: Vec<OverlayMark> = wild
            .iter()
            .map(|&r| OverlayMark {
                number: u32::MAX,
                region: Region::Rectangle(r),
            })
            .collect();
        overlay(&mut frame, &marks);
        assert_apart_and_inside(&labels(&frame, &marks));
    }
}
