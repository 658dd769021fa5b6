//! Owns what is drawn where: shapes and texts of the whole image, in units that are pixels at
//! scale 1. Knows neither SVG nor PNG, so that both show the same.

use super::layout::{Layout, Node, Ribbon};
use super::palette::{Color, GOOD, INK, MUTED, PALE, UNKNOWN};
use super::text::{Style, clean, count, counted, elide, share, width};

/// The whole diagram as a list of shapes and texts to draw.
pub struct Scene {
    pub title: String,
    /// The whole content in words, for those who cannot see it.
    pub description: String,
    pub width: f64,
    pub height: f64,
    pub items: Vec<Item>,
}

/// What is drawn, in this order.
pub enum Item {
    Shape(Shape),
    Text(Text),
}

/// A path, filled or stroked.
pub struct Shape {
    pub path: Vec<Segment>,
    pub color: Color,
    /// Opacity from 0 (invisible) to 1 (opaque).
    pub opacity: f64,
    /// Width of the line; filled where there is none.
    pub stroke: Option<f64>,
    /// Exact counts, shown as a tooltip.
    pub tooltip: Option<String>,
}

/// A step of a path.
#[derive(Clone, Copy)]
pub enum Segment {
    Move([f64; 2]),
    Line([f64; 2]),
    Cubic([[f64; 2]; 3]),
    Close,
}

/// One line of text.
pub struct Text {
    pub x: f64,
    /// Middle of its capitals.
    pub y: f64,
    pub anchor: Anchor,
    pub style: Style,
    pub color: Color,
    /// Whether it has to stand out from ribbons.
    pub halo: bool,
    pub content: String,
}

/// Which point of a text lies at its `x`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

const WIDTH: f64 = 1200.0;
const MARGIN: f64 = 40.0;
const RIGHT: f64 = WIDTH - MARGIN;
const NODE_WIDTH: f64 = 14.0;
/// Left edges of the nodes of the three columns.
const COLUMNS: [f64; 3] = [176.0, 508.0, 840.0];
/// Between a node and its label.
const LABEL_GAP: f64 = 9.0;
/// Right edges of the columns of numbers beside the sub-classes.
const COUNTS: f64 = RIGHT - 68.0;
/// Between a name and what follows it in its line.
const NUMBER_GAP: f64 = 14.0;
const HEADINGS_Y: f64 = 158.0;
const CHART_Y: f64 = 184.0;
const FOOTER: f64 = 72.0;
const EMPTY_HEIGHT: f64 = 200.0;
/// Ribbons that are thinner than this at an end are less transparent.
const RIBBON_THIN: f64 = 4.0;
const RIBBON_OPACITY: f64 = 0.42;
const RIBBON_THIN_OPACITY: f64 = 0.75;

impl Scene {
    /// Draws a layout with its title and all labels.
    pub fn of(
        title: &str,
        subtitle: &str,
        layout: &Layout,
        episodes_total: u64,
        successes: u64,
    ) -> Self {
        let outcome = Outcome::of(layout, episodes_total, successes);
        let chart_height = if layout.classes.is_empty() {
            EMPTY_HEIGHT
        } else {
            layout.height
        };
        let mut scene = Self {
            title: clean(title),
            description: describe(layout, &outcome),
            width: WIDTH,
            height: (CHART_Y + chart_height + FOOTER).ceil(),
            items: Vec::new(),
        };
        scene.head(subtitle, layout, &outcome);
        if layout.classes.is_empty() {
            scene.empty_state(&outcome);
        } else {
            scene.ribbons(layout);
            scene.nodes(layout);
            scene.family_labels(layout);
            scene.class_labels(layout);
            scene.sub_class_labels(layout);
            scene.foot(layout);
        }
        scene
    }

