//! Everything that tells of a single trace: the tables, REST, what commands print. Each tells the
//! bits of the records.

use std::{collections::BTreeMap, path::Path};

use reel_trace::Trace;
use serde_json::{Value, json};

use super::{
    Disagreements, PRESETS, Tables, bits_of, bounds, classes,
    play::{index_of, name},
    rows, terms,
};
use crate::server::Server;

/// Metrics of an episode that tables and REST both have.
const METRICS: [&str; 5] = ["success", "completion", "total_reward", "length", "asks"];

/// Everything that tells of a single trace.
pub(super) struct Surfaces<'a> {
    folder: &'a Path,
    server: Server,
    /// What `reel blame --json` printed, table `blame`, the SQL function `blame` and table
    /// `classes`, after the decisive steps were measured.
    printed: BTreeMap<usize, Value>,
    blame: BTreeMap<usize, Value>,
    computed: BTreeMap<usize, Value>,
    classes: BTreeMap<usize, Value>,
}

impl<'a> Surfaces<'a> {
    pub(super) fn open(folder: &'a Path) -> Self {
        let printed = reel!(folder, "blame data/traces --no-alternatives --json");
        let printed = printed.lines().map(|line| {
            let report: Value = serde_json::from_str(line).unwrap();
            (index_of(report["trace"].as_str().unwrap()), report)
        });
        let printed = printed.collect();
        reel!(folder, "blame --store data/store --no-alternatives");
        let said = reel!(folder, "taxonomy --store data/store --json");
        let mut said: Vec<Value> = said
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        let classes = classes(folder);
        for class in classes.values() {
            let mut class = class.clone();
            class.as_object_mut().unwrap().remove("trace");
            let place = said.iter().position(|said| *said == class);
            said.swap_remove(place.unwrap_or_else(|| panic!("the command did not print {class}")));
        }
        assert_eq!(said, Vec::<Value>::new());
        Self {
            folder,
            server: Server::start(folder),
            printed,
            blame: rows(
                folder,
                "SELECT e.trace, b.* FROM blame b JOIN episodes e USING (episode_id)",
            ),
            computed: rows(
                folder,
                "SELECT trace, blame(trace) AS blame FROM episodes WHERE NOT success",
            ),
            classes,
        }
    }

    /// What every surface tells of a trace is what its records hold.
    pub(super) fn compare(
        &self,
        found: &mut Disagreements,
        index: usize,
        trace: &Trace,
        tables: &Tables,
    ) {
        let (name, row) = (name(index), &tables.episodes[&index]);
        let what = |surface: &str| format!("{} of run {}: {surface}", name, trace.header.run_id);
        let end = trace.end.as_ref().unwrap();
        let (own, metrics) = (terms(&trace.steps), json!(end.metrics));
        let of_json = |steps: &Value, key: &str| -> Vec<_> {
            let steps = steps.as_array().unwrap().iter();
            steps.map(|step| bits_of(&step[key])).collect()
        };

        for key in METRICS.iter().chain(&["discounted_return"]) {
            found.compare(&what(&format!("episodes.{key}")), &row[key], &metrics[key]);
        }
        found.compare(
            &what("episodes.end_reason"),
            &row["end_reason"],
            &json!(end.reason),
        );
        found.compare(&what("steps.terms"), &of_json(&row["steps"], "terms"), &own);

        let open = json!(bounds(trace).map(|bounds| bounds.to_string()));
        let get = |path: &str| self.server.get(&format!("traces/{name}/{path}"));
        let episode = get("episode");
        found.compare(&what("GET episode"), &episode["end"]["metrics"], &metrics);
        found.compare(&what("GET episode"), &episode["open_reward"], &open);
        let steps = get("steps?limit=1000");
        found.compare(&what("GET steps"), &of_json(&steps, "reward"), &own);
        let reward = get("reward");
        found.compare(
            &what("GET reward"),
            &of_json(&reward["steps"], "terms"),
            &own,
        );
        found.compare(
            &what("GET reward"),
            &reward["total"],
            &metrics["total_reward"],
        );
        found.compare(&what("GET reward"), &reward["open_reward"], &open);
        for preset in PRESETS {
            let scored = &tables.scored[&(index, preset)][0];
            let total = &get(&format!("reward?preset={preset}"))["total"];
            found.compare(&what(preset), total, scored);
        }
        // A process for each trace takes its time.
        if index.is_multiple_of(8) {
            let shown = reel!(self.folder, "show data/traces/{name}.mcap --json");
            let shown: Value = serde_json::from_str(&shown).unwrap();
            found.compare(&what("show"), &of_json(&shown["steps"], "reward"), &own);
            found.compare(&what("show"), &shown["end"]["metrics"], &metrics);
            found.compare(&what("show"), &shown["open_reward"], &open);
        }
        self.compare_reasons(found, index, row, &what);
    }

    /// Every surface tells the same decisive step and class.
    fn compare_reasons(
        &self,
        found: &mut Disagreements,
        index: usize,
        row: &Value,
        what: &dyn Fn(&str) -> String,
    ) {
        let without_trace = |row: &Value| {
            let mut row = row.clone();
            row.as_object_mut().unwrap().remove("trace");
            row
        };
        let path = format!("traces/{}/blame", name(index));
        let measured = without_trace(&self.server.get(&path));
        let printed = without_trace(&self.printed[&index]);
        found.compare(&what("reel blame"), &printed, &measured);
        let (blame, class) = (self.blame.get(&index), self.classes.get(&index));
        if let Some(blame) = blame {
            let decisive = ["step", "tool", "harm", "cause", "explanation"];
            let whole = ["wasted_steps", "point_of_no_return", "repairable_at_end"];
            let shares = measured["shares"].as_object().unwrap();
            let expected = decisive
                .iter()
                .map(|key| (*key, measured["decisive"].get(key).unwrap_or(&Value::Null)))
                .chain(whole.iter().map(|key| (*key, &measured[key])))
                .chain(shares.iter().map(|(key, share)| (key.as_str(), share)));
            for (key, expected) in expected {
                let computed = &self.computed[&index]["blame"][key];
                found.compare(&what(&format!("blame.{key}")), &blame[key], expected);
                found.compare(&what(&format!("blame().{key}")), computed, expected);
            }
        }
        if index.is_multiple_of(4) {
            let id = row["episode_id"].as_str().unwrap();
            let episode = self.server.get(&format!("episodes/{id}"));
            for (key, row) in [("classes", class), ("blame", blame)] {
                let rows: Vec<Value> = row.map(without_trace).into_iter().collect();
                found.compare(&what("GET episodes"), &episode[key], &json!(rows));
            }
            for key in METRICS {
                found.compare(&what("GET episodes"), &episode[key], &row[key]);
            }
        }
    }
}
