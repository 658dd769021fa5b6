//! Household objects: which form a category has, and the solid core of that form.
//!
//! The frame is the centre of the object's box. Solid parts stay within the box and stand on its
//! bottom with a base that does not roll: what is long and round gets a flat core below a rounded
//! look. Details are in [`super::details`].

use reel_world::ObjectInstance;

use super::{
    ObjectModel, details,
    looks::{Paint, object_paint, pick, words},
    parts::{Axis, Frame, Parts, ball, capsule, cuboid, pillar, rod},
};

/// Things flatter than this are taken to be as thick: half of it, in metres.
const LEAST_HALF_M: f32 = 0.0005;

/// What an object is shaped like.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Form {
    Round,
    Leafy,
    Long,
    Banana,
    Dish,
    Cup,
    Can,
    Bottle,
    Pan,
    Book,
    Laptop,
    Tray,
    Panel,
    Clock,
    Figure,
    Cake,
    Hourglass,
    Headphones,
    Watch,
    Machine,
    Roll,
    Box,
}

/// An object being built: half extents of its box, paint, and what is said of it.
pub(super) struct Item {
    pub(super) half: [f32; 3],
    pub(super) paint: Paint,
    pub(super) words: Vec<String>,
    pub(super) id: String,
}

/// Builds an object around the centre of its box.
pub(super) fn build(object: &ObjectInstance) -> ObjectModel {
    let half = object
        .size
        .map(|side| (side as f32 * 0.5).max(LEAST_HALF_M));
    let category = words(&object.category);
    let mut said = category.clone();
    said.extend(words(object.caption.as_deref().unwrap_or_default()));
    said.extend(
        object
            .attributes
            .values()
            .flatten()
            .flat_map(|value| words(value)),
    );
    let tiny = half.iter().all(|side| *side < 0.005);
    let form = if tiny {
        Form::Box
    } else {
        form_of(&category).unwrap_or_else(|| form_of_words(&said))
    };
    let item = Item {
        half,
        paint: object_paint(object),
        words: said,
        id: object.asset.to_string(),
    };
    let mut parts = Parts::new(Frame::OUTER);
    item.build(form, &mut parts);
    ObjectModel {
        parts: parts.finish(),
        mesh: None,
        half,
        density: density(form, &item),
    }
}

/// The form of a category; its last words decide (a `coffee mug` is a mug, an
/// `alarm clock` a clock).
fn form_of(category: &[String]) -> Option<Form> {
    category.iter().rev().find_map(|word| {
        let word = word.as_str();
        form_of_noun(word)
            .or_else(|| form_of_noun(word.strip_suffix('s')?))
            .or_else(|| form_of_noun(word.strip_suffix("es")?))
    })
}

fn form_of_noun(word: &str) -> Option<Form> {
    Some(match word {
        "apple" | "orange" | "ball" | "tomato" | "lemon" | "lime" | "peach" | "plum" | "pear"
        | "egg" | "onion" | "potato" | "nut" | "peanut" | "fruit" | "avocado" | "mango"
        | "kiwi" | "pepper" | "vegetable" | "bun" | "bread" | "food" | "sushi" | "meat"
        | "globe" | "mouse" | "strawberry" | "eggplant" | "pumpkin" | "loaf" | "croissant" => {
            Form::Round
        }
        "broccoli" | "lettuce" | "cabbage" | "cauliflower" | "plant" | "cactus" | "flower" => {
            Form::Leafy
        }
        "pen" | "pencil" | "stylus" | "marker" | "crayon" | "toothbrush" | "spoon" | "fork"
        | "knife" | "carrot" | "cucumber" | "candle" | "brush" | "screwdriver" | "flashlight"
        | "spatula" | "whisk" | "lipstick" | "chopstick" => Form::Long,
        "banana" => Form::Banana,
        "bowl" | "plate" | "saucer" | "dish" | "soup" | "basket" | "ashtray" | "coaster" => {
            Form::Dish
        }
        "cup" | "mug" | "teacup" | "glass" | "tumbler" | "jug" | "pitcher" | "kettle"
        | "teapot" => Form::Cup,
        "can" | "jar" | "tin" | "container" | "vase" | "canister" | "pot" | "drum" | "speaker"
        | "bucket" => Form::Can,
        "bottle" | "dispenser" | "spray" | "soap" | "wash" | "shampoo" | "lotion" | "thermos"
        | "flask" | "ketchup" | "detergent" => Form::Bottle,
        "pan" | "skillet" | "wok" => Form::Pan,
        "book" | "notebook" | "notepad" | "binder" | "magazine" | "diary" | "planner"
        | "folder" | "envelope" => Form::Book,
        "laptop" => Form::Laptop,
        "tray" => Form::Tray,
        "remote" | "control" | "calculator" | "keyboard" | "phone" | "tablet" | "smartphone"
        | "frame" | "picture" | "controller" => Form::Panel,
        "clock" | "timer" => Form::Clock,
        "bear" | "figurine" | "figure" | "doll" | "statue" | "toy" | "plush" | "sculpture" => {
            Form::Figure
        }
        "cake" | "pie" | "muffin" | "cookie" | "dessert" | "pizza" | "cream" | "cupcake"
        | "donut" => Form::Cake,
        "hourglass" => Form::Hourglass,
        "headphone" | "headset" => Form::Headphones,
        "watch" | "wristwatch" => Form::Watch,
        "maker" | "blender" | "toaster" | "mixer" | "printer" => Form::Machine,
        "roll" | "towel" => Form::Roll,
        "box" | "carton" | "package" | "sponge" | "block" | "case" => Form::Box,
        _ => return None,
    })
}

