"""LeRobot datasets of Reel with their own readers: LeRobot 0.6 loads them, decodes every frame and resolves the words of each; and
lerobot-doctor finds no failure, but for its own of language columns. Where the packages cannot be installed, it says so.

    REEL=~/.cache/reel/debug/reel python3 tests/formats/robot_datasets.py [--short]

The short form leaves out the dataset with frames between decisions.
"""

import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
REEL = os.environ.get("REEL", "reel")
WIDTH, HEIGHT = 160, 120
# What lerobot-doctor says of lists whose length differs.
OF_LENGTHS = re.compile(
    r"""\d+ shape mismatch\(es\) across episodes: \[(\(\d+, 'language_persistent', '[^']*'\)(, )?)+\]"""
    r"""|Episode \d+, feature 'language_events': inconsistent shapes within episode: .*"""
)
STATISTICS = {"min": 0.0, "max": 1.0, "q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def reel(folder, *arguments, code=0):
    done = subprocess.run([REEL, *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    assert done.returncode == code, f"reel {arguments}: {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout


def loaded(folder, name):
    """A dataset as a trainer opens it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset(f"reel/{name}", root=folder / name, video_backend="pyav")


def frames_agree(folder, name, told):
    """Every frame decodes at its time and says what the tables do; the dataset's length is that which Reel printed."""
    dataset = loaded(folder, name)
    assert (dataset.num_frames, dataset.num_episodes, dataset.fps) == (told["frames"], told["episodes"], told["fps"])
    at = 0
    for episode in dataset.meta.episodes:
        assert episode["dataset_from_index"] == at
        for frame in range(episode["length"]):
            item = dataset[at]
            assert (item["frame_index"].item(), item["episode_index"].item()) == (frame, episode["episode_index"])
            assert abs(item["timestamp"].item() - frame / dataset.fps) < 1e-4
            assert item["task"] == episode["tasks"][0]
            image = item["observation.images.head"]
            assert tuple(image.shape) == (3, HEIGHT, WIDTH) and 0 <= image.min() and 0.1 < image.max() <= 1
            assert item["next.done"].item() == (frame == episode["length"] - 1)
            at += 1
    assert at == len(dataset)
    return dataset


def images_agree(folder, dataset, trace):
    """The video shows what the trace's images show: the mean difference is small."""
    import numpy
    from PIL import Image

    reel(folder, "trace", "frames", trace, "--out", "images")
    header = json.loads(reel(folder, "show", trace, "--json"))["header"]
    [episode] = [one for one in dataset.meta.episodes if one["reel/episode_id"] == header["episode_id"]]
    compared = 0
    for index in range(episode["dataset_from_index"], episode["dataset_to_index"]):
        item = dataset[index]
        call = item["call.index"].item()
        image = folder / "images" / ("start.png" if call == 0 else f"call_{call - 1:03}.png")
        if item["call.phase"].item() != 0 or not image.exists():
            continue
        expected = numpy.asarray(Image.open(image).convert("RGB").resize((WIDTH, HEIGHT)), dtype=numpy.float32)
        found = item["observation.images.head"].permute(1, 2, 0).numpy() * 255
        assert abs(found - expected).mean() < 6, f"call {call}: {abs(found - expected).mean()}"
        compared += 1
    assert compared > 1
    print(f"{compared} decoded frames show the images of the trace")


def words_resolve(folder, dataset):
    """The active subtask of each frame is one, and each decision holds one call of a declared tool."""
    from lerobot.datasets.language_render import active_at

    tools = {tool["function"]["name"] for tool in dataset.meta.tools}
    subtasks, calls = set(), 0
    for index in range(len(dataset)):
        item = dataset[index]
        row = active_at(item["timestamp"].item(), persistent=item["language_persistent"], style="subtask")
        subtasks.add(row["content"])
        said = [row for row in item["language_events"] if row["role"] == "assistant"]
        assert len(said) == (item["call.phase"].item() == 0)
        for event in said:
            [call] = [json.loads(call) if isinstance(call, str) else call for call in event["tool_calls"]]
            assert call["type"] == "function" and call["function"]["name"] in tools, f"{call}"
            calls += 1
    assert len(subtasks) > 2, f"{subtasks}"
    print(f"{calls} calls and {len(subtasks)} subtasks resolve")
    return calls


def statistics_agree(dataset):
    """NumPy computes the statistics from the frames that LeRobot loads."""
    import numpy

    for name in ("observation.state", "action", "next.reward", "timestamp", "call.tool"):
        values = numpy.asarray(dataset.hf_dataset.with_format("numpy")[name], dtype=numpy.float64).reshape(len(dataset), -1)
        stored = dataset.meta.stats[name]
        assert stored["count"].item() == len(dataset)
        expected = {"mean": values.mean(axis=0), "std": values.std(axis=0)}
        for statistic, quantile in STATISTICS.items():
            expected[statistic] = numpy.quantile(values, quantile, axis=0, method="inverted_cdf")
        for statistic, value in expected.items():
            numpy.testing.assert_allclose(stored[statistic], value, rtol=1e-6, atol=1e-6, err_msg=f"{name} {statistic}")
    pixels = numpy.stack([dataset[index]["observation.images.head"].numpy() for index in range(len(dataset))])
    stored = dataset.meta.stats["observation.images.head"]["mean"]
    assert stored.shape == (3, 1, 1)
    numpy.testing.assert_allclose(stored.reshape(3), pixels.mean(axis=(0, 2, 3)), atol=0.02)


def doctor_passes(folder, name, language):
    """No check fails. Where there are language columns, lerobot-doctor 0.2 takes those of LeRobot 0.6 for vectors of one length."""
    doctor = pathlib.Path(sys.executable).parent / "lerobot-doctor"
    done = subprocess.run([doctor, "check", folder / name, "--ci"], capture_output=True, text=True)
    messages = [message for check in json.loads(done.stdout)["checks"] for message in check["messages"]]
    failed = [message["message"] for message in messages if message["severity"] == "FAIL"]
    if language:
        assert failed and all(OF_LENGTHS.fullmatch(message) for message in failed), f"{failed}"
        failed = []
    assert len(messages) > 20 and not failed, f"{failed}"
    print(done.stderr.strip().splitlines()[-1])


def batches_train(dataset):
    """A data loader of PyTorch makes batches with the frames before and the actions after."""
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    step = 1 / dataset.fps
    windows = LeRobotDataset(
        dataset.repo_id, root=dataset.root, video_backend="pyav",
        delta_timestamps={"observation.images.head": [-step, 0.0], "action": [0.0, step, 2 * step]},
    )
    keys = ("observation.images.head", "action", "action_is_pad")
    loader = torch.utils.data.DataLoader(windows, batch_size=4, collate_fn=lambda items: {key: torch.stack([item[key] for item in items]) for key in keys})
    batch = next(iter(loader))
    assert batch["observation.images.head"].shape == (4, 2, 3, HEIGHT, WIDTH) and batch["action"].shape == (4, 3, 5)


def main():
    if "--inside" not in sys.argv:
        made = subprocess.run([HERE.parent / "python.sh", "lerobot"], capture_output=True, text=True)
        if made.returncode:
            print(f"skipped: python: LeRobot cannot be installed: {made.stderr.strip()[-300:]}")
            return 0
        return subprocess.run([made.stdout.strip(), "-W", "ignore", __file__, "--inside", *sys.argv[1:]]).returncode
    os.environ["HF_HUB_OFFLINE"] = "1"
    with tempfile.TemporaryDirectory(prefix="reel-lerobot-") as folder:
        folder = pathlib.Path(folder)
        os.environ["HF_HOME"] = str(folder / "hf")
        reel(folder, "task", "generate", "--count", 3, "--seed", 3, "--out", "tasks")
        reel(folder, "run", "--tasks", "tasks", "--policy", "planner", "--out", "traces")
        trace = sorted((folder / "traces").glob("*.mcap"))[0]
        calls = []
        size = ["--camera-size", f"{WIDTH}x{HEIGHT}"]
        forms = {"decisions": ["--marks"], "motion": ["--fps", 5], "wordless": ["--no-language"]}
        if "--short" in sys.argv:
            del forms["motion"]
        for name, options in forms.items():
            told = json.loads(reel(folder, "export", "lerobot", "traces", "--out", name, *size, *options, "--json"))
            assert told["episodes"] == 3, f"{told}"
            dataset = frames_agree(folder, name, told)
            statistics_agree(dataset)
            batches_train(dataset)
            doctor_passes(folder, name, language=name != "wordless")
            if name == "wordless":
                assert told["frames"] == calls[0] and not any("language" in column for column in dataset.features)
                continue
            calls.append(words_resolve(folder, dataset))
            if name == "decisions":
                images_agree(folder, dataset, trace)
                assert told["frames"] == calls[0]
            else:
                assert told["frames"] > 2 * calls[0]
        assert len(set(calls)) == 1
        print(f"LeRobot 0.6 loads {', '.join(forms)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