    /// Title, subtitle, the outcome in words and as a bar of all episodes.
    fn head(&mut self, subtitle: &str, layout: &Layout, outcome: &Outcome) {
        let room = RIGHT - MARGIN;
        self.text(
            MARGIN,
            42.0,
            Style::Title,
            INK,
            elide(&self.title, Style::Title, room),
        );
        if !subtitle.trim().is_empty() {
            self.text(
                MARGIN,
                68.0,
                Style::Plain,
                MUTED,
                elide(&clean(subtitle), Style::Plain, room),
            );
        }
        self.text(
            MARGIN,
            98.0,
            Style::Strong,
            INK,
            elide(&outcome.words(), Style::Strong, room),
        );

        let of_all = |episodes: u64| room * episodes as f64 / outcome.total as f64;
        let tooltip = counted(outcome.successes, "success", "successes");
        self.rect([MARGIN, 114.0, room, 6.0], PALE, Some(tooltip));
        let mut x = MARGIN;
        let unclassified =
            (outcome.unclassified > 0).then_some((UNKNOWN, outcome.unclassified, "not classified"));
        let parts = layout
            .classes
            .iter()
            .map(|class| (class.color, class.episodes, class.name.as_str()))
            .chain(unclassified);
        for (color, episodes, name) in parts {
            let end = (x + of_all(episodes)).min(RIGHT);
            let tooltip = format!("{name}: {} of all episodes", share(episodes, outcome.total));
            self.rect([x, 114.0, end - x, 6.0], color, Some(tooltip));
            x = end;
        }
    }

    fn ribbons(&mut self, layout: &Layout) {
        for ribbon in &layout.into_classes {
            let names = [
                &layout.families[ribbon.ends[0]],
                &layout.classes[ribbon.ends[1]],
            ];
            self.ribbon(
                COLUMNS[0],
                COLUMNS[1],
                ribbon,
                tooltip(names, ribbon, layout),
            );
        }
        for ribbon in &layout.into_sub_classes {
            let names = [
                &layout.classes[ribbon.ends[0]],
                &layout.sub_classes[ribbon.ends[1]],
            ];
            let of_family: Vec<String> = ribbon
                .of_family
                .iter()
                .map(|(family, episodes)| {
                    format!("{} {}", layout.families[*family].name, count(*episodes))
                })
                .collect();
            let tooltip = format!(
                "{}: {}",
                tooltip(names, ribbon, layout),
                of_family.join(", ")
            );
            self.ribbon(COLUMNS[1], COLUMNS[2], ribbon, tooltip);
        }
    }

    fn ribbon(&mut self, left: f64, right: f64, ribbon: &Ribbon, tooltip: String) {
        let left = left + NODE_WIDTH;
        let bend = (left + right) / 2.0;
        let [from, to] = ribbon
            .spans
            .map(|span| [CHART_Y + span.y, CHART_Y + span.y + span.height]);
        let path = vec![
            Segment::Move([left, from[0]]),
            Segment::Cubic([[bend, from[0]], [bend, to[0]], [right, to[0]]]),
            Segment::Line([right, to[1]]),
            Segment::Cubic([[bend, to[1]], [bend, from[1]], [left, from[1]]]),
            Segment::Close,
        ];
        let thin = ribbon.spans.iter().any(|span| span.height < RIBBON_THIN);
        let opacity = if thin {
            RIBBON_THIN_OPACITY
        } else {
            RIBBON_OPACITY
        };
        let shape = Shape {
            path,
            color: ribbon.color,
            opacity,
            stroke: None,
            tooltip: Some(tooltip),
        };
        self.items.push(Item::Shape(shape));
    }

    fn nodes(&mut self, layout: &Layout) {
        for (x, nodes) in
            COLUMNS
                .into_iter()
                .zip([&layout.families, &layout.classes, &layout.sub_classes])
        {
            for node in nodes {
                let tooltip = format!("{}: {}", node.name, numbers(node.episodes, layout.episodes));
                self.rect(
                    [x, CHART_Y + node.y, NODE_WIDTH, node.height],
                    node.color,
                    Some(tooltip),
                );
            }
        }
    }

    fn family_labels(&mut self, layout: &Layout) {
        let x = COLUMNS[0] - LABEL_GAP;
        self.aligned(
            COLUMNS[0] + NODE_WIDTH,
            HEADINGS_Y,
            Anchor::End,
            Style::Small,
            MUTED,
            "FAMILY".to_owned(),
        );
        for family in &layout.families {
            self.two_lines(x, Anchor::End, family, layout.episodes, x - 12.0);
        }
    }

    fn class_labels(&mut self, layout: &Layout) {
        let x = COLUMNS[1] + NODE_WIDTH + LABEL_GAP;
        self.text(
            COLUMNS[1],
            HEADINGS_Y,
            Style::Small,
            MUTED,
            "CLASS".to_owned(),
        );
        for class in &layout.classes {
            self.two_lines(
                x,
                Anchor::Start,
                class,
                layout.episodes,
                COLUMNS[2] - LABEL_GAP - x,
            );
        }
    }

