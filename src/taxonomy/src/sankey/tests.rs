//! Tests of the diagram as a whole, on friendly, extreme and hostile flows. Owns the inputs.

use super::layout::{Layout, Node, Ribbon};
use super::scene::{Item, Scene, Text};
use super::text::count;
use super::*;

fn flow(family: &str, class: &str, sub_class: &str, episodes: u64) -> Flow {
    Flow {
        family: family.to_owned(),
        class: class.to_owned(),
        sub_class: sub_class.to_owned(),
        episodes,
    }
}

/// 25, 17, 9 and 2 of 53 failures.
fn paper() -> Vec<Flow> {
    vec![
        flow("SUL", "Other", "timeout", 2),
        flow("FDP", "Lost Memory", "oscillation", 9),
        flow("FODP", "Key Action Missing", "missing_open", 7),
        flow("FDO", "Key Action Missing", "missing_ask", 10),
        flow("FODP", "Object Confusion", "wrong_attribute", 14),
        flow("FDP", "Object Confusion", "wrong_attribute", 6),
        flow("SUL", "Object Confusion", "wrong_kind", 5),
    ]
}

/// Four families by 21 sub-classes; names of 80 characters where asked for; sizes
/// from 1 to 100,000.
fn skewed(long_names: bool) -> Vec<Flow> {
    let name = |name: String| {
        if long_names {
            format!("{name}_{}", "WM@".repeat(40))
                .chars()
                .take(80)
                .collect()
        } else {
            name
        }
    };
    let classes = [
        "Object Confusion",
        "Key Action Missing",
        "Lost Memory",
        "Other",
    ];
    let mut flows = Vec::new();
    for family in 0..4 {
        for sub_class in 0..21 {
            let class = if long_names {
                name(format!("class {}", sub_class % 4))
            } else {
                classes[sub_class % 4].to_owned()
            };
            let episodes = if (family + sub_class) % 5 == 0 {
                100_000
            } else {
                1 + (family * sub_class % 3) as u64
            };
            flows.push(Flow {
                family: name(format!("f{family}")),
                class,
                sub_class: name(format!("s{sub_class}")),
                episodes,
            });
        }
    }
    flows
}

fn hostile() -> Vec<Flow> {
    vec![
        flow(
            "<script>alert(1)</script>",
            "\"' onload='x' &amp;",
            "]]><!--",
            3,
        ),
        flow("\u{0}\u{1b}[31m\u{202e}", "\u{ffff}\r\n\t", "🤖👩‍👩‍👧 家", 2),
        flow("", "", "", 1),
        flow("FDP", "</title></svg>", "e\u{301}\u{301}\u{301}", u64::MAX),
    ]
}

fn inputs() -> Vec<Vec<Flow>> {
    let many: Vec<Flow> = (0..400)
        .map(|i| {
            flow(
                &format!("f{}", i % 37),
                &format!("c{}", i % 29),
                &format!("s{i}"),
                1 + i * i,
            )
        })
        .collect();
    vec![
        vec![flow("FDP", "Other", "timeout", 1)],
        paper(),
        skewed(false),
        skewed(true),
        hostile(),
        many,
        vec![],
    ]
}

fn scene_of(flows: &[Flow]) -> Scene {
    Scene::of(
        &"Why? ".repeat(60),
        &"subtitle ".repeat(60),
        &Layout::of(flows),
        100,
        47,
    )
}

#[test]
fn ribbons_fill_their_nodes_and_episodes_are_kept() {
    for flows in inputs() {
        let layout = Layout::of(&flows);
        let all = flows
            .iter()
            .fold(0_u64, |sum, flow| sum.saturating_add(flow.episodes));
        assert_eq!(layout.episodes, all);
        assert_filled(&layout.families, &layout.into_classes, 0);
        assert_filled(&layout.classes, &layout.into_classes, 1);
        assert_filled(&layout.classes, &layout.into_sub_classes, 0);
        assert_filled(&layout.sub_classes, &layout.into_sub_classes, 1);
        for column in [&layout.families, &layout.classes, &layout.sub_classes] {
            assert_eq!(
                column
                    .iter()
                    .fold(0_u64, |sum, node| sum.saturating_add(node.episodes)),
                all
            );
            assert!(
                column.is_sorted_by(|above, below| above.y + above.height < below.y),
                "nodes overlap"
            );
            assert!(
                column
                    .iter()
                    .all(|node| node.y >= -1e-9 && node.y + node.height <= layout.height + 1e-9)
            );
        }
    }
}

