//! Single operations, timed by divan (`make bench`). What whole episodes cost, as ratios within one
//! run, `reel dev perf` measures (`make perf`).

use std::{path::Path, sync::LazyLock};

use divan::{Bencher, black_box};
use reel_reward::{Preset, rewards};
use reel_trace::{RecordsReader, Trace};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, answer::AssistantTurn};

const TRACE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../traces/golden/FDO_home_0002--planner--4.mcap"
);

static GOLDEN: LazyLock<Trace> =
    LazyLock::new(|| Trace::read(Path::new(TRACE)).expect("a golden trace"));

fn main() {
    divan::main();
}

#[divan::bench]
fn read_a_trace() -> Trace {
    Trace::read(black_box(Path::new(TRACE))).expect("a golden trace")
}

#[divan::bench]
fn read_its_records(bencher: Bencher) {
    let reader = RecordsReader::default();
    bencher.bench_local(|| reader.read(Path::new(TRACE)).expect("a golden trace"));
}

#[divan::bench(sample_count = 10)]
fn replay_a_trace() -> bool {
    reel_replay::verify_trace(&GOLDEN).is_exact()
}

#[divan::bench]
fn render_the_first_frame() -> Vec<u8> {
    let frame = reel_replay::frame_at(&GOLDEN, None, None);
    frame.expect("the start of the trace").rgb
}

#[divan::bench]
fn encode_a_frame(bencher: Bencher) {
    let frame = reel_replay::frame_at(&GOLDEN, None, None).expect("the start of the trace");
    let (width, height) = (FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
    bencher.bench(|| reel_trace::encode_webp(&frame.rgb, width, height));
}

#[divan::bench(args = ["paper", "real-repo", "real-trainer"])]
fn score_an_episode(bencher: Bencher, preset: &str) {
    let preset = Preset::parse(preset).expect("a built-in preset");
    let trace = &*GOLDEN;
    bencher.bench(|| {
        rewards(
            &preset,
            &trace.task,
            &trace.scene,
            &trace.start,
            &trace.steps,
        )
    });
}

#[divan::bench]
fn parse_an_answer() -> AssistantTurn {
    AssistantTurn::parse(black_box(
        r#"<think>The red mug is nearest.</think> {"History": ["0. went to table_1"],
        "next_action": {"tool_name": "pick", "args": {"marker_id": 1}}}"#,
    ))
}

/// Patterns over the rows of an episode; needs the feature `service`.
#[cfg(feature = "service")]
#[divan::bench(args = [
    "nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place",
    "nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,}",
    "pick[failed] .. pick[ok] .. place[goal_receptacle] $",
])]
fn match_a_pattern(bencher: Bencher, text: &str) {
    let pattern = reel_query::pattern::Pattern::parse(text).expect("a valid pattern");
    let conditions = (1_u64 << pattern.conditions().len()) - 1;
    let masks: Vec<u64> = (0..12).map(|step| (step * 0x9e37) & conditions).collect();
    let mut matcher = pattern.matcher();
    bencher.bench_local(|| matcher.count(black_box(&masks)));
}
