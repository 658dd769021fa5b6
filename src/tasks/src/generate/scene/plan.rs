//! The floor plan of a scene: rooms, walls, furniture with names, how doors swing, the robot's
//! start and a scale. As SVG, or as PNG by `plan_png`. Labels keep clear of each other.

use std::collections::BTreeSet;

use reel_sim::model::{DoorMotion, Furniture, SceneModel, scene_model};
use reel_world::{Room, Scene, Wall};

use super::{SceneError, kinds::room_kind, plan_png};

/// Pixels to a metre.
const SCALE: f64 = 96.0;
/// Around the flat, in pixels; more at the bottom for the scale.
const MARGIN: f64 = 34.0;
const HEADER: f64 = 44.0;
const FOOTER: f64 = 46.0;
/// Size of a character, in pixels.
pub(super) const CHARACTER: [f64; 2] = [9.0, 18.0];
const HALF_WALL_M: f64 = 0.05;

/// 8-bit red, green, blue.
pub(super) type Colour = [u8; 3];

const PAPER: Colour = [255, 255, 255];
const INK: Colour = [28, 34, 44];
const FAINT: Colour = [120, 128, 140];
const WALL: Colour = [58, 62, 70];
const BODY: Colour = [250, 249, 245];
const EDGE: Colour = [98, 88, 74];
const DOOR: Colour = [190, 92, 36];
const ROBOT: Colour = [232, 122, 40];

/// What a plan is drawn of, in pixels from the upper left.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum Item {
    /// A filled rectangle with an outline of a width.
    Rect {
        corner: [f64; 2],
        size: [f64; 2],
        fill: Colour,
        edge: Option<(Colour, f64)>,
    },
    /// A line through points.
    Line {
        points: Vec<[f64; 2]>,
        colour: Colour,
        width: f64,
    },
    /// A filled disc without outline; centre and radius in pixels.
    Disc {
        centre: [f64; 2],
        radius: f64,
        fill: Colour,
    },
    /// A line of text around a point.
    Text(Label),
}

/// A line of text.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Label {
    pub(super) centre: [f64; 2],
    pub(super) text: String,
    pub(super) colour: Colour,
    pub(super) bold: bool,
    /// Reads from bottom to top.
    pub(super) upright: bool,
}

/// A drawn floor plan.
#[derive(Clone, PartialEq, Debug)]
pub struct Plan {
    pub(super) size: [f64; 2],
    pub(super) items: Vec<Item>,
    crossings: usize,
}

/// A rectangle in pixels: upper left and lower right.
type Area = [[f64; 2]; 2];

impl Plan {
    /// Draws the plan of a scene.
    pub fn of(scene: &Scene) -> Self {
        let model = scene_model(scene, &BTreeSet::new());
        Draft::new(scene, &model).draw()
    }

    /// How many labels found no place of their own.
    pub fn crossings(&self) -> usize {
        self.crossings
    }

    /// As an SVG document.
    pub fn svg(&self) -> String {
        let [width, height] = self.size;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"monospace\" font-size=\"15\">\n"
        );
        for item in &self.items {
            svg.push_str(&element(item));
            svg.push('\n');
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// As a PNG file.
    ///
    /// # Errors
    /// When the image is too large.
    pub fn png(&self) -> Result<Vec<u8>, SceneError> {
        plan_png::draw(self)
    }
}

/// A plan under way.
struct Draft<'a> {
    scene: &'a Scene,
    model: &'a SceneModel,
    /// The scene's upper left corner.
    origin: [f64; 2],
    size: [f64; 2],
    items: Vec<Item>,
    /// What labels must not cover.
    taken: Vec<Area>,
    crossings: usize,
}