fn assert_filled(nodes: &[Node], ribbons: &[Ribbon], end: usize) {
    for (index, node) in nodes.iter().enumerate() {
        let mut spans: Vec<_> = ribbons
            .iter()
            .filter(|ribbon| ribbon.ends[end] == index)
            .map(|ribbon| ribbon.spans[end])
            .collect();
        spans.sort_by(|a, b| a.y.total_cmp(&b.y));
        let mut y = node.y;
        for span in spans {
            assert!(
                (span.y - y).abs() < 1e-6 && span.height >= 1.0,
                "{}: a gap or nothing to see at {y}",
                node.name
            );
            y += span.height;
        }
        assert!(
            (y - node.y - node.height).abs() < 1e-6,
            "{}: {y} is not the end of the node",
            node.name
        );
    }
}

#[test]
fn what_is_large_enough_is_in_proportion() {
    let layout = Layout::of(&paper());
    let heights: Vec<f64> = layout
        .classes
        .iter()
        .map(|class| class.height / class.episodes as f64)
        .collect();
    assert!(
        heights
            .iter()
            .all(|height| (height - heights[0]).abs() < 1e-9)
    );
    for ribbon in layout.into_classes.iter().chain(&layout.into_sub_classes) {
        assert!(
            ribbon
                .spans
                .iter()
                .all(|span| (span.height - ribbon.episodes as f64 * heights[0]).abs() < 1e-9)
        );
    }
}

#[test]
fn families_and_classes_keep_their_order_and_sub_classes_go_by_size() {
    let names = |nodes: &[Node]| {
        nodes
            .iter()
            .map(|node| node.name.clone())
            .collect::<Vec<_>>()
    };
    let mut flows = paper();
    flows.extend([flow("A", "Zeal", "z", 1), flow("B", "Awe", "a", 99)]);
    let layout = Layout::of(&flows);
    assert_eq!(
        names(&layout.families),
        ["FDP", "FODP", "FDO", "SUL", "B", "A"]
    );
    assert_eq!(
        names(&layout.classes),
        [
            "Object Confusion",
            "Key Action Missing",
            "Lost Memory",
            "Other",
            "Awe",
            "Zeal"
        ]
    );
    assert_eq!(
        names(&layout.sub_classes),
        [
            "wrong_attribute",
            "wrong_kind",
            "missing_ask",
            "missing_open",
            "oscillation",
            "timeout",
            "a",
            "z"
        ]
    );
    let crosses = |a: &Ribbon, b: &Ribbon| a.ends[0] < b.ends[0] && a.ends[1] > b.ends[1];
    assert!(
        layout
            .into_sub_classes
            .iter()
            .all(|a| !layout.into_sub_classes.iter().any(|b| crosses(a, b)))
    );
}

#[test]
fn labels_neither_overlap_nor_leave_the_image() {
    for flows in inputs() {
        let scene = scene_of(&flows);
        let texts: Vec<&Text> = scene
            .items
            .iter()
            .filter_map(|item| {
                if let Item::Text(text) = item {
                    Some(text)
                } else {
                    None
                }
            })
            .collect();
        for (index, text) in texts.iter().enumerate() {
            let [left, top, right, bottom] = text.bounds();
            assert!(
                left >= 0.0 && top >= 0.0 && right <= scene.width && bottom <= scene.height,
                "{} is outside",
                text.content
            );
            for other in &texts[index + 1..] {
                let [l, t, r, b] = other.bounds();
                let apart = right <= l || r <= left || bottom <= t || b <= top;
                assert!(apart, "`{}` and `{}` overlap", text.content, other.content);
            }
        }
    }
}