/// The form that a caption speaks of, for categories we do not know.
fn form_of_words(said: &[String]) -> Form {
    let any = |list: &[&str]| said.iter().any(|word| list.contains(&word.as_str()));
    if any(&["figurine", "statue", "plush"]) {
        Form::Figure
    } else if any(&["bottle", "pump"]) {
        Form::Bottle
    } else if any(&["spherical", "sphere", "ball"]) {
        Form::Round
    } else if any(&["bowl", "plate", "shallow"]) {
        Form::Dish
    } else if any(&["cylindrical", "cylinder", "circular"]) {
        Form::Can
    } else if any(&["book", "hardcover", "pages"]) {
        Form::Book
    } else {
        Form::Box
    }
}

fn density(form: Form, item: &Item) -> f32 {
    if item.says(&["metal", "metallic", "steel", "brass", "iron", "copper"]) {
        800.0
    } else if item.says(&["glass", "ceramic", "porcelain", "stone", "clay", "marble"]) {
        700.0
    } else if item.says(&["plush", "fabric", "soft", "woven", "fur"]) || form == Form::Roll {
        300.0
    } else if item.says(&["wood", "wooden", "paper", "cardboard"]) || form == Form::Book {
        550.0
    } else {
        450.0
    }
}

impl Item {
    /// Whether any of the words is said of it.
    pub(super) fn says(&self, any: &[&str]) -> bool {
        self.words.iter().any(|word| any.contains(&word.as_str()))
    }

    /// A stable number below `count`.
    pub(super) fn choose(&self, purpose: &str, count: usize) -> usize {
        pick(&self.id, purpose, count)
    }

    /// The axis of the largest and of the smallest extent.
    pub(super) fn longest(&self) -> usize {
        let [x, y, z] = self.half;
        if z >= x && z >= y {
            2
        } else {
            usize::from(y > x)
        }
    }

    /// The axis of the smallest extent; z of equals.
    pub(super) fn flattest(&self) -> usize {
        let [x, y, z] = self.half;
        if z <= x && z <= y {
            2
        } else {
            usize::from(y < x)
        }
    }

    /// The longer horizontal axis.
    pub(super) fn lengthwise(&self) -> usize {
        usize::from(self.half[1] > self.half[0])
    }

    /// Whether it is about as wide as deep, so that a standing cylinder fills it.
    fn is_round_from_above(&self) -> bool {
        let [x, y, _] = self.half;
        (x - y).abs() <= 0.3 * x.max(y)
    }