impl<'a> Draft<'a> {
    fn new(scene: &'a Scene, model: &'a SceneModel) -> Self {
        let [low, high] = model.bounds.map(|corner| corner.map(f64::from));
        let size = [
            ((high[0] - low[0]) * SCALE + 2.0 * MARGIN).max(420.0),
            (high[1] - low[1]) * SCALE + 2.0 * MARGIN + HEADER + FOOTER,
        ];
        Self {
            scene,
            model,
            origin: [low[0], high[1]],
            size,
            items: Vec::new(),
            taken: Vec::new(),
            crossings: 0,
        }
    }

    fn draw(mut self) -> Plan {
        self.items.push(Item::Rect {
            corner: [0.0; 2],
            size: self.size,
            fill: PAPER,
            edge: None,
        });
        self.rooms();
        self.walls();
        let is_piece = |piece: &&Furniture| piece.part_of.is_none();
        for piece in self.model.furniture.iter().filter(is_piece) {
            self.piece(piece);
        }
        for piece in &self.model.furniture {
            self.swing(piece);
        }
        self.robot();
        let pieces = self.model.furniture.iter().enumerate();
        let pieces: Vec<usize> = pieces
            .filter(|(_, piece)| is_piece(piece))
            .map(|(index, _)| index)
            .collect();
        for index in pieces {
            self.name(index);
        }
        self.room_names();
        self.title_and_scale();
        Plan {
            size: self.size,
            items: self.items,
            crossings: self.crossings,
        }
    }

