//! First minting.

use reel_generate::scene::{Brief, Plan, check, generate, views};

const BRIEFS: [(&str, &[(&str, &[&str])]); 7] = [
    ("S1", &[
        ("living room/0", &["tea table", "table", "shoe cabinet"]),
        ("dining room/0", &["table"]),
        ("kitchen/0", &["refrigerator", "microwave"]),
        ("bedroom/0", &["bed", "nightstand", "cabinet"]),
        ("bedroom/1", &["bed", "bed", "desk", "chest of drawers"]),
        ("study room/0", &["desk", "cabinet"]),
        ("toilet/0", &["cabinet"]),
        ("balcony/0", &["table"]),
    ]),
    ("S2", &[
        ("entry/0", &["cabinet"]),
        ("living room/0", &["couch", "table", "cabinet"]),
        ("dining room/0", &["table"]),
        ("kitchen/0", &["fridge", "microwave"]),
        ("bedroom/0", &["bed", "desk", "cabinet"]),
        ("bedroom/1", &["bed", "desk", "cabinet"]),
        ("bedroom/2", &["bed", "desk", "cabinet"]),
        ("balcony/0", &["table"]),
    ]),
    ("S3", &[
        ("living room/0", &["couch", "tv stand", "table"]),
        ("dining room/0", &["table"]),
        ("kitchen/0", &["refrigerator", "microwave"]),
        ("bedroom/0", &["bed", "desk"]),
        ("bedroom/1", &["bed", "bed", "desk"]),
        ("balcony/0", &["table"]),
    ]),
    ("S4", &[
        ("corridor/0", &["cabinet"]),
        ("living room/0", &["couch", "table", "cabinet"]),
        ("dining room/0", &["table"]),
        ("kitchen/0", &["refrigerator", "microwave"]),
        ("bedroom/0", &["bed", "desk"]),
        ("bedroom/1", &["bed", "cabinet"]),
        ("bathroom/0", &["cabinet"]),
    ]),
    ("S5", &[
        ("living room/0", &["couch", "table", "cabinet"]),
        ("dining room/0", &["table"]),
        ("kitchen/0", &["counter", "refrigerator", "microwave"]),
        ("bedroom/0", &["bed", "desk", "cabinet"]),
        ("bedroom/1", &["bed", "desk", "cabinet"]),
        ("toilet/0", &["cabinet"]),
    ]),
    ("S6", &[
        ("living room/0", &["tv stand", "table"]),
        ("dining room/0", &["table"]),
        ("kitchen/0", &["refrigerator", "sink"]),
        ("bedroom/0", &["bed", "cabinet"]),
        ("bedroom/1", &["bed"]),
        ("toilet/0", &["sink", "cabinet"]),
    ]),
    ("S7", &[
        ("living room/0", &["couch", "table", "tv stand"]),
        ("dining room/0", &["table", "cabinet"]),
        ("kitchen/0", &["refrigerator", "counter", "sink", "electric cooker"]),
        ("bedroom/0", &["bed", "nightstand", "cabinet"]),
        ("bedroom/1", &["bed", "desk"]),
        ("study room/0", &["desk", "cabinet"]),
        ("washroom/0", &["washing machine", "sink"]),
    ]),
];

#[test]
fn mint() {
    let out = std::env::var("OUT").unwrap();
    let seeds: Vec<u64> = std::env::var("SEEDS").unwrap_or("1".into()).split(',').map(|s| s.parse().unwrap()).collect();
    let only = std::env::var("ONLY").unwrap_or_default();
    for (name, rooms) in BRIEFS {
        if !only.is_empty() && only != name { continue; }
        let rooms = rooms.iter().map(|(room, pieces)| (room.to_string(), pieces.iter().map(|p| p.to_string()).collect())).collect();
        let brief = Brief { rooms };
        for seed in &seeds {
            let t = std::time::Instant::now();
            match generate(&brief, name, *seed) {
                Err(e) => println!("{name} {seed}: {e}"),
                Ok(scene) => {
                    let plan = Plan::of(&scene);
                    let captions: usize = scene.receptacles.iter().map(|r| r.captions.len()).sum();
                    println!("{name} {seed}: {} captions, {} findings, {} crossings, {:?}", captions, check(&scene).len(), plan.crossings(), t.elapsed());
                    std::fs::write(format!("{out}/{name}_{seed}.png"), plan.png().unwrap()).unwrap();
                    std::fs::write(format!("{out}/{name}_{seed}.svg"), plan.svg()).unwrap();
                    std::fs::write(format!("{out}/{name}_{seed}.json"), serde_json::to_string_pretty(&scene).unwrap()).unwrap();
                    if std::env::var("PICS").is_ok() {
                        for view in views(&scene) {
                            if let Some(frame) = view.frame { std::fs::write(format!("{out}/{name}_{seed}-{}.rgb", view.receptacle), &frame.rgb).unwrap(); }
                        }
                    }
                }
            }
        }
    }
}