    fn build(&self, form: Form, parts: &mut Parts) {
        match form {
            Form::Round => self.round(parts),
            Form::Leafy => self.leafy(parts),
            Form::Long => self.long(parts),
            Form::Banana => self.banana(parts),
            Form::Dish | Form::Can | Form::Cake | Form::Roll => self.upright(form, parts),
            Form::Cup | Form::Pan => self.with_handle(form, parts),
            Form::Bottle => self.bottle(parts),
            Form::Hourglass => self.hourglass(parts),
            Form::Clock => self.clock(parts),
            Form::Figure => self.figure(parts),
            Form::Laptop => self.laptop(parts),
            Form::Machine => self.machine(parts),
            Form::Headphones => self.headphones(parts),
            Form::Book | Form::Tray | Form::Panel | Form::Watch | Form::Box => {
                parts.solid(cuboid([0.0; 3], self.half), self.paint);
                match form {
                    Form::Book => details::book(self, parts),
                    Form::Tray => details::tray(self, parts),
                    Form::Panel => details::buttons(self, parts),
                    Form::Watch => details::watch(self, parts),
                    _ => details::label(self, parts),
                }
            }
        }
    }

    /// A flat core that stands on the bottom: shares of the half extents and of the height.
    fn core(&self, [x, y, z]: [f32; 3], paint: Paint, parts: &mut Parts) {
        let half = [self.half[0] * x, self.half[1] * y, self.half[2] * z]
            .map(|side| side.max(LEAST_HALF_M));
        let half = [0, 1, 2].map(|axis| half[axis].min(self.half[axis]));
        parts.solid(cuboid([0.0, 0.0, half[2] - self.half[2]], half), paint);
    }

    fn round(&self, parts: &mut Parts) {
        let [x, y, z] = self.half;
        let (least, most) = (x.min(y).min(z), x.max(y).max(z));
        if most <= least * 1.12 {
            parts.solid(ball([0.0, 0.0, least - z], least), self.paint);
            details::stem(self, least * 2.0 - z, parts);
            return;
        }
        self.core([0.6, 0.6, 0.8], self.paint, parts);
        let axis = self.longest();
        let radius = (0..3)
            .filter(|other| *other != axis)
            .map(|other| self.half[other])
            .fold(f32::MAX, f32::min);
        parts.look(
            capsule(Axis::of(axis), [0.0; 3], self.half[axis], radius),
            self.paint,
        );
        // Wider than high: more flesh to both sides.
        let wide = (0..2)
            .filter(|other| *other != axis)
            .map(|other| (other, self.half[other] - radius));
        for (other, rest) in wide.filter(|(_, rest)| *rest > radius * 0.12) {
            for side in [-1.0, 1.0] {
                let mut center = [0.0; 3];
                center[other] = rest * side;
                let length = (self.half[axis] * 0.8).max(radius * 1.01);
                parts.look(capsule(Axis::of(axis), center, length, radius), self.paint);
            }
        }
        details::stem(self, z, parts);
    }

    fn leafy(&self, parts: &mut Parts) {
        let [x, y, z] = self.half;
        self.core([0.55, 0.55, 0.75], self.paint.shaded(0.8), parts);
        let radius = x.min(y).min(z) * 0.62;
        for (index, [a, b, c]) in [
            [0.0, 0.0, 1.0],
            [1.0, 0.4, 0.3],
            [-0.6, 0.9, 0.2],
            [-0.9, -0.6, 0.3],
            [0.5, -0.9, 0.2],
        ]
        .into_iter()
        .enumerate()
        {
            let paint = self.paint.shaded([1.1, 0.95, 1.04, 0.9, 1.0][index]);
            parts.look(
                ball(
                    [a * (x - radius), b * (y - radius), c * (z - radius)],
                    radius,
                ),
                paint,
            );
        }
        if self.says(&["pot", "broccoli"]) {
            parts.look(
                pillar([0.0; 2], -z, -z * 0.3, x.min(y) * 0.6),
                self.paint.second(),
            );
        }
    }

    fn long(&self, parts: &mut Parts) {
        if self.longest() == 2 {
            self.core([0.75, 0.75, 1.0], self.paint, parts);
            let radius = self.half[0].min(self.half[1]);
            parts.look(
                pillar([0.0; 2], -self.half[2], self.half[2] * 0.9, radius),
                self.paint,
            );
        } else {
            let axis = self.lengthwise();
            let radius = self.half[1 - axis].min(self.half[2]);
            self.flat_rod(axis, 0.96, radius, parts);
            parts.look(
                rod(Axis::of(axis), [0.0; 3], self.half[axis] * 0.9, radius),
                self.paint,
            );
        }
        details::tip(self, parts);
    }

