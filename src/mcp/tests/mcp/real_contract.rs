//! The published servers, call by call: what REAL's own code answered when its simulator was
//! replaced by tables (`server.json`), and the tools its trainer wants to see
//! (`trainer_contract.json`). Ours answers through the protocol, with the same tables in the place
//! of the renderer and the navigation map.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use reel_live::{Host, Limits, PreparedTaskCache, SessionPool, Setup};
use reel_mcp::{ToolServer, ToolServerOptions, Worker};
use reel_reward::Preset;
use reel_sim::{
    Perception, PreparedTask, Segment, Simulator, geometry::Camera, nav::Viewpoint,
    render::OverlayMark,
};
use reel_trace::{Images, Trace};
use reel_vectors::{KeyOrder, Report, difference, items, load, text};
use reel_world::{
    Frame, Meshes, Profile, Scene, Skills, Task,
    record::{MarkerTarget, StepRecord},
};
use rmcp::ServiceExt as _;
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader, DuplexStream};

const TOKEN: &str = "⟦traceback ending in⟧ ";
const TRACEBACK: &str = "Traceback (most recent call last):\n";
const START_STEPS: u64 = 550;
/// How far a placed object may have moved while it came to rest, or was pushed by what
/// stood there, in metres.
const REST_M: f64 = 0.2;

const TEXT_PLANS: &str = "a plan of texts is no plan of REAL-Bench: the loader refuses the file";
const AFTER_THE_END: &str =
    "after the end text no episode runs: calls say so instead of acting on the last task";
const PRIMS: &str = "scenes have no prims: a receptacle is known by its own name only";

/// What the published test gave its server instead of a simulator.
#[derive(Debug)]
struct Tables {
    stands: BTreeMap<String, Option<[f32; 3]>>,
    snug: BTreeMap<String, [f32; 3]>,
    embeddings: BTreeMap<String, Vec<f64>>,
    now: Mutex<Now>,
}

#[derive(Debug, Default)]
struct Now {
    visible: Vec<String>,
    drawn: Option<(Vec<String>, f32)>,
}

impl Perception for Tables {
    fn viewpoint(&self, simulator: &Simulator, furniture: usize) -> Option<Viewpoint> {
        self.stands[simulator.model().furniture[furniture].id.as_str()].map(standing)
    }

    fn close_up(&self, simulator: &Simulator, object: usize) -> Option<Viewpoint> {
        self.snug
            .get(simulator.task().objects[object].instance.as_str())
            .copied()
            .map(standing)
    }

    fn segments(&self, simulator: &Simulator) -> Vec<Segment> {
        let visible = self.now.lock().unwrap().visible.clone();
        let segment = |name: &String| {
            let (name, pixels) = name
                .strip_prefix('!')
                .map_or((name.as_str(), 50), |name| (name, 0));
            let object = simulator
                .task()
                .object(&name.into())
                .map(|object| MarkerTarget::Object(object.instance.clone()));
            Segment {
                target: object.unwrap_or_else(|| MarkerTarget::Receptacle(name.into())),
                pixels,
            }
        };
        visible.iter().map(segment).collect()
    }

    fn nearest_category(&self, query: &str, categories: &[&str]) -> Option<String> {
        let query = &self.embeddings[query];
        let near = |category: &&&str| cosine(query, &self.embeddings[**category]);
        categories
            .iter()
            .max_by(|one, other| near(one).total_cmp(&near(other)))
            .map(ToString::to_string)
    }

    fn mark(&self, _: &mut Frame, marks: &[OverlayMark], opacity: f32) {
        let labels = marks.iter().map(|mark| mark.number.to_string()).collect();
        self.now.lock().unwrap().drawn = Some((labels, opacity));
    }
}

fn standing(camera: [f32; 3]) -> Viewpoint {
    let camera = Camera::looking_at(camera, [camera[0], camera[1] + 1.0, 0.5]);
    Viewpoint {
        base: [camera.position[0], camera.position[1]],
        camera,
        path_length_m: 0.0,
    }
}

fn cosine(one: &[f64], other: &[f64]) -> f64 {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    product(one, other) / (product(one, one) * product(other, other)).sqrt()
}