    /// A table: names at the left, numbers under each other at the right.
    fn sub_class_labels(&mut self, layout: &Layout) {
        let x = COLUMNS[2] + NODE_WIDTH + LABEL_GAP;
        self.text(
            COLUMNS[2],
            HEADINGS_Y,
            Style::Small,
            MUTED,
            "SUB-CLASS".to_owned(),
        );
        self.aligned(
            COUNTS,
            HEADINGS_Y,
            Anchor::End,
            Style::Small,
            MUTED,
            "EPISODES".to_owned(),
        );
        self.aligned(
            RIGHT,
            HEADINGS_Y,
            Anchor::End,
            Style::Small,
            MUTED,
            "SHARE".to_owned(),
        );
        for sub_class in &layout.sub_classes {
            let y = CHART_Y + sub_class.middle();
            let number = count(sub_class.episodes);
            let room = COUNTS - width(&number, Style::Plain) - NUMBER_GAP - x;
            self.text(
                x,
                y,
                Style::Plain,
                INK,
                elide(&spaced(&sub_class.name), Style::Plain, room),
            );
            self.aligned(COUNTS, y, Anchor::End, Style::Plain, INK, number);
            self.aligned(
                RIGHT,
                y,
                Anchor::End,
                Style::Plain,
                MUTED,
                share(sub_class.episodes, layout.episodes),
            );
        }
    }

    fn foot(&mut self, layout: &Layout) {
        let y = self.height - 30.0;
        let note = format!(
            "Shares are of the {}; widths are in proportion, but for what would be too thin to see.",
            counted(layout.episodes, "classified failure", "classified failures")
        );
        self.text(
            MARGIN,
            y,
            Style::Small,
            MUTED,
            elide(&note, Style::Small, RIGHT - MARGIN),
        );
    }

    /// What is drawn where there is nothing to draw: a mark, and in words why.
    fn empty_state(&mut self, outcome: &Outcome) {
        let (x, y) = (WIDTH / 2.0, CHART_Y + 62.0);
        let (color, headline, note, mark) = if outcome.unclassified > 0 {
            (
                UNKNOWN,
                "No classified failures",
                "The failures of these episodes have no class yet.",
                [[-12.0, 0.0], [0.0, 0.0], [12.0, 0.0]],
            )
        } else if outcome.successes > 0 {
            (
                GOOD,
                "No failures",
                "Every episode reached its goal.",
                [[-12.0, 1.0], [-3.0, 10.0], [13.0, -9.0]],
            )
        } else {
            (
                UNKNOWN,
                "No failures",
                "There are no episodes here.",
                [[-12.0, 0.0], [0.0, 0.0], [12.0, 0.0]],
            )
        };
        self.items.push(Item::Shape(Shape {
            path: circle(x, y, 30.0),
            color,
            opacity: 0.14,
            stroke: None,
            tooltip: None,
        }));
        let [first, second, third] = mark.map(|[dx, dy]| [x + dx, y + dy]);
        let path = vec![
            Segment::Move(first),
            Segment::Line(second),
            Segment::Line(third),
        ];
        self.items.push(Item::Shape(Shape {
            path,
            color,
            opacity: 1.0,
            stroke: Some(4.0),
            tooltip: None,
        }));
        self.aligned(
            x,
            y + 62.0,
            Anchor::Middle,
            Style::Title,
            INK,
            headline.to_owned(),
        );
        self.aligned(
            x,
            y + 88.0,
            Anchor::Middle,
            Style::Plain,
            MUTED,
            note.to_owned(),
        );
    }

    /// A name and under it its count and share.
    fn two_lines(&mut self, x: f64, anchor: Anchor, node: &Node, episodes: u64, room: f64) {
        let y = CHART_Y + node.middle();
        let numbers = format!(
            "{} ({})",
            count(node.episodes),
            share(node.episodes, episodes)
        );
        let halo = anchor == Anchor::Start;
        for (y, style, color, content) in [
            (y - 9.0, Style::Strong, INK, spaced(&node.name)),
            (
                y + 9.0,
                Style::Plain,
                if halo { INK } else { MUTED },
                numbers,
            ),
        ] {
            self.items.push(Item::Text(Text {
                x,
                y,
                anchor,
                style,
                color,
                halo,
                content: elide(&content, style, room),
            }));
        }
    }

    fn text(&mut self, x: f64, y: f64, style: Style, color: Color, content: String) {
        self.aligned(x, y, Anchor::Start, style, color, content);
    }