    /// A box along a horizontal axis that hides in a rod of a radius and stands on the bottom.
    fn flat_rod(&self, axis: usize, share: f32, radius: f32, parts: &mut Parts) {
        let mut shares = [share, share, 0.85];
        shares[1 - axis] = (radius * 0.72 / self.half[1 - axis]).min(1.0);
        self.core(shares, self.paint, parts);
    }

    fn banana(&self, parts: &mut Parts) {
        let axis = self.lengthwise();
        let (long, wide, z) = (self.half[axis], self.half[1 - axis], self.half[2]);
        self.core([0.6, 0.6, 0.8], self.paint, parts);
        let radius = z.min(wide * 0.6);
        let count = if self.says(&["bunch"]) { 3 } else { 1 };
        for index in 0..count {
            let shift = (index as f32 - (count - 1) as f32 * 0.5) * radius * 0.8;
            for (along, across, paint) in [(-0.62, 0.5, 0.96), (0.0, -0.35, 1.0), (0.62, 0.5, 0.96)]
            {
                let mut center = [0.0; 3];
                center[axis] = along * long;
                center[1 - axis] =
                    (across * (wide - radius) + shift).clamp(radius - wide, wide - radius);
                parts.look(
                    capsule(
                        Axis::of(axis),
                        center,
                        (long * 0.38).max(radius * 1.02),
                        radius * 0.95,
                    ),
                    self.paint.shaded(paint),
                );
            }
        }
        for side in [-1.0, 1.0] {
            let mut center = [0.0; 3];
            center[axis] = side * long * 0.97;
            center[1 - axis] = 0.5 * (wide - radius);
            parts.look(ball(center, radius * 0.35), self.paint.second().shaded(0.6));
        }
    }

    /// Dishes, cans, cakes and rolls: a standing cylinder, a lying one on a flat core, or a box.
    fn upright(&self, form: Form, parts: &mut Parts) {
        let [x, y, z] = self.half;
        let radius = x.min(y);
        let folded = form == Form::Roll && !self.says(&["roll", "rolls", "cylindrical"]);
        let sliced = form == Form::Cake && self.says(&["slice", "square", "rectangular"]);
        if self.is_round_from_above() && !folded && !sliced {
            parts.solid(pillar([0.0; 2], -z, z, radius), self.paint);
            match form {
                Form::Dish => details::hollow(self, radius, parts),
                Form::Can => details::bands(self, radius, parts),
                Form::Cake => details::topping(self, radius, parts),
                _ => details::roll(self, Axis::Z, z, radius, parts),
            }
            return;
        }
        let axis = self.lengthwise();
        let lies = matches!(form, Form::Can | Form::Roll)
            && !folded
            && self.longest() == axis
            && z <= self.half[1 - axis] * 1.4;
        if lies {
            let radius = z.min(self.half[1 - axis]);
            self.flat_rod(axis, 0.99, radius, parts);
            parts.look(
                rod(Axis::of(axis), [0.0; 3], self.half[axis], radius),
                self.paint,
            );
            details::roll(self, Axis::of(axis), self.half[axis], radius, parts);
        } else {
            parts.solid(cuboid([0.0; 3], self.half), self.paint);
            details::label(self, parts);
        }
    }

    /// Cups, jugs and pans: a standing cylinder and a handle on the side where the box is longer.
    fn with_handle(&self, form: Form, parts: &mut Parts) {
        let axis = self.lengthwise();
        let (long, wide, z) = (self.half[axis], self.half[1 - axis], self.half[2]);
        if self.longest() != 2 && z < wide * 0.25 && form == Form::Cup {
            return self.upright(Form::Dish, parts);
        }
        let plain =
            form == Form::Cup && self.says(&["tumbler", "glass"]) && !self.says(&["handle"]);
        let radius = if plain { wide } else { wide.min(long * 0.84) };
        let mut center = [0.0; 2];
        center[axis] = if plain { 0.0 } else { radius - long };
        parts.solid(pillar(center, -z, z, radius), self.paint);
        parts.look(
            pillar(center, z - 0.003, z + 0.0008, radius * 0.86),
            self.paint.shaded(0.55),
        );
        let handle = 2.0 * (long - radius);
        if plain || handle < 0.004 {
            return;
        }
        // It reaches into the body, so that no gap shows.
        let reach = (handle + radius * 0.3) * 0.5;
        let mut at = [0.0; 3];
        at[axis] = long - reach;
        let mut half = [(wide * 0.14).max(0.002).min(wide); 3];
        half[axis] = reach;
        if form == Form::Pan {
            half[2] = (z * 0.25).max(LEAST_HALF_M);
            at[2] = (z * 0.5).min(z - half[2]);
            parts.solid(cuboid(at, half), Paint::plain([36, 36, 38]));
        } else {
            half[2] = (z * 0.5).max(LEAST_HALF_M);
            parts.solid(cuboid(at, half), self.paint.shaded(0.92));
            let band = (z * 0.25).max(0.001);
            parts.look(
                pillar(center, -band, band, radius + 0.0006),
                self.paint.second(),
            );
        }
    }

