//! What gives the place of the target or an id away is found, and honest replies pass: over 25 drawn
//! tasks, and over the published ones where they are (`REEL_REAL_BENCH`, or beside the repository).
//!
//! Two people wrote the replies without having seen the check. When they were first tried, 94 % of
//! the leaks of `replies` and 67 % of those of `more_replies` were found, and 93 % and 75 % of the
//! honest replies passed; the check was mended by both.

mod more_replies;
mod replies;

use reel_episode::user::leaks;
use reel_tasks::{
    DrawOptions, draw,
    generate::scene::{built_in, names},
};
use reel_world::{Family, Scene, Task};

use replies::Reply;

/// So many tasks are drawn.
const TASKS: usize = 25;

#[test]
fn leaks_in_20_ways_are_found_and_honest_replies_pass() {
    let tasks = tasks();
    assert_eq!(wrong(&tasks, &replies::LEAKS, true, 0), 0);
    wrong(&tasks, &replies::HONEST, false, 2);
}

#[test]
fn most_leaks_that_try_to_get_round_the_check_are_found() {
    let tasks = tasks();
    // 28 of 4,100 with REAL-Bench; 10 of the 500 of the drawn tasks alone.
    wrong(&tasks, &more_replies::LEAKS, true, 20);
    wrong(&tasks, &more_replies::HONEST, false, 5);
}

/// How often the check is wrong, and may be in so many of a thousand replies.
fn wrong(tasks: &[(Task, Scene)], replies: &[Reply], leaky: bool, per_mille: usize) -> usize {
    let mut wrong = Vec::new();
    for (task, scene) in tasks {
        for (name, write) in replies {
            let reply = write(task, scene);
            if leaks(task, scene, &reply).is_empty() == leaky {
                wrong.push(format!("{name} ({}): {reply}", task.task_id));
            }
        }
    }
    let count = tasks.len() * replies.len();
    let what = if leaky { "leaks" } else { "honest replies" };
    let text = format!("wrong about {} of {count} {what}", wrong.len());
    println!("{text}");
    assert!(
        1000 * wrong.len() <= per_mille * count,
        "{text}\n{}",
        wrong.join("\n")
    );
    wrong.len()
}

/// Drawn tasks of all families in the scenes that come with Reel, and the published ones.
fn tasks() -> Vec<(Task, Scene)> {
    let mut tasks = Vec::new();
    for (seed, scene) in (0..).zip(names().filter_map(built_in)) {
        let options = DrawOptions {
            scene: &scene,
            families: &Family::ALL,
            count: Family::ALL.len(),
            seed,
        };
        let drawn = draw(&options).tasks.into_iter();
        tasks.extend(drawn.map(|task| (task, scene.clone())));
    }
    assert!(tasks.len() >= TASKS);
    tasks.truncate(TASKS);
    if let Some((scene, published)) = reel_vectors::episodes::real_bench() {
        let published = published.iter();
        tasks.extend(published.map(|task| ((**task).clone(), (*scene).clone())));
    }
    tasks
}