    /// A point of the scene in pixels.
    fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            MARGIN + (x - self.origin[0]) * SCALE,
            MARGIN + HEADER + (self.origin[1] - y) * SCALE,
        ]
    }

    /// A rectangle of the scene in pixels.
    fn area(&self, low: [f64; 2], high: [f64; 2]) -> Area {
        [self.point([low[0], high[1]]), self.point([high[0], low[1]])]
    }

    fn rect(&mut self, [from, to]: Area, fill: Colour, edge: Option<(Colour, f64)>) {
        self.items.push(Item::Rect {
            corner: from,
            size: [to[0] - from[0], to[1] - from[1]],
            fill,
            edge,
        });
    }

    fn rooms(&mut self) {
        for room in &self.scene.rooms {
            for rect in room.footprint() {
                self.rect(self.area(rect.min, rect.max), floor(&room.name), None);
            }
        }
    }

    fn walls(&mut self) {
        let walls = &self.model.walls;
        for wall in walls {
            let along = usize::from(wall.from[0] == wall.to[0]);
            let end = |pick: fn(f64, f64) -> f64, out: f64| {
                [0, 1].map(|axis| {
                    pick(wall.from[axis], wall.to[axis]) + if axis == along { 0.0 } else { out }
                })
            };
            let (low, high) = (end(f64::min, -HALF_WALL_M), end(f64::max, HALF_WALL_M));
            let area = self.area(low, high);
            self.rect(area, WALL, None);
            self.taken.push(area);
            // Corners: what both walls leave open between them.
            for other in walls
                .iter()
                .filter(|other| usize::from(other.from[0] == other.to[0]) != along && along == 0)
            {
                let corner = [other.from[0], wall.from[1]];
                let near = |wall: &Wall| {
                    (0..2).all(|axis| {
                        let (from, to) = (
                            wall.from[axis].min(wall.to[axis]),
                            wall.from[axis].max(wall.to[axis]),
                        );
                        (from - 0.06..=to + 0.06).contains(&corner[axis])
                    })
                };
                if near(wall) && near(other) {
                    let area = self.area(
                        corner.map(|value| value - HALF_WALL_M),
                        corner.map(|value| value + HALF_WALL_M),
                    );
                    self.rect(area, WALL, None);
                }
            }
        }
    }

    fn piece(&mut self, piece: &Furniture) {
        let [low, high] = piece.bounds.map(|[x, y, _]| [f64::from(x), f64::from(y)]);
        let area = self.area(low, high);
        self.rect(area, BODY, Some((EDGE, 1.5)));
        let surface = self.area(
            piece.surface.min.map(f64::from),
            piece.surface.max.map(f64::from),
        );
        self.rect(surface, [240, 232, 214], Some(([190, 178, 154], 1.0)));
        // The front has a heavy edge.
        let [fx, fy] = piece.facing.map(|value| f64::from(value).round());
        let ends = if fx != 0.0 {
            let x = if fx > 0.0 { high[0] } else { low[0] };
            [[x, low[1]], [x, high[1]]]
        } else {
            let y = if fy > 0.0 { high[1] } else { low[1] };
            [[low[0], y], [high[0], y]]
        };
        let points = ends.iter().map(|end| self.point(*end)).collect();
        self.items.push(Item::Line {
            points,
            colour: EDGE,
            width: 3.5,
        });
        self.taken.push(area);
    }

    fn swing(&mut self, piece: &Furniture) {
        let Some(door) = &piece.door else { return };
        if let DoorMotion::Slide(_) = door.motion {
            self.slide(piece);
            return;
        }
        let Some(panel) = door.parts.iter().find(|part| part.solid) else {
            return;
        };
        let end = 2.0 * panel.pose.position[1];
        let at = |share: f32, reach: f32| {
            let [x, y, _] = door.opened(share).apply([0.0, end * reach, 0.0]);
            [f64::from(x), f64::from(y)]
        };
        let arc: Vec<[f64; 2]> = (0..=16)
            .map(|step| self.point(at(step as f32 / 16.0, 1.0)))
            .collect();
        let leaf = vec![self.point(at(1.0, 0.0)), self.point(at(1.0, 1.0))];
        let [low, high] = bounds(arc.iter().chain(&leaf));
        self.taken.push([low, high]);
        self.items.push(Item::Line {
            points: arc,
            colour: DOOR,
            width: 1.0,
        });
        self.items.push(Item::Line {
            points: leaf,
            colour: DOOR,
            width: 2.5,
        });
    }

    /// The outline of an open drawer.
    fn slide(&mut self, piece: &Furniture) {
        let surface = piece.open_surface();
        let ([x0, y0], [x1, y1]) = (surface.min, surface.max);
        let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]];
        let points: Vec<[f64; 2]> = corners
            .into_iter()
            .map(|corner| self.point(corner.map(f64::from)))
            .collect();
        let [low, high] = bounds(points.iter());
        self.taken.push([low, high]);
        self.items.push(Item::Line {
            points,
            colour: DOOR,
            width: 1.0,
        });
    }

    fn robot(&mut self) {
        let Some([x, y, yaw]) = self.scene.robot_start else {
            return;
        };
        let centre = self.point([x, y]);
        let radius = 0.2 * SCALE;
        let tip = [
            centre[0] + yaw.cos() * radius * 1.7,
            centre[1] - yaw.sin() * radius * 1.7,
        ];
        self.items.push(Item::Disc {
            centre,
            radius,
            fill: ROBOT,
        });
        self.items.push(Item::Line {
            points: vec![centre, tip],
            colour: INK,
            width: 3.0,
        });
        let reach = radius * 1.8;
        self.taken.push([
            centre.map(|value| value - reach),
            centre.map(|value| value + reach),
        ]);
    }

    /// Writes a receptacle's name into it, else beside it.
    fn name(&mut self, index: usize) {
        let (piece, receptacle) = (&self.model.furniture[index], &self.scene.receptacles[index]);
        let text = receptacle.id.to_string();
        let [low, high] = piece.bounds.map(|[x, y, _]| [f64::from(x), f64::from(y)]);
        let [from, to] = self.area(low, high);
        let middle = [(from[0] + to[0]) * 0.5, (from[1] + to[1]) * 0.5];
        let (width, height) = (text.len() as f64 * CHARACTER[0] + 4.0, CHARACTER[1]);
        let (wide, tall) = (to[0] - from[0], to[1] - from[1]);
        if width <= wide && height <= tall {
            return self.label(middle, text, INK, false, false);
        }
        if width <= tall && height <= wide {
            return self.label(middle, text, INK, false, true);
        }
        let mut places = Vec::new();
        for off in [3.0, 12.0, 24.0, 40.0, 60.0] {
            for shift in [0.0, -0.2, 0.2, -0.35, 0.35, -0.5, 0.5] {
                let x = middle[0] + shift * width;
                let y = middle[1] + shift * width;
                places.push(([x, from[1] - off - height * 0.5], false));
                places.push(([x, to[1] + off + height * 0.5], false));
                places.push(([to[0] + off + height * 0.5, y], true));
                places.push(([from[0] - off - height * 0.5, y], true));
            }
        }
        let room = self
            .scene
            .rooms
            .iter()
            .find(|room| room.name == receptacle.room);
        let is_free = |(centre, upright): &&([f64; 2], bool)| {
            let area = text_area(*centre, text.len(), *upright);
            self.is_free(area) && room.is_none_or(|room| self.is_in(room, area))
        };
        let free = places.iter().find(is_free).copied();
        self.crossings += usize::from(free.is_none());
        let (centre, upright) = free.unwrap_or((middle, false));
        self.label(centre, text, INK, false, upright);
    }

    fn room_names(&mut self) {
        for room in &self.scene.rooms {
            let text = room.name.strip_suffix("/0").filter(|kind| {
                self.scene
                    .rooms
                    .iter()
                    .filter(|other| other.name.split('/').next() == Some(*kind))
                    .count()
                    == 1
            });
            let text = text.unwrap_or(&room.name).to_owned();
            let mut best: Option<(f64, [f64; 2], bool)> = None;
            for rect in room.footprint() {
                let [from, to] = self.area(rect.min, rect.max);
                let middle = [(from[0] + to[0]) * 0.5, (from[1] + to[1]) * 0.5];
                for upright in [false, true] {
                    for column in 1..40 {
                        for row in 1..40 {
                            let share = [f64::from(column) / 40.0, f64::from(row) / 40.0];
                            let centre = [0, 1]
                                .map(|axis| from[axis] + (to[axis] - from[axis]) * share[axis]);
                            let off = (centre[0] - middle[0]).abs() + (centre[1] - middle[1]).abs();
                            let off = off + if upright { 1000.0 } else { 0.0 };
                            if best.is_none_or(|(least, _, _)| off < least)
                                && self.is_free(text_area(centre, text.len(), upright))
                            {
                                best = Some((off, centre, upright));
                            }
                        }
                    }
                }
            }
            self.crossings += usize::from(best.is_none());
            if let Some((_, centre, upright)) = best {
                self.label(centre, text, FAINT, true, upright);
            }
        }
    }

    fn title_and_scale(&mut self) {
        let scene = self.scene;
        let text = format!(
            "{}   {} rooms, {} receptacles",
            scene.scene_id,
            scene.rooms.len(),
            scene.receptacles.len()
        );
        let x = MARGIN + text.len() as f64 * CHARACTER[0] * 0.5;
        self.label([x, 28.0], text, INK, true, false);
        let y = self.size[1] - 26.0;
        let points = vec![
            [MARGIN, y - 5.0],
            [MARGIN, y],
            [MARGIN + 2.0 * SCALE, y],
            [MARGIN + 2.0 * SCALE, y - 5.0],
        ];
        self.items.push(Item::Line {
            points,
            colour: INK,
            width: 2.0,
        });
        self.label(
            [MARGIN + SCALE, y - 12.0],
            "2 m".to_owned(),
            INK,
            false,
            false,
        );
        let centre = [MARGIN + 2.0 * SCALE + 44.0, y - 6.0];
        self.items.push(Item::Disc {
            centre,
            radius: 9.0,
            fill: ROBOT,
        });
        self.label(
            [centre[0] + 64.0, centre[1]],
            "robot start".to_owned(),
            INK,
            false,
            false,
        );
    }

    /// Whether an area lies in a room.
    fn is_in(&self, room: &Room, [low, high]: Area) -> bool {
        let holds =
            |[from, to]: Area| (0..2).all(|axis| from[axis] <= low[axis] && high[axis] <= to[axis]);
        room.footprint()
            .iter()
            .any(|rect| holds(self.area(rect.min, rect.max)))
    }

    fn is_free(&self, [low, high]: Area) -> bool {
        let inside = (0..2).all(|axis| low[axis] > 2.0 && high[axis] < self.size[axis] - 2.0);
        inside
            && !self.taken.iter().any(|[from, to]| {
                (0..2).all(|axis| low[axis] < to[axis] && from[axis] < high[axis])
            })
    }

    fn label(&mut self, centre: [f64; 2], text: String, colour: Colour, bold: bool, upright: bool) {
        self.taken.push(text_area(centre, text.len(), upright));
        self.items.push(Item::Text(Label {
            centre,
            text,
            colour,
            bold,
            upright,
        }));
    }
}

