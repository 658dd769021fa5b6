"""Whether task files are exactly as REAL-Bench publishes them: a strict validator from the description of the published data alone.

    python3 real_schema.py SCENE.json FOLDER...

Knows nothing of how Reel makes or reads tasks. Every finding is a line `file: path: what`; the exit code is 1 if there is one.
What the published files themselves do oddly is allowed: the same asset on several receptacles, goals that do not conserve
objects, the destination among the source's distractors, other words for a category among the final positions, distractors of no
size that stand nowhere, furniture with doors left out of the graphs.
"""

import json
import pathlib
import sys

import yaml

FAMILIES = ("FDP", "FODP", "FDO", "SUL")
ROOT = {"scene_id", "paths", "objects", "episodes"}
PATHS = {"scene_usd", "occ_map_dir", "furniture_lib"}
OBJECT = {"original_id", "category", "usd_path", "usd_scale", "position", "size"}
EPISODE = {
    "benchmark_task_id", "family", "task_id", "episode_idx", "original_idx", "global_index", "benchmark_instruction", "scene_id",
    "task_description", "initial_world_graph", "goal_world_graph", "src", "src_distractors", "dest", "dest_distractors", "obj_meta",
    "obj_distractors", "execution_plan", "placements", "final_positions", "target_object_id",
}
BY_FAMILY = {
    "FDP": {"obj_distractor_meta"},
    "FODP": {"obj_distractor_meta"},
    "FDO": {"task_type"},
    "SUL": {"obj_distractor_meta", "fuzzy_task_description", "physics_task_description", "purpose", "purpose_group"},
}
AT_RECEPTACLE = {"nav_to", "place", "open", "close"}
AT_OBJECT = {"find", "gaze_at", "pick"}
GAP_M = 0.02
DROP_M = 0.1
MARGIN_M = 0.05
# Published heights of surfaces are rounded to a tenth of a millimetre.
TOLERANCE_M = 2e-4