    fn bottle(&self, parts: &mut Parts) {
        let [x, y, z] = self.half;
        let small = x.min(y).min(z) < 0.005;
        if small || self.says(&["bar", "box"]) || (self.flattest() == 2 && z < x.min(y) * 0.3) {
            self.core([1.0, 1.0, 1.0], self.paint, parts);
            return details::label(self, parts);
        }
        let axis = self.longest();
        if axis == 2 || z > x.max(y) * 0.8 {
            let radius = x.min(y);
            let shoulder = z * 0.4;
            if self.is_round_from_above() {
                parts.solid(pillar([0.0; 2], -z, shoulder, radius), self.paint);
            } else {
                self.core([1.0, 1.0, 0.7], self.paint, parts);
            }
            parts.solid(
                pillar([0.0; 2], shoulder, z * 0.8, radius * 0.45),
                self.paint.shaded(0.95),
            );
            parts.solid(
                pillar([0.0; 2], z * 0.8, z, radius * 0.5),
                self.paint.second(),
            );
            parts.look(
                pillar([0.0; 2], -z * 0.6, z * 0.05, radius + 0.0006),
                Paint::plain([236, 234, 228]),
            );
        } else {
            let radius = self.half[1 - axis].min(z);
            self.flat_rod(axis, 0.6, radius, parts);
            let (long, along) = (self.half[axis], Axis::of(axis));
            let place = |share: f32| {
                let mut center = [0.0, 0.0, radius - z];
                center[axis] = share * long;
                center
            };
            parts.look(
                capsule(
                    along,
                    place(-0.25),
                    (long * 0.75).max(radius * 1.01),
                    radius,
                ),
                self.paint,
            );
            parts.look(
                rod(along, place(-0.3), long * 0.25, radius + 0.0006),
                Paint::plain([236, 234, 228]),
            );
            parts.look(
                rod(along, place(0.6), long * 0.25, radius * 0.45),
                self.paint.shaded(0.9),
            );
            parts.look(
                rod(along, place(0.88), long * 0.12, radius * 0.55),
                self.paint.second(),
            );
        }
    }

    fn hourglass(&self, parts: &mut Parts) {
        let axis = self.longest();
        let (long, along) = (self.half[axis], Axis::of(axis));
        let radius = (0..3)
            .filter(|other| *other != axis)
            .map(|other| self.half[other])
            .fold(f32::MAX, f32::min);
        let wood = if self.paint.pattern == crate::geometry::Pattern::Glossy {
            Paint::grain([150, 104, 62])
        } else {
            self.paint
        };
        for side in [-1.0, 1.0] {
            let mut center = [0.0; 3];
            center[axis] = side * long * 0.92;
            let mut half = [0, 1, 2].map(|other| {
                if other == axis {
                    long * 0.08
                } else {
                    self.half[other]
                }
            });
            half = half.map(|side| side.max(LEAST_HALF_M));
            parts.solid(cuboid(center, half), wood);
        }
        let mut half = self.half.map(|side| side * 0.2);
        half[axis] = long * 0.84;
        parts.solid(cuboid([0.0; 3], half), Paint::plain([222, 196, 142]));
        details::bulbs(self, along, axis, radius, parts);
    }