/// Furniture as the test's tables have it.
fn scene(furniture: &Value) -> Scene {
    let mut rooms: Vec<Value> = Vec::new();
    let receptacle = |piece: &Value| {
        let [low, high] = [0, 1].map(|corner| piece["box"][corner].clone());
        let has = |component: &str| {
            items(&piece["components"])
                .iter()
                .any(|other| other == component)
        };
        let name = text(&piece["name"]);
        let at = |value: &Value, axis: usize| value[axis].as_f64().unwrap();
        let [min, max] = [(&low, -1.5), (&high, 1.5)]
            .map(|(corner, margin)| [0, 1].map(|axis| at(corner, axis) + margin));
        match rooms.iter_mut().find(|room| room["name"] == piece["room"]) {
            Some(room) => {
                let far = |value: &Value, one: f64, most: fn(f64, f64) -> f64| {
                    json!(most(value.as_f64().unwrap(), one))
                };
                for axis in 0..2 {
                    room["min"][axis] = far(&room["min"][axis], min[axis], f64::min);
                    room["max"][axis] = far(&room["max"][axis], max[axis], f64::max);
                }
            }
            None => rooms.push(json!({ "name": piece["room"], "min": min, "max": max })),
        }
        json!({
            "id": name, "room": piece["room"], "category": name.rsplit_once('_').unwrap().0, "door": has("door"),
            "surface_min": [low[0], low[1], at(&high, 2) - 0.02], "surface_max": high, "placeable": has("top_shelf"),
        })
    };
    let receptacles: Vec<Value> = items(furniture).iter().map(receptacle).collect();
    serde_json::from_value(
        json!({ "scene_id": "S", "rooms": rooms, "walls": [], "receptacles": receptacles }),
    )
    .unwrap()
}

/// The episodes of a task file; none where the loader refuses its plan. What the loader refuses in
/// a task (a goal that names no receptacle of the scene, or that has the target stand there
/// already) is set afterwards.
fn tasks(file: &Value, scene: &Scene) -> Vec<Arc<Task>> {
    let one = |episode: &Value| {
        let mut loadable = file.clone();
        let mut entry = episode.clone();
        let is_target = |(_, placement): &(&String, &Value)| {
            placement["original_id"] == episode["target_object_id"]
        };
        let placed = episode["placements"].as_object().unwrap();
        let at_src = placed
            .iter()
            .filter(is_target)
            .find(|(_, placement)| placement["furniture"] == episode["src"]);
        let (target, placement) = at_src.or_else(|| placed.iter().find(is_target)).unwrap();
        entry["src"] = placement["furniture"].clone();
        entry["dest"] = json!(
            scene
                .receptacles
                .iter()
                .find(|receptacle| entry["src"] != receptacle.id.as_str())
                .unwrap()
                .id
        );
        entry["initial_world_graph"] = json!({});
        if entry.get("family").is_none() {
            entry["family"] = json!("FDP");
        }
        loadable["episodes"] = json!([entry]);
        let (mut task, _) = reel_tasks::parse(&loadable.to_string(), "case", scene).ok()?;
        if episode.get("benchmark_task_id").is_none() {
            task.task_id = text(&episode["task_id"]).to_owned();
        }
        task.target = target.as_str().into();
        task.src = text(&episode["src"]).into();
        task.dest = text(&episode["dest"]).into();
        Some(Arc::new(task))
    };
    items(&file["episodes"]).iter().filter_map(one).collect()
}

/// A published task in the published scene.
fn bench(id: &str) -> Option<(Scene, Vec<Arc<Task>>)> {
    let folder = reel_vectors::real_bench()?;
    let scene = reel_tasks::scene::load(&folder.join("s7_scene.json"))
        .unwrap()
        .scene;
    let report = reel_tasks::load(&folder.join("tasks").join(format!("{id}.yaml")), &scene);
    let tasks = report.tasks.into_iter().map(Arc::new).collect();
    Some((scene, tasks))
}

/// A client that speaks the protocol's messages, a line each.
struct Client {
    stream: BufReader<DuplexStream>,
    asked: u32,
}

impl Client {
    async fn new(stream: DuplexStream) -> Self {
        let mut client = Self {
            stream: BufReader::new(stream),
            asked: 0,
        };
        let hello = json!({ "protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": { "name": "case", "version": "1" } });
        client.ask("initialize", hello).await;
        client
            .send(json!({ "jsonrpc": "2.0", "method": "notifications/initialized" }))
            .await;
        client
    }

