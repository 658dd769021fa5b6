"""Reads the answers of training sets with the four published parsers, and counts the actions and memories that each would lose.
Marker ids have to be texts, as the published schema wants them.

check_answers.py PATH...    # files (.parquet, .json, .jsonl) of `reel export sft` in any format, or folders of them
"""

import argparse
import json
import sys
from pathlib import Path

import answers
import vectors
from vectors import Report

METADATA = {"manifest.json", "dataset_info.json"}


def rows_of(path):
    """The rows of a file."""
    if path.suffix == ".parquet":
        import pyarrow.parquet

        for batch in pyarrow.parquet.ParquetFile(path).iter_batches():
            yield from batch.to_pylist()
        return
    text = path.read_text(encoding="utf-8")
    try:
        document = json.loads(text)
        yield from document if isinstance(document, list) else [document]
    except ValueError:
        for line in text.splitlines():
            yield json.loads(line)


def answers_of(value):
    """The texts of the assistant's turns anywhere in a row."""
    if isinstance(value, list):
        for item in value:
            yield from answers_of(item)
    elif isinstance(value, dict):
        content = (
            value.get("content")
            if value.get("role") == "assistant"
            else value.get("value")
            if value.get("from") == "gpt"
            else None
        )
        if isinstance(content, list):
            content = "".join(part.get("text") or "" for part in content)
        if isinstance(content, str):
            yield content
        else:
            for item in value.values():
                yield from answers_of(item)


def called(action):
    """Name and arguments of an action as a memory keeps it, or `None`."""
    return answers.call_of(action) if isinstance(action, dict) else None


def read(text):
    """What each parser makes of an answer: its call or `None`, and its memory."""
    try:
        parsed = answers.parse_agent(text)
        agent = (parsed["tool_name"], parsed["arguments"]), parsed["summary"]
    except answers.Unreadable:
        agent = None, {}
    try:
        parsed = answers.parse_trainer(text)
        trainer = parsed["tool_name"], parsed["arguments"]
    except answers.Unreadable:
        trainer = None
    gym, scheduler = answers.GymMemory(), answers.SchedulerMemory()
    gym.read(text)
    scheduler.read(text)
    lines = [line for line in scheduler.lines if line != answers.PARSE_FAILED]
    return {
        "agent": agent,
        "trainer": (trainer, None),
        "gym": (called(gym.last_action), gym.task_progress),
        "scheduler": (called(scheduler.last_action), lines),
    }


def check(path, reports):
    """Checks every answer of a file. Returns how many there are."""
    count = 0
    for row in rows_of(path):
        for text in answers_of(row):
            count += 1
            made = read(text)
            wanted = made["trainer"][0]
            for parser, (action, memory) in made.items():
                label = f"{path.name} answer {count}"
                reports[parser, "actions"].check(
                    label, action is not None and action == wanted, f"{action}, not {wanted}: {text[:200]!r}"
                )
                if parser == "trainer" and action and "marker_id" in action[1]:
                    marker = action[1]["marker_id"]
                    reports[parser, "markers"].check(label, isinstance(marker, str), f"marker_id {marker!r} is no text")
                if memory is not None:
                    reports[parser, "memory"].check(label, bool(memory), f"empty: {text[:200]!r}")
    return count


def files_of(path):
    if path.is_file():
        return [path]
    return sorted(
        file for file in path.rglob("*") if file.suffix in (".parquet", ".json", ".jsonl") and file.name not in METADATA
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path)
    arguments = parser.parse_args()
    for path in arguments.paths:
        parts = [(name, "actions") for name in ("agent", "trainer", "gym", "scheduler")]
        parts += [("trainer", "markers")] + [(name, "memory") for name in ("agent", "gym", "scheduler")]
        reports = {part: Report(path.name, " ".join(part)) for part in parts}
        for file in files_of(path):
            check(file, reports)
        for report in reports.values():
            report.finish()
    return vectors.exit_status()


if __name__ == "__main__":
    sys.exit(main())