#[test]
fn every_flow_is_in_the_svg_with_its_count() {
    for flows in [paper(), skewed(false)] {
        let svg = Sankey::new("t", "", &flows, 100, 47).svg();
        let document = roxmltree::Document::parse(&svg).expect("the SVG is XML");
        let tooltips: Vec<&str> = document
            .descendants()
            .filter(|node| node.has_tag_name("title"))
            .filter_map(|node| node.text())
            .collect();
        for Flow {
            family,
            class,
            sub_class,
            episodes,
        } in &flows
        {
            let ribbon = format!("{class} → {sub_class}: ");
            let part = format!("{family} {}", count(*episodes));
            let shown = |tooltip: &&str| {
                let parts = tooltip
                    .strip_prefix(&ribbon)
                    .and_then(|rest| rest.split_once(": "));
                parts.is_some_and(|(_, parts)| parts.split(", ").any(|found| found == part))
            };
            assert!(tooltips.iter().any(shown), "{ribbon}{part}");
        }
        let into_class = flows
            .iter()
            .filter(|f| f.family == "FDP" && f.class == "Object Confusion")
            .map(|f| f.episodes)
            .sum::<u64>();
        if into_class > 0 {
            assert!(tooltips.iter().any(|tooltip| {
                tooltip.starts_with(&format!("FDP → Object Confusion: {} ", count(into_class)))
            }));
        }
    }
}

#[test]
fn the_svg_says_what_it_is() {
    let svg = Sankey::new("Why?", "all of them", &paper(), 100, 47).svg();
    let document = roxmltree::Document::parse(&svg).expect("the SVG is XML");
    let root = document.root_element();
    let child = |name| {
        root.children()
            .find(|node| node.has_tag_name(name))
            .and_then(|node| node.text())
            .unwrap_or_default()
    };
    assert_eq!(root.attribute("role"), Some("img"));
    assert_eq!(child("title"), "Why?");
    assert!(
        child("desc")
            .starts_with("53 failures in 100 episodes (53.0%), 47 successes. Families: FDP 15, "),
        "{}",
        child("desc")
    );
    for words in [
        "Object Confusion 25",
        "Key Action Missing 17",
        "Lost Memory 9",
        "Other 2",
        "wrong_attribute 20",
    ] {
        assert!(child("desc").contains(words), "{words}");
    }
    for (label, numbers) in [
        ("Object Confusion", "25 (47.2%)"),
        ("Other", "2 (3.8%)"),
        ("wrong attribute", "37.7%"),
    ] {
        assert!(
            svg.contains(&format!(">{label}</text>"))
                && svg.contains(&format!(">{numbers}</text>")),
            "{label}"
        );
    }
}

#[test]
fn hostile_names_are_only_text() {
    let svg = Sankey::new("<script>\u{0}", "\"\u{7}'", &hostile(), 1, 0).svg();
    let document = roxmltree::Document::parse(&svg).expect("the SVG is XML");
    let allowed = ["svg", "title", "desc", "style", "path", "text"];
    assert!(
        document
            .descendants()
            .filter(|node| node.is_element())
            .all(|node| allowed.contains(&node.tag_name().name()))
    );
    let safe = |name: &str| !name.starts_with("on") && name != "href";
    assert!(
        document
            .descendants()
            .flat_map(|node| node.attributes())
            .all(|attribute| safe(attribute.name()))
    );
    assert!(
        !svg.chars()
            .any(|c| (c.is_control() && c != '\n') || matches!(c, '\u{202e}' | '\u{ffff}'))
    );
    let texts: Vec<&str> = document
        .descendants()
        .filter_map(|node| node.text())
        .collect();
    for name in [
        "<script>alert(1)</script>",
        "\"' onload='x' &amp;",
        "]]><!--",
        "</title></svg>",
        "家",
        "(unnamed)",
    ] {
        assert!(
            texts.iter().any(|text| text.contains(name)),
            "{name} is lost"
        );
    }
}