    async fn ask(&mut self, method: &str, params: Value) -> Value {
        self.asked += 1;
        self.send(
            json!({ "jsonrpc": "2.0", "id": self.asked, "method": method, "params": params }),
        )
        .await;
        let mut line = String::new();
        self.stream.read_line(&mut line).await.unwrap();
        let mut answer: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(answer["id"], self.asked, "{answer}");
        answer["result"].take()
    }

    async fn send(&mut self, message: Value) {
        self.stream
            .get_mut()
            .write_all(format!("{message}\n").as_bytes())
            .await
            .unwrap();
    }
}

struct Table {
    client: Client,
    tables: Arc<Tables>,
    folder: tempfile::TempDir,
    pool: Arc<SessionPool>,
    _stages: Vec<Arc<PreparedTask>>,
}

impl Table {
    async fn new(document: &Value, case: &Value, scene: Scene, tasks: Vec<Arc<Task>>) -> Self {
        let floats = |value: &Value| -> [f32; 3] {
            std::array::from_fn(|axis| value[axis].as_f64().unwrap() as f32)
        };
        let stand = |piece: &Value| {
            (
                text(&piece["name"]).to_owned(),
                piece["stand"].is_array().then(|| floats(&piece["stand"])),
            )
        };
        let vector = |values: &Value| {
            items(values)
                .iter()
                .map(|value| value.as_f64().unwrap())
                .collect()
        };
        let snug = case["snug"].as_object().into_iter().flatten();
        let tables = Arc::new(Tables {
            stands: items(&document["furniture"]).iter().map(stand).collect(),
            snug: snug
                .map(|(name, point)| (name.clone(), floats(point)))
                .collect(),
            embeddings: document["embeddings"]
                .as_object()
                .unwrap()
                .iter()
                .map(|(word, of)| (word.clone(), vector(of)))
                .collect(),
            now: Mutex::default(),
        });
        let (scene, folder) = (Arc::new(scene), tempfile::tempdir().unwrap());
        let stage = |task: &Arc<Task>| {
            PreparedTask::with_perception(
                scene.clone(),
                task.clone(),
                Meshes::default(),
                tables.clone(),
            )
        };
        let stages: Vec<Arc<PreparedTask>> = tasks.iter().map(stage).collect();
        let known = PreparedTaskCache::default();
        stages.iter().for_each(|stage| known.keep(stage));
        let setup = Setup {
            tasks,
            scenes: scene.into(),
            meshes: Meshes::default(),
            seed: 0,
            profile: if case["branch"] == "gspo" {
                Profile::RealGspo
            } else {
                Profile::RealRepo
            },
            skills: Skills::Perfect,
            preset: Preset::paper(),
            run_id: "case".to_owned(),
            folder: folder.path().to_owned(),
            answer_settings: Default::default(),
            options: Images::None.into(),
            host: Host::default(),
            stages: known,
            on_finished: Default::default(),
        };
        let [park_after, close_after, patience] = [60, 600, 60].map(Duration::from_secs);
        let limits = Limits {
            sessions: 1,
            sessions_each: 1,
            in_memory: 1,
            workers: 1,
            suspend_after: park_after,
            close_after,
            worker_timeout: patience,
        };
        let pool = Arc::new(SessionPool::new(setup, limits));
        let worker = Worker::named("case").unwrap();
        let server = ToolServer::of_worker(
            pool.clone(),
            Arc::default(),
            Arc::new(ToolServerOptions::default()),
            worker,
        );
        let (theirs, ours) = tokio::io::duplex(1 << 20);
        tokio::spawn(async move { server.serve(ours).await.unwrap().waiting().await });
        let client = Client::new(theirs).await;
        Self {
            client,
            tables,
            folder,
            pool,
            _stages: stages,
        }
    }

    /// Makes a call; the items of the answer as the vectors have them.
    async fn call(&mut self, step: &Value) -> Value {
        let visible = items(&step["visible"])
            .iter()
            .map(|name| text(name).to_owned())
            .collect();
        *self.tables.now.lock().unwrap() = Now {
            visible,
            drawn: None,
        };
        let call = &step["call"];
        let params = json!({ "name": call["name"], "arguments": call["arguments"] });
        let result = self.client.ask("tools/call", params).await;
        assert_ne!(result["isError"], true, "{result}");
        items(&result["content"]).iter().map(item).collect()
    }

