//! Writes `eval_output` trees as the published agents do (agents/common.py of InternRobotics/REAL):
//! the same folders, file names and keys.

use std::{
    fs,
    path::{Path, PathBuf},
};

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde_json::{Value, json};

/// A scene of the size the tests need.
pub const SCENE: &str = "MVUCSQAKTKJ5EAABAAAAABY8";
/// Instance id of the target, an apple on `table_1`.
pub const APPLE: &str = "_a1_on_table_1_at_verify_task_9";
/// Instance id of another apple on `table_1`, not the target.
pub const OTHER: &str = "_a2_on_table_1_at_verify_task_9";

/// One episode in the making.
pub struct Episode {
    folder: PathBuf,
    meta: Value,
    steps: u32,
    total_s: f64,
    graph: Value,
    /// As the server's state: what a debug payload shows.
    pub landmark: Value,
    pub held: Value,
    pub markers: Value,
}

/// What a tool gives back.
pub enum Shown {
    /// A frame alone, without a text.
    Image,
    /// A text, and the image that follows it.
    Text(String),
    /// The text of an exception: no image, no debug payload.
    Exception(String),
}

impl Episode {
    /// Begins an episode of a task with one target and one object beside it.
    pub fn new(root: &Path, family: &str, task: &str, model: &str) -> Self {
        let folder = root
            .join(SCENE)
            .join(format!("{family}_{task}"))
            .join(model.replace('-', "_"));
        let meta = json!({
            "benchmark_task_id": format!("{family}/{task}"), "family": family, "global_index": 4, "task_id": task,
            "episode_idx": 3, "task_description": "Take an apple from the table and put it into the fridge.",
            "scene_id": SCENE, "source_furniture": "table_1", "destination_furniture": "fridge_0",
            "target_object": {"id": "_a1", "name": APPLE, "category": "apple"}, "model": model, "lora_enabled": true,
        });
        let graph = json!({
            "table_1": {"content": [APPLE, OTHER]}, "table_2": {"content": []}, "fridge_0": {"content": [], "door": false},
        });
        let mut episode = Self {
            folder,
            meta,
            steps: 0,
            total_s: 0.0,
            graph,
            landmark: Value::Null,
            held: Value::Null,
            markers: Value::Null,
        };
        fs::create_dir_all(&episode.folder).unwrap();
        episode.write_meta(|_| {});
        episode
    }

    /// Changes the metadata and writes it to `task_meta.json`.
    pub fn write_meta(&mut self, change: impl FnOnce(&mut Value)) {
        change(&mut self.meta);
        write_json(&self.folder.join("task_meta.json"), &self.meta);
    }