class Validator:
    def __init__(self, scene):
        self.receptacles = {one["id"]: one for one in scene["receptacles"]}
        self.doors = {one["id"] for one in scene["receptacles"] if one.get("door")}
        self.scene_id = scene["scene_id"]
        self.findings = []
        self.file = ""

    def check(self, good, path, what):
        if not good:
            self.findings.append(f"{self.file}: {path}: {what}")
        return good

    def keys(self, value, wanted, path):
        if not self.check(isinstance(value, dict), path, "is no mapping"):
            return False
        missing, unknown = sorted(wanted - set(value)), sorted(set(value) - wanted)
        return self.check(not missing and not unknown, path, f"missing {missing}, unknown {unknown}")

    def text(self, value, path):
        return self.check(isinstance(value, str) and value.strip() == value and value, path, f"is no text: {value!r}")

    def number(self, value):
        return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e4

    def vector(self, value, path):
        good = isinstance(value, list) and len(value) == 3 and all(self.number(one) for one in value)
        return self.check(good, path, f"is no vector of three numbers: {value!r}")

    def near(self, a, b, path, what):
        self.check(abs(a - b) <= TOLERANCE_M, path, f"{what}: {a} is not {b}")

    def validate(self, path):
        self.file = str(path)
        with open(path, encoding="utf-8") as file:
            root = yaml.safe_load(file)
        if not self.keys(root, ROOT, "root"):
            return
        self.check(root["scene_id"] == self.scene_id, "scene_id", f"is not {self.scene_id}")
        if self.keys(root["paths"], PATHS, "paths"):
            for key, value in root["paths"].items():
                self.text(value, f"paths.{key}")
        episodes = root["episodes"]
        if not self.check(isinstance(episodes, list) and len(episodes) == 1, "episodes", "is not one episode"):
            return
        episode = episodes[0]
        family = episode.get("family")
        if not self.check(family in FAMILIES, "episode.family", f"is {family!r}"):
            return
        if self.keys(episode, EPISODE | BY_FAMILY[family], "episode"):
            self.objects(root["objects"], family)
            self.episode(root["objects"], episode, family)

    def objects(self, objects, family):
        if not self.check(isinstance(objects, dict) and objects, "objects", "is no mapping with entries"):
            return
        wanted = OBJECT if family == "FDO" else OBJECT | {"detailed_caption"}
        for key, item in objects.items():
            path = f"objects.{key}"
            if not self.keys(item, wanted, path):
                continue
            for field in wanted - {"usd_scale", "position", "size"}:
                self.text(item[field], f"{path}.{field}")
            for field in ("usd_scale", "position", "size"):
                self.vector(item[field], f"{path}.{field}")
            self.check(min(item["size"]) > 0 and max(item["size"]) < 5, f"{path}.size", f"is {item['size']}")
            self.check(item["usd_path"].endswith(".usd"), f"{path}.usd_path", "names no USD file")

    def episode(self, objects, episode, family):
        check, texts = self.check, ["benchmark_task_id", "task_id", "benchmark_instruction", "task_description"]
        for field in texts + sorted(BY_FAMILY[family] - {"obj_distractor_meta"}):
            self.text(episode[field], f"episode.{field}")
        for field in ("episode_idx", "original_idx", "global_index"):
            value = episode[field]
            check(isinstance(value, int) and not isinstance(value, bool) and value >= 0, f"episode.{field}", f"is {value!r}")
        check(episode["benchmark_task_id"] == f"{family}/{episode['task_id']}", "episode.benchmark_task_id", "is not family/task_id")
        check(episode["scene_id"] == self.scene_id, "episode.scene_id", f"is not {self.scene_id}")
        for field in ("src", "dest"):
            check(episode[field] in self.receptacles, f"episode.{field}", f"{episode[field]} is not a receptacle")
        check(episode["src"] != episode["dest"], "episode.dest", "is the source")
        for field in ("src_distractors", "dest_distractors"):
            value = episode[field]
            good = isinstance(value, list) and len(set(value)) == len(value) and all(one in self.receptacles for one in value)
            check(good, f"episode.{field}", f"is no list of different receptacles: {value}")
        if family == "SUL":
            check(episode["benchmark_instruction"] == episode["fuzzy_task_description"], "episode", "does not tell the fuzzy instruction")
            check(episode["task_description"] == episode["physics_task_description"], "episode", "has two precise instructions")
            check(episode["fuzzy_task_description"] != episode["task_description"], "episode", "is not fuzzy")
        else:
            check(episode["benchmark_instruction"] == episode["task_description"], "episode", "does not tell the precise instruction")
        self.graphs(objects, episode, family)
        self.metas(objects, episode, family)
        self.plan(episode["execution_plan"], family)
        self.places(objects, episode)

    def graphs(self, objects, episode, family):
        for name in ("initial_world_graph", "goal_world_graph"):
            graph = episode[name]
            if not self.check(isinstance(graph, dict), name, "is no mapping"):
                return
            for id_, state in graph.items():
                path = f"{name}.{id_}"
                if not self.check(id_ in self.receptacles, path, "is not a receptacle of the scene"):
                    continue
                has_door = id_ in self.doors
                self.check(family == "FDO" or not has_door, path, "only FDO has furniture with doors")
                if self.keys(state, {"room", "content", "door"} if has_door else {"room", "content"}, path):
                    self.check(state["room"] == self.receptacles[id_]["room"], path, f"is not in {state['room']}")
                    good = isinstance(state["content"], list) and all(isinstance(one, str) for one in state["content"])
                    self.check(good, f"{path}.content", "is no list of assets")
                    self.check(not has_door or state["door"] is False, f"{path}.door", "does not start and end closed")
        missing = set(self.receptacles) - set(episode["initial_world_graph"])
        self.check(missing <= self.doors and (family != "FDO" or not missing), "initial_world_graph", f"leaves out {sorted(missing)}")
        if family == "FDO":
            kinds = {(False, True): "store", (True, False): "retrieve"}
            kind = kinds.get((episode["src"] in self.doors, episode["dest"] in self.doors))
            self.check(episode["task_type"] == kind, "episode.task_type", f"is {episode['task_type']}, not {kind}")
        for id_, state in episode["initial_world_graph"].items():
            placed = sorted(one["original_id"] for one in episode["placements"].values() if one["furniture"] == id_)
            self.check(sorted(state["content"]) == placed, f"initial_world_graph.{id_}", f"holds not what is placed there: {placed}")
        target, goal = episode["target_object_id"], episode["goal_world_graph"]
        content = lambda graph, id_: graph.get(id_, {}).get("content", [])
        self.check(target in content(episode["initial_world_graph"], episode["src"]), "target_object_id", "is not on the source")
        self.check(target in content(goal, episode["dest"]), "target_object_id", "shall not go to the destination")

    def metas(self, objects, episode, family):
        assets = {item["original_id"]: item for item in objects.values()}
        wanted = {"category", "size", "usd_path"} | (set() if family == "FDO" else {"detailed_caption"})
        sections = {"obj_meta": [episode["target_object_id"]]}
        if "obj_distractor_meta" in episode:
            sections["obj_distractor_meta"] = episode["obj_distractors"]
        else:
            self.check(episode["obj_distractors"] == [], "obj_distractors", "have no obj_distractor_meta")
        for section, of in sections.items():
            self.check(sorted(episode[section]) == sorted(of), section, f"is not about {of}")
            for asset, meta in episode[section].items():
                if self.keys(meta, wanted, f"{section}.{asset}"):
                    self.vector(meta["size"], f"{section}.{asset}.size")
                    self.check(asset not in assets or assets[asset]["size"] == meta["size"], f"{section}.{asset}", "has another size")

    def plan(self, plan, family):
        if not self.check(isinstance(plan, list) and plan, "execution_plan", "is no list with steps"):
            return
        about = {"target_category"} | (set() if family == "FDO" else {"target_description"})
        at = None
        for index, step in enumerate(plan):
            path = f"execution_plan[{index}]"
            if not self.keys(step, {"action", "args"}, path):
                continue
            action, args = step["action"], step["args"]
            if not self.check(action in AT_RECEPTACLE | AT_OBJECT, path, f"unknown action {action!r}"):
                continue
            if self.keys(args, {"receptacle_name"} if action in AT_RECEPTACLE else about, f"{path}.args"):
                for key, value in args.items():
                    self.text(value, f"{path}.args.{key}")
                if action in AT_RECEPTACLE:
                    self.check(args["receptacle_name"] in self.receptacles, path, "is about no receptacle of the scene")
            if action == "nav_to":
                at = args.get("receptacle_name")
            elif action in AT_RECEPTACLE:
                self.check(args.get("receptacle_name") == at, path, f"the robot stands at {at}")
        actions = [step.get("action") for step in plan]
        self.check(actions[0] == "nav_to" and actions.count("pick") == actions.count("place") == 1, "execution_plan", f"is {actions}")
        doors = actions.count("open") == actions.count("close") == (1 if family == "FDO" else 0)
        self.check(doors, "execution_plan", "opens and closes not as the family does")

    def places(self, objects, episode):
        placements, finals = episode["placements"], episode["final_positions"]
        self.check(set(placements) == set(finals), "final_positions", "are not those of the placements")
        self.check(set(placements) <= set(objects), "placements", "place what is no object")
        standing = {}
        for key, placement in placements.items():
            path, item = f"placements.{key}", objects.get(key)
            if not self.keys(placement, {"position", "furniture", "original_id"}, path) or item is None:
                continue
            receptacle = self.receptacles.get(placement["furniture"])
            if not self.check(receptacle is not None, path, "stands on no receptacle of the scene"):
                continue
            self.vector(placement["position"], path)
            self.check(placement["position"] == item["position"], path, "stands elsewhere than the object")
            self.check(placement["original_id"] == item["original_id"], path, "is another asset")
            self.check(key == f"{item['original_id']}_on_{receptacle['id']}_at_{episode['task_id']}", path, "has another name")
            top = receptacle["surface_max"][2]
            self.near(placement["position"][2], top + item["size"][2] / 2 + GAP_M, f"{path}.position", "height")
            for other, other_size in standing.setdefault(receptacle["id"], []):
                gaps = (abs(placement["position"][axis] - other[axis]) - (item["size"][axis] + other_size[axis]) / 2 for axis in (0, 1))
                self.check(max(gaps) >= MARGIN_M - TOLERANCE_M, path, "stands too near to another object")
            standing[receptacle["id"]].append((placement["position"], item["size"]))
            final, path = finals.get(key), f"final_positions.{key}"
            if final is None or not self.keys(final, {"initial_pos", "final_pos", "category", "original_id"}, path):
                continue
            self.vector(final["final_pos"], f"{path}.final_pos")
            for axis, drop in enumerate((0, 0, DROP_M)):
                self.near(final["initial_pos"][axis], placement["position"][axis] + drop, f"{path}.initial_pos", "spawned")
            self.check(final["original_id"] == item["original_id"], path, "is another asset")


def main():
    scene, *folders = sys.argv[1:]
    with open(scene, encoding="utf-8") as file:
        validator = Validator(json.load(file))
    files = sorted(path for folder in folders for path in pathlib.Path(folder).rglob("*.yaml"))
    for path in files:
        validator.validate(path)
    for finding in validator.findings:
        print(finding)
    print(f"{len(files)} files, {len(validator.findings)} findings")
    sys.exit(1 if validator.findings or not files else 0)


if __name__ == "__main__":
    main()