    fn aligned(
        &mut self,
        x: f64,
        y: f64,
        anchor: Anchor,
        style: Style,
        color: Color,
        content: String,
    ) {
        self.items.push(Item::Text(Text {
            x,
            y,
            anchor,
            style,
            color,
            halo: false,
            content,
        }));
    }

    fn rect(&mut self, [x, y, width, height]: [f64; 4], color: Color, tooltip: Option<String>) {
        let path = vec![
            Segment::Move([x, y]),
            Segment::Line([x + width, y]),
            Segment::Line([x + width, y + height]),
            Segment::Line([x, y + height]),
            Segment::Close,
        ];
        self.items.push(Item::Shape(Shape {
            path,
            color,
            opacity: 1.0,
            stroke: None,
            tooltip,
        }));
    }
}

impl Text {
    /// Left, top, right and bottom of the most that the text takes.
    #[cfg(test)]
    pub fn bounds(&self) -> [f64; 4] {
        let width = width(&self.content, self.style);
        let left = match self.anchor {
            Anchor::Start => self.x,
            Anchor::Middle => self.x - width / 2.0,
            Anchor::End => self.x - width,
        };
        let half = self.style.line_height() / 2.0;
        [left, self.y - half, left + width, self.y + half]
    }
}

/// What became of all episodes.
struct Outcome {
    /// At least one, so that it may divide.
    total: u64,
    failures: u64,
    unclassified: u64,
    successes: u64,
}

impl Outcome {
    /// Where the numbers contradict each other, there are as many episodes as are named.
    fn of(layout: &Layout, episodes_total: u64, successes: u64) -> Self {
        let failures = episodes_total
            .saturating_sub(successes)
            .max(layout.episodes);
        let total = failures.saturating_add(successes).max(1);
        Self {
            total,
            failures,
            unclassified: failures - layout.episodes,
            successes,
        }
    }

    fn words(&self) -> String {
        let episodes = counted(
            self.failures.saturating_add(self.successes),
            "episode",
            "episodes",
        );
        let mut words = format!(
            "{} in {episodes}",
            counted(self.failures, "failure", "failures")
        );
        if self.failures > 0 {
            words += &format!(
                " ({}), {}",
                share(self.failures, self.total),
                counted(self.successes, "success", "successes")
            );
        }
        if self.unclassified > 0 {
            words += &format!(
                "; {} not classified",
                counted(self.unclassified, "failure", "failures")
            );
        }
        words
    }
}

fn describe(layout: &Layout, outcome: &Outcome) -> String {
    let list = |nodes: &[Node]| -> String {
        nodes
            .iter()
            .map(|node| format!("{} {}", node.name, count(node.episodes)))
            .collect::<Vec<_>>()
            .join(", ")
    };
    if layout.classes.is_empty() {
        return format!("{}.", outcome.words());
    }
    let columns = [
        list(&layout.families),
        list(&layout.classes),
        list(&layout.sub_classes),
    ];
    format!(
        "{}. Families: {}. Classes: {}. Sub-classes: {}.",
        outcome.words(),
        columns[0],
        columns[1],
        columns[2]
    )
}

fn tooltip([from, to]: [&Node; 2], ribbon: &Ribbon, layout: &Layout) -> String {
    format!(
        "{} → {}: {}",
        from.name,
        to.name,
        numbers(ribbon.episodes, layout.episodes)
    )
}

fn numbers(episodes: u64, of: u64) -> String {
    format!(
        "{} ({})",
        counted(episodes, "episode", "episodes"),
        share(episodes, of)
    )
}

/// Identifiers as people write them; tooltips keep them as they are.
fn spaced(name: &str) -> String {
    name.replace('_', " ")
}

fn circle(x: f64, y: f64, radius: f64) -> Vec<Segment> {
    // Four cubics at this distance of their handles are a circle to the eye.
    let handle = radius * 0.5523;
    let (l, t, r, b) = (x - radius, y - radius, x + radius, y + radius);
    vec![
        Segment::Move([x, t]),
        Segment::Cubic([[x + handle, t], [r, y - handle], [r, y]]),
        Segment::Cubic([[r, y + handle], [x + handle, b], [x, b]]),
        Segment::Cubic([[x - handle, b], [l, y + handle], [l, y]]),
        Segment::Cubic([[l, y - handle], [x - handle, t], [x, t]]),
        Segment::Close,
    ]
}