    fn clock(&self, parts: &mut Parts) {
        let thin = self.flattest();
        let [x, y, z] = self.half;
        let radius = (0..3)
            .filter(|other| *other != thin)
            .map(|other| self.half[other])
            .fold(f32::MAX, f32::min);
        let boxy = self.says(&["rectangular", "square", "digital"]);
        if boxy {
            parts.solid(cuboid([0.0; 3], self.half), self.paint);
        } else if thin == 2 {
            parts.solid(pillar([0.0; 2], -z, z, x.min(y)), self.paint);
        } else {
            let mut shares = [0.62, 0.62, 1.0];
            shares[thin] = 0.98;
            self.core(shares, self.paint.shaded(0.9), parts);
            parts.look(
                rod(
                    Axis::of(thin),
                    [0.0, 0.0, radius - z],
                    self.half[thin],
                    radius,
                ),
                self.paint,
            );
        }
        details::dial(self, thin, radius, boxy, parts);
    }

    fn figure(&self, parts: &mut Parts) {
        let [x, y, z] = self.half;
        let axis = if z >= x.max(y) * 0.8 {
            2
        } else {
            self.lengthwise()
        };
        let mut shares = [0.62, 0.62, 0.62];
        shares[axis] = if axis == 2 { 0.7 } else { 0.8 };
        self.core(shares, self.paint.shaded(0.94), parts);
        details::body(self, axis, parts);
    }

    fn laptop(&self, parts: &mut Parts) {
        let [x, y, z] = self.half;
        if z < 0.03 {
            parts.solid(cuboid([0.0; 3], self.half), self.paint);
            let logo = pillar([0.0; 2], z - 0.001, z + 0.0006, x.min(y) * 0.12);
            return parts.look(logo, self.paint.second());
        }
        let base = (z * 0.1).max(0.006);
        parts.solid(cuboid([0.0, 0.0, base - z], [x, y, base]), self.paint);
        let lid = (y * 0.08).max(0.004);
        parts.solid(cuboid([0.0, y - lid, base], [x, lid, z - base]), self.paint);
        parts.look(
            cuboid([0.0, -y * 0.1, 2.0 * base - z], [x * 0.86, y * 0.5, 0.001]),
            self.paint.second(),
        );
        parts.look(
            cuboid(
                [0.0, y - 2.0 * lid, base],
                [x * 0.92, 0.001, (z - base) * 0.86],
            ),
            Paint::glossy([120, 170, 210]),
        );
    }

    fn machine(&self, parts: &mut Parts) {
        let [x, y, z] = self.half;
        if z < x.max(y) * 0.6 {
            parts.solid(cuboid([0.0; 3], self.half), self.paint);
            return details::buttons(self, parts);
        }
        parts.solid(cuboid([0.0, 0.0, -z * 0.85], [x, y, z * 0.15]), self.paint);
        parts.solid(
            cuboid([0.0, y * 0.5, -z * 0.05], [x, y * 0.5, z * 0.65]),
            self.paint.shaded(0.92),
        );
        parts.solid(cuboid([0.0, 0.0, z * 0.8], [x, y, z * 0.2]), self.paint);
        parts.look(
            pillar([0.0, -y * 0.45], -z * 0.7, z * 0.1, x.min(y * 0.5) * 0.8),
            Paint::glossy([70, 60, 56]),
        );
        parts.look(
            cuboid([0.0, -y, z * 0.8], [x * 0.5, 0.001, z * 0.08]),
            self.paint.second(),
        );
    }

    fn headphones(&self, parts: &mut Parts) {
        let axis = self.lengthwise();
        let (long, wide, z) = (self.half[axis], self.half[1 - axis], self.half[2]);
        let ear = (long * 0.3).min(wide).max(LEAST_HALF_M);
        let low = (z * 0.5).max(LEAST_HALF_M);
        for side in [-1.0, 1.0] {
            let mut center = [0.0; 3];
            center[axis] = side * (long - ear);
            center[1 - axis] = wide - ear;
            parts.solid(cuboid(center, [ear, ear, z]), self.paint.shaded(0.9));
            parts.look(
                pillar([center[0], center[1]], -z, z + 0.001, ear * 0.95),
                self.paint.second(),
            );
        }
        let band = (wide * 0.12).max(0.002).min(wide);
        let mut center = [0.0, 0.0, low - z];
        center[1 - axis] = band - wide;
        let mut half = [band, band, low];
        half[axis] = long;
        parts.solid(cuboid(center, half), self.paint);
        for side in [-1.0, 1.0] {
            let mut center = [0.0, 0.0, low - z];
            center[axis] = side * (long - band.min(long));
            let mut half = [wide, wide, low];
            half[axis] = band.min(long);
            parts.solid(cuboid(center, half), self.paint);
        }
    }
}