    /// The folder that holds the episode's files.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder of the next step.
    pub fn next_step(&self) -> PathBuf {
        let folder = self.folder.join(format!("step_{:03}", self.steps));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    /// A step of the agent that speaks text (`qwen_agent.py`).
    pub fn text_step(&mut self, tool: &str, args: Value, shown: Shown) -> PathBuf {
        let number = self.steps;
        let action = json!({"summary": {"history": format!("did {number} things"), "new_schedule": "go on", "current_subtask": tool},
                            "next_action": {"tool_name": tool, "args": args}});
        let raw = format!("<think>thought {number}</think>\n```json\n{action}\n```");
        let folder = self.step(json!(tool), args, shown);
        fs::write(folder.join("user_message.txt"), "You are a robot.").unwrap();
        fs::write(folder.join("raw_response.txt"), raw).unwrap();
        folder
    }

    /// A step of the agent that calls functions (`vlm_api_agent.py`).
    pub fn call_step(&mut self, tool: Option<&str>, args: Value, shown: Shown) -> PathBuf {
        let function = json!({"id": "call-1", "type": "function", "function": {"name": tool, "arguments": args.to_string()}});
        let calls = if tool.is_some() {
            vec![function]
        } else {
            vec![]
        };
        let raw = json!({"role": "assistant", "content": format!("thought {}", self.steps), "tool_calls": calls});
        let folder = self.step(json!(tool), args, shown);
        write_json(&folder.join("raw_response.json"), &raw);
        folder
    }

    /// Takes an object off its receptacle into the gripper, as `pick` does.
    pub fn take(&mut self, object: &str, receptacle: &str) {
        let content = self.graph[receptacle]["content"].as_array_mut().unwrap();
        content.retain(|there| there != object);
        self.held = json!(object);
    }

    /// Puts what is held down, as `place` does.
    pub fn put(&mut self, receptacle: &str) {
        let object = self.held.take();
        self.graph[receptacle]["content"]
            .as_array_mut()
            .unwrap()
            .push(object);
    }

    /// Opens or closes a door.
    pub fn door(&mut self, receptacle: &str, open: bool) {
        self.graph[receptacle]["door"] = json!(open);
    }

    /// The step that ends it, and the summary.
    pub fn finish(&mut self, success: bool) {
        let graph = self.graph.clone();
        let folder = self.text_step(
            "finish",
            json!({}),
            Shown::Text(format!("Episode finished. Success: {success}")),
        );
        // The client answers `finish` itself: no image, and of the debug payload the graph alone.
        fs::remove_file(folder.join("image_observation_0.png")).unwrap();
        write_json(
            &folder.join("debug_info.json"),
            &json!({"world_graph": graph}),
        );
        self.summary("finished", success);
    }

    /// Writes `episode_summary.json` with this status and success flag.
    pub fn summary(&self, status: &str, success: bool) {
        let final_action = if status == "finished" {
            json!("finish")
        } else {
            Value::Null
        };
        let summary = json!({
            "benchmark_task_id": self.meta["benchmark_task_id"], "family": self.meta["family"], "global_index": 4,
            "task_id": self.meta["task_id"], "episode_idx": 3, "total_steps": self.steps, "total_inference_time": self.total_s,
            "final_action": final_action, "success": success, "status": status,
        });
        write_json(&self.folder.join("episode_summary.json"), &summary);
    }

    /// The agent's own failure: counted as a step, of which only the error is written.
    pub fn failed_step(&mut self, file: &str) {
        fs::write(
            self.next_step().join(file),
            "Traceback (most recent call last):\nRuntimeError: down\n",
        )
        .unwrap();
        self.steps += 1;
    }

    fn step(&mut self, tool: Value, args: Value, shown: Shown) -> PathBuf {
        let folder = self.next_step();
        let seconds = 1.25 + f64::from(self.steps);
        self.total_s += seconds;
        write_json(
            &folder.join("tool_call.json"),
            &json!({"tool_name": tool, "args": args}),
        );
        let time = json!({"inference_time": seconds, "total_inference_time": self.total_s});
        write_json(&folder.join("inference_time.json"), &time);
        let text = match &shown {
            Shown::Image => None,
            Shown::Text(text) | Shown::Exception(text) => Some(text),
        };
        if let Some(text) = text {
            fs::write(folder.join("textual_observation.txt"), text).unwrap();
        }
        let no_result = matches!(shown, Shown::Exception(_)) || tool.is_null();
        if !no_result {
            fs::write(
                folder.join("image_observation_0.png"),
                png(self.steps as u8),
            )
            .unwrap();
        }
        let position = if self.landmark.is_null() {
            Value::Null
        } else {
            json!([1.5, -0.25, "1.4"])
        };
        let debug_info = json!({
            "CURRENT_LANDMARK": self.landmark, "CURRENT_POS": position, "CURRENT_INV": self.held,
            "CURRENT_MARKER_MAP": self.markers, "world_graph": self.graph, "WORLD_GRAPH": "table_1: ['nonsense']\n",
        });
        write_json(
            &folder.join("debug_info.json"),
            &if no_result { json!({}) } else { debug_info },
        );
        self.steps += 1;
        folder
    }
}

/// The episode that does everything right, with the failures on its way: both apples listed,
/// a question, a door.
pub fn full(root: &Path) -> Episode {
    let mut e = Episode::new(root, "SUL", "verify_task_9", "qwen-vl");
    e.text_step(
        "explore_receptacle",
        json!({}),
        Shown::Text("No landmark selected. Use 'navigate_to' first.".into()),
    );
    e.landmark = json!("table_1");
    e.text_step(
        "navigate_to",
        json!({"receptacle_name": "table_1"}),
        Shown::Image,
    );
    e.markers = json!({"1": APPLE, "2": OTHER});
    e.text_step(
        "explore_receptacle",
        json!({}),
        Shown::Text(
            "I found the following object(s): \n\t1: a(an) apple.\n\t2: a(an) green apple.".into(),
        ),
    );
    let ask = json!({"target_category": "apple", "target_description": "the red one"});
    let answer = json!({"target_category": "apple", "target_description": "A red apple.", "source": "task_metadata"});
    e.text_step("ask", ask, Shown::Text(answer.to_string()));
    e.text_step("focus_on", json!({"marker_id": "1"}), Shown::Image);
    e.text_step(
        "pick",
        json!({"marker_id": "7"}),
        Shown::Text("Marker ID 7 not found in the marker map.".into()),
    );
    e.take(APPLE, "table_1");
    e.text_step("pick", json!({"marker_id": "1"}), Shown::Image);
    e.landmark = json!("fridge_0");
    e.markers = Value::Null;
    e.text_step(
        "navigate_to",
        json!({"receptacle_name": "fridge_0"}),
        Shown::Image,
    );
    e.markers = json!({"1": "fridge_0", "2": "table_2"});
    e.text_step("highlight_receptacles", json!({}), Shown::Image);
    e.text_step(
        "place",
        json!({"marker_id": "1"}),
        Shown::Text("The door of 'fridge_0' is closed. Use 'open' first.".into()),
    );
    e.door("fridge_0", true);
    e.text_step("open", json!({"marker_id": "1"}), Shown::Image);
    e.put("fridge_0");
    e.text_step("place", json!({"marker_id": "1"}), Shown::Image);
    e.finish(true);
    e
}

/// Every status besides `finished`, in both forms of a response.
pub fn others(root: &Path) -> Vec<Episode> {
    let go = || json!({"receptacle_name": "table_1"});
    let mut horizon = Episode::new(root, "FDP", "verify_task_1", "gpt-4o");
    horizon.call_step(None, json!({}), Shown::Text("No tool selected.".into()));
    horizon.landmark = json!("table_1");
    horizon.call_step(Some("navigate_to"), go(), Shown::Image);
    horizon.markers = json!({});
    horizon.call_step(
        Some("find_objects"),
        json!({"target_category": "pear"}),
        Shown::Image,
    );
    let exception =
        "Error executing pick: Traceback (most recent call last):\nKeyError: 'marker_id'\n";
    horizon.call_step(Some("pick"), json!({}), Shown::Exception(exception.into()));
    horizon.summary("max_steps_reached", false);

    let mut inference = Episode::new(root, "FDO", "verify_task_2", "qwen-vl");
    inference.landmark = json!("table_1");
    inference.text_step("navigate_to", go(), Shown::Image);
    inference.failed_step("inference_error.txt");
    inference.summary("inference_error", false);

    let mut action = Episode::new(root, "FODP", "verify_task_3", "qwen-vl");
    action.landmark = json!("table_1");
    action.text_step("navigate_to", go(), Shown::Image);
    action.failed_step("action_error.txt");
    action.summary("action_error", false);

    let skipped = Episode::new(root, "FDP", "verify_task_5", "qwen-vl");
    skipped.summary("skipped", false);
    vec![horizon, inference, action, skipped]
}

/// An image of the head camera.
pub fn png(shade: u8) -> Vec<u8> {
    png_of(FRAME_WIDTH, FRAME_HEIGHT, shade)
}

/// An image of any size.
pub fn png_of(width: usize, height: usize, shade: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&pixels(width, height, shade))
        .unwrap();
    bytes
}

/// RGB pixels of the test image, row by row; `shade` is the red channel.
pub fn pixels(width: usize, height: usize, shade: u8) -> Vec<u8> {
    (0..width * height)
        .flat_map(|index| [shade, (index / width) as u8, (index % width / 8) as u8])
        .collect()
}

/// As the agents write JSON.
pub fn write_json(path: &Path, value: &Value) {
    fs::write(path, format!("{value:#}\n")).unwrap();
}