    /// Ends the session; every recorded step, the steps of physics before the first call
    /// of an episode included.
    async fn records(self) -> Vec<(StepRecord, u64)> {
        let Self {
            client,
            folder,
            pool,
            ..
        } = self;
        drop(client);
        pool.close_all().await;
        let mut records = Vec::new();
        for path in reel_vectors::traces_in(folder.path()) {
            let mut before = START_STEPS;
            for step in Trace::read(&path).unwrap().steps {
                let steps = step.sim_step - before;
                before = step.sim_step;
                records.push((step, steps));
            }
        }
        records
    }
}

fn item(block: &Value) -> Value {
    if block["type"] == "image" {
        let png = base64::Engine::decode(
            &base64::engine::general_purpose::STANDARD,
            text(&block["data"]),
        )
        .unwrap();
        assert_eq!(
            (&png[16..20], &png[20..24]),
            (&640u32.to_be_bytes()[..], &480u32.to_be_bytes()[..])
        );
        return json!({ "type": "image", "mimeType": block["mimeType"] });
    }
    let said = text(&block["text"]);
    let parsed = |text: &str| serde_json::from_str::<Value>(text).ok();
    if let Some(debug) = said.strip_prefix("Debug Info:\n").and_then(parsed) {
        return json!({ "type": "text", "debug": debug });
    }
    match parsed(said).filter(|payload| payload.get("task_id").is_some()) {
        Some(payload) => json!({ "type": "text", "json": payload }),
        None => json!({ "type": "text", "text": said }),
    }
}

/// After a pick the order of what stands somewhere is that of a hash set in the published code.
fn unordered(result: &mut Value) {
    for item in result.as_array_mut().unwrap() {
        let Some(debug) = item.get_mut("debug") else {
            continue;
        };
        for state in debug["world_graph"].as_object_mut().unwrap().values_mut() {
            state["content"]
                .as_array_mut()
                .unwrap()
                .sort_by_key(Value::to_string);
        }
        let lines = text(&debug["WORLD_GRAPH"]).lines().map(|line| {
            let mut characters: Vec<&str> = line
                .split(|c: char| " [],".contains(c))
                .filter(|word| !word.is_empty())
                .collect();
            characters[1..].sort_unstable();
            characters.join(" ")
        });
        debug["WORLD_GRAPH"] = lines.collect::<Vec<_>>().join("\n").into();
    }
}

/// The first difference of one call: the answer, then what was drawn.
fn compare(step: &Value, found: &Value, after_pick: bool, now: &Now) -> Option<String> {
    let mut expected: Value = serde_json::from_str(
        &step["result"]
            .to_string()
            .replace(TOKEN, &TRACEBACK.replace('\n', "\\n")),
    )
    .unwrap();
    let mut found = found.clone();
    if after_pick {
        unordered(&mut expected);
        unordered(&mut found);
    }
    let drawn = now.drawn.as_ref();
    let marks = json!([
        drawn.map(|(labels, _)| labels),
        drawn.map(|(_, opacity)| opacity)
    ]);
    difference(&expected, &found, KeyOrder::Same).or_else(|| {
        difference(
            &json!([step["marks"], step["mark_alpha"]]),
            &marks,
            KeyOrder::Same,
        )
    })
}

/// The first difference of what was recorded of a call: physics steps, text, and what
/// became of the simulator.
fn compare_record(step: &Value, found: &Value, record: &StepRecord, steps: u64) -> Option<String> {
    let told = found[0].get("text").map_or("", text);
    if record.outcome.text != told {
        return Some(format!("recorded {:?}, told {told:?}", record.outcome.text));
    }
    let moved = items_or_none(&step["simulator"]).iter().find_map(|event| {
        let (kind, of) = text(&event[0])
            .split_once(':')
            .unwrap_or((text(&event[0]), ""));
        let point =
            |values: &[f32]| -> Vec<f64> { values.iter().map(|value| f64::from(*value)).collect() };
        let far = |at: &[f64], most: f64| {
            at.iter()
                .zip(items(&event[1]))
                .any(|(at, to)| (at - to.as_f64().unwrap()).abs() > most)
        };
        let body = || record.bodies.iter().find(|body| body.body == of);
        let wrong = match kind {
            "camera" => far(&point(&record.robot.camera), 1e-6),
            // Out of the way there, out of the world here.
            "pose" if event[1][0] == -100.0 => {
                record.held.as_ref().is_none_or(|held| held.as_str() != of)
            }
            "pose" => body().is_none_or(|body| far(&point(&body.position[..2]), REST_M)),
            "hide" => body().is_some(),
            "show" => body().is_none(),
            "door_angle" => record.changes.registry.is_empty() || record.changes.physics.is_empty(),
            _ => true,
        };
        wrong.then(|| {
            format!(
                "simulator: expected {event}, found {:?} {:?}",
                record.robot.camera,
                body()
            )
        })
    });
    moved.or_else(|| {
        (step["physics_steps"] != steps).then(|| {
            format!(
                "physics steps: expected {}, found {steps}",
                step["physics_steps"]
            )
        })
    })
}

