//! Draws three Sankey diagrams of failures, as SVG and PNG, into a directory: `cargo run --example sankey -- DIRECTORY`.

use std::path::PathBuf;

use reel_taxonomy::sankey::{Flow, Sankey};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = PathBuf::from(std::env::args().nth(1).ok_or("name a directory")?);
    std::fs::create_dir_all(&directory)?;
    let subtitle = "One hundred episodes of an agent, primary classes";
    let diagrams = [
        ("paper", Sankey::new("Why do they fail?", subtitle, &paper(), 100, 47)),
        (
            "skewed",
            Sankey::new(
                "Why do they fail?",
                "Four families, 21 sub-classes, from 1 to 100,000 episodes",
                &skewed(),
                200_000,
                60_000,
            ),
        ),
        ("empty", Sankey::new("Why do they fail?", subtitle, &[], 100, 100)),
    ];
    for (name, diagram) in diagrams {
        std::fs::write(directory.join(format!("{name}.svg")), diagram.svg())?;
        std::fs::write(directory.join(format!("{name}.png")), diagram.png(1.0)?)?;
        std::fs::write(directory.join(format!("{name}@2x.png")), diagram.png(2.0)?)?;
    }
    Ok(())
}

/// The proportions of the paper's figure: 25, 17, 9 and 2 of 53 failures.
fn paper() -> Vec<Flow> {
    let rows = [
        ("FDP", "Object Confusion", "wrong_attribute", 6),
        ("FODP", "Object Confusion", "wrong_attribute", 5),
        ("FDO", "Object Confusion", "wrong_instance", 3),
        ("SUL", "Object Confusion", "wrong_instance", 2),
        ("FODP", "Object Confusion", "similar_furniture", 4),
        ("FDO", "Object Confusion", "wrong_receptacle", 2),
        ("SUL", "Object Confusion", "ignored_answer", 3),
        ("SUL", "Key Action Missing", "missing_ask", 8),
        ("FDO", "Key Action Missing", "missing_open", 4),
        ("FDP", "Key Action Missing", "premature_finish", 2),
        ("FODP", "Key Action Missing", "missing_place", 1),
        ("FODP", "Key Action Missing", "never_looked", 2),
        ("FDP", "Lost Memory", "oscillation", 3),
        ("FODP", "Lost Memory", "repeated_failure", 2),
        ("SUL", "Lost Memory", "false_history", 2),
        ("FDO", "Lost Memory", "exploration", 2),
        ("FDP", "Other", "invalid_output", 1),
        ("SUL", "Other", "timeout", 1),
    ];
    rows.iter().map(|&(family, class, sub_class, episodes)| flow(family, class, sub_class, episodes)).collect()
}

fn skewed() -> Vec<Flow> {
    let classes: [(&str, &[&str]); 4] = [
        (
            "Object Confusion",
            &["wrong_attribute", "wrong_instance", "wrong_kind", "wrong_receptacle", "similar_furniture", "ignored_answer"],
        ),
        (
            "Key Action Missing",
            &["missing_ask", "never_looked", "missing_open", "missing_pick", "missing_place", "premature_finish"],
        ),
        ("Lost Memory", &["oscillation", "repeated_failure", "stale_marker", "false_history", "exploration"]),
        ("Other", &["invalid_output", "physical_failure", "primitive_failure", "timeout"]),
    ];
    let mut flows = Vec::new();
    for (f, family) in ["FDP", "FODP", "FDO", "SUL"].into_iter().enumerate() {
        for (c, (class, sub_classes)) in classes.iter().enumerate() {
            for (s, sub_class) in sub_classes.iter().enumerate() {
                flows.push(flow(family, class, sub_class, 10_u64.pow(5_u32.saturating_sub((f + c + s) as u32))));
            }
        }
    }
    flows
}

fn flow(family: &str, class: &str, sub_class: &str, episodes: u64) -> Flow {
    Flow { family: family.to_owned(), class: class.to_owned(), sub_class: sub_class.to_owned(), episodes }
}