/// What a line of text covers.
fn text_area([x, y]: [f64; 2], length: usize, upright: bool) -> Area {
    let long = length as f64 * CHARACTER[0] * 0.5 + 1.0;
    let high = CHARACTER[1] * 0.5;
    let half = if upright { [high, long] } else { [long, high] };
    [[x - half[0], y - half[1]], [x + half[0], y + half[1]]]
}

fn bounds<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Area {
    points.fold([[f64::MAX; 2], [f64::MIN; 2]], |[low, high], point| {
        [
            [low[0].min(point[0]), low[1].min(point[1])],
            [high[0].max(point[0]), high[1].max(point[1])],
        ]
    })
}

/// The colour of a room's floor.
fn floor(room: &str) -> Colour {
    match room_kind(room).map(|(kind, _)| kind) {
        Some("living room") => [238, 226, 206],
        Some("dining room") => [240, 220, 200],
        Some("bedroom") => [222, 228, 242],
        Some("kitchen") => [232, 236, 220],
        Some("toilet" | "bathroom" | "washroom") => [214, 234, 238],
        Some("study room") => [232, 222, 238],
        Some("balcony") => [220, 236, 216],
        _ => [234, 234, 232],
    }
}

fn element(item: &Item) -> String {
    let hex = |[red, green, blue]: Colour| format!("#{red:02x}{green:02x}{blue:02x}");
    match item {
        Item::Rect {
            corner: [x, y],
            size: [width, height],
            fill,
            edge,
        } => {
            let edge = edge.map_or_else(String::new, |(colour, wide)| {
                format!(" stroke=\"{}\" stroke-width=\"{wide}\"", hex(colour))
            });
            let fill = hex(*fill);
            format!(
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\"{edge}/>"
            )
        }
        Item::Line {
            points,
            colour,
            width,
        } => {
            let points: Vec<String> = points
                .iter()
                .map(|[x, y]| format!("{x:.1},{y:.1}"))
                .collect();
            let (points, colour) = (points.join(" "), hex(*colour));
            format!(
                "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
            )
        }
        Item::Disc {
            centre: [x, y],
            radius,
            fill,
        } => {
            format!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"{}\"/>",
                hex(*fill)
            )
        }
        Item::Text(Label {
            centre: [x, y],
            text,
            colour,
            bold,
            upright,
        }) => {
            let turn = if *upright {
                format!(" transform=\"rotate(-90 {x:.1} {y:.1})\"")
            } else {
                String::new()
            };
            let weight = if *bold { " font-weight=\"bold\"" } else { "" };
            // The length is given, so that no viewer's font makes names cover each other.
            let length = text.len() as f64 * CHARACTER[0];
            let text = text.replace('&', "&amp;").replace('<', "&lt;");
            format!(
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" textLength=\"{length:.0}\" fill=\"{}\"{weight}{turn}>{text}</text>",
                y + 5.0,
                hex(*colour)
            )
        }
    }
}