#[test]
fn the_smallest_of_very_many_are_drawn_together() {
    let flows: Vec<Flow> = (0..5_000)
        .map(|i| {
            flow(
                &format!("f{i}"),
                &format!("c{}", i % 300),
                &format!("s{i}"),
                1 + i,
            )
        })
        .collect();
    let layout = Layout::of(&flows);
    assert_eq!([layout.families.len(), layout.classes.len()], [12, 12]);
    assert!(
        layout.sub_classes.len() <= 60 + 12 && layout.height < 3000.0,
        "{}",
        layout.height
    );
    assert_eq!(layout.families[11].name, "4989 more");
    assert!(
        layout
            .sub_classes
            .last()
            .is_some_and(|node| node.name.ends_with(" more"))
    );
    assert_eq!(layout.episodes, 5_000 * 5_001 / 2);
}

#[test]
fn the_order_of_flows_does_not_matter_and_same_input_gives_same_bytes() {
    let bytes = |flows: &[Flow]| {
        let sankey = Sankey::new("t", "s", flows, 100, 47);
        (sankey.svg(), sankey.png(1.0).expect("an image"))
    };
    let mut flows = skewed(false);
    let first = bytes(&flows);
    assert!(first == bytes(&flows));
    flows.reverse();
    flows.push(flow("none", "none", "none", 0));
    assert!(first == bytes(&flows));
    flows[0].episodes += 5000;
    assert!(first != bytes(&flows));
}

#[test]
fn the_png_shows_every_class_in_the_right_size() {
    for scale in [0.5, 1.0, 1.3, 2.0] {
        let scene = Scene::of("t", "s", &Layout::of(&paper()), 100, 47);
        let (width, height, rgb) = decoded(
            &Sankey::new("t", "s", &paper(), 100, 47)
                .png(scale)
                .expect("an image"),
        );
        assert_eq!(
            [width, height],
            [scene.width, scene.height].map(|length| (length as f32 * scale).round() as u32)
        );
        for (class, color) in palette::CLASSES {
            assert!(
                rgb.as_chunks::<3>().0.contains(&color),
                "{class} is not in the image"
            );
        }
    }
    for flows in inputs() {
        let (width, height, rgb) = decoded(
            &Sankey::new("t", "s", &flows, 3, 0)
                .png(0.5)
                .expect("an image"),
        );
        assert_eq!(rgb.len(), (width * height * 3) as usize);
        assert!(rgb.iter().any(|&channel| channel < 128), "blank");
    }
}

fn decoded(bytes: &[u8]) -> (u32, u32, Vec<u8>) {
    let mut reader = ::png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .expect("a PNG");
    let mut rgb = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut rgb).expect("pixels");
    assert_eq!(info.color_type, ::png::ColorType::Rgb);
    rgb.truncate(info.buffer_size());
    (info.width, info.height, rgb)
}

#[test]
fn scales_outside_are_refused() {
    for scale in [0.0, -1.0, 4.1, f32::NAN, f32::INFINITY] {
        let refused = Sankey::new("t", "s", &paper(), 100, 47).png(scale);
        assert!(matches!(refused, Err(SankeyError::Scale { .. })), "{scale}");
    }
}

#[test]
fn nothing_to_show_says_why() {
    for (total, successes, headline, note) in [
        (100, 100, "No failures", "Every episode reached its goal."),
        (0, 0, "No failures", "There are no episodes here."),
        (
            100,
            47,
            "No classified failures",
            "53 failures in 100 episodes (53.0%), 47 successes; 53 failures not classified",
        ),
    ] {
        let svg = Sankey::new(
            "t",
            "s",
            &[flow("FDP", "Other", "timeout", 0)],
            total,
            successes,
        )
        .svg();
        assert!(
            svg.contains(&format!(">{headline}</text>"))
                && svg.contains(&format!(">{note}</text>")),
            "{svg}"
        );
    }
}

#[test]
fn numbers_that_contradict_each_other_are_shown_as_they_add_up() {
    let svg = Sankey::new("t", "s", &paper(), 10, 5).svg();
    assert!(svg.contains(">53 failures in 58 episodes (91.4%), 5 successes</text>"));
    let svg = Sankey::new("t", "s", &paper(), 110, 47).svg();
    assert!(svg.contains(
        ">63 failures in 110 episodes (57.3%), 47 successes; 10 failures not classified</text>"
    ));
}