fn items_or_none(value: &Value) -> &[Value] {
    if value.is_null() { &[] } else { items(value) }
}

/// What has to stay different in a case, from which call on.
fn deviation(case: &Value, at: usize) -> Option<&'static str> {
    match text(&case["id"]) {
        "ask-plan-text" => Some(TEXT_PLANS),
        "finish-twice" if at == 6 => Some(AFTER_THE_END),
        "highlight-special-prims" if at == 2 => Some(PRIMS),
        _ => None,
    }
}

#[tokio::test]
async fn real_contract_server() {
    let Some(document) = load("server.json") else {
        return;
    };
    let mut report = Report::new("server.json", "calls");
    for case in items(&document["cases"]) {
        let id = text(&case["id"]);
        let (scene, tasks) = match &case["task"] {
            Value::String(name) if name != "default" => match bench(name) {
                Some(found) => found,
                None => continue,
            },
            file => {
                let scene = scene(&document["furniture"]);
                let file = if file.is_string() {
                    &document["default_task"]
                } else {
                    file
                };
                let tasks = tasks(file, &scene);
                (scene, tasks)
            }
        };
        let mut table = Table::new(&document, case, scene, tasks).await;
        let (mut answers, mut after_pick, mut differences) = (Vec::new(), false, Vec::new());
        for (at, step) in items(&case["steps"]).iter().enumerate() {
            if deviation(case, at).is_some() {
                answers.push(Value::Null);
                differences.push(None);
                continue;
            }
            let found = table.call(step).await;
            after_pick |= step["call"]["name"] == "pick" && step["physics_steps"] == 720;
            differences.push(compare(
                step,
                &found,
                after_pick,
                &table.tables.now.lock().unwrap(),
            ));
            answers.push(found);
        }
        // Every call of an episode is recorded, in order, those apart that only begin one.
        let mut records = table.records().await.into_iter();
        for (at, step) in items(&case["steps"]).iter().enumerate() {
            if let Some(cause) = deviation(case, at) {
                report.deviation(cause);
                continue;
            }
            let begun = items(&case["steps"])[..at]
                .iter()
                .any(|step| step["call"]["name"] == "finish");
            let over = items(&case["steps"])[..at]
                .iter()
                .any(|step| step["result"][0]["text"] == "All evaluation episodes completed.");
            let difference = differences[at].take().or_else(|| {
                match (begun && !over, step["call"]["name"] == "finish") {
                    (false, _) => None,
                    (true, true) => records.next().is_none().then(|| "not recorded".to_owned()),
                    (true, false) => match records.next() {
                        Some((record, steps)) => compare_record(step, &answers[at], &record, steps),
                        None => Some("not recorded".to_owned()),
                    },
                }
            });
            report.count(&format!("{id}, call {at}, {}", step["call"]), difference);
        }
    }
    report.finish();
}

#[test]
fn real_contract_tool_lists() {
    let Some(document) = load("trainer_contract.json") else {
        return;
    };
    let mut report = Report::new("trainer_contract.json", "tool_lists");
    for list in items(&document["tool_lists"]) {
        let profile = match text(&list["id"]) {
            "main" => Profile::RealRepo,
            "gspo" => Profile::RealGspo,
            _ => continue,
        };
        let ours: Vec<Value> = reel_mcp::tools(profile)
            .iter()
            .map(|tool| {
                let mut schema = Value::Object((*tool.input_schema).clone());
                for property in schema["properties"].as_object_mut().unwrap().values_mut() {
                    property.as_object_mut().unwrap().remove("description");
                }
                json!({ "name": tool.name, "inputSchema": schema })
            })
            .collect();
        report.compare(text(&list["id"]), &list["tools"], &json!(ours));
    }
    report.finish();
}
