"""The vector files of REAL's published code, and a report that compares a client of ours with them.

A report prints the line that `src/vectors` prints for the Rust side, so that one reader reads both:

    real-contract<TAB>FILE<TAB>PART<TAB>CASES<TAB>EQUAL<TAB>DIFFERENT<TAB>DEVIATING
"""

import json
import math
import os
import sys
from pathlib import Path

DIFFERENCES_SHOWN = 12
TOLERANCE = 1e-9
"""Vectors hold floats rounded to nine decimal places."""


def shared():
    """The folder beside the checkout in which the vectors and REAL-Bench lie."""
    return Path(__file__).resolve().parents[3] / "shared"


def folder():
    """The folder of the vector files, or `None` if there is none."""
    named = os.environ.get("REEL_REAL_CONTRACT")
    if named:
        if not Path(named).is_dir():
            sys.exit(f"REEL_REAL_CONTRACT names {named}, which is no folder")
        return Path(named)
    beside = shared() / "real-contract" / "vectors"
    return beside if beside.is_dir() else None


def load(name):
    """The document of a vector file. Fails if the folder of vectors is absent: callers ask `folder` first."""
    with open(folder() / name, encoding="utf-8") as file:
        return json.load(file)


def difference(expected, got, path="$"):
    """The first place in which two JSON values differ, or `None` if they are equal."""
    if isinstance(expected, bool) or isinstance(got, bool):
        return None if expected is got else f"{path}: expected {expected!r}, got {got!r}"
    if isinstance(expected, (int, float)) and type(expected) is type(got):
        return None if math.isclose(expected, got, rel_tol=0, abs_tol=TOLERANCE) else f"{path}: expected {expected}, got {got}"
    if isinstance(expected, dict) and isinstance(got, dict):
        for key in expected.keys() | got.keys():
            if key not in got:
                return f"{path}.{key}: missing, expected {expected[key]!r}"
            if key not in expected:
                return f"{path}.{key}: unexpected {got[key]!r}"
            found = difference(expected[key], got[key], f"{path}.{key}")
            if found:
                return found
        return None
    if isinstance(expected, list) and isinstance(got, list):
        if len(expected) != len(got):
            return f"{path}: expected {len(expected)} elements {expected!r}, got {len(got)} {got!r}"
        return next((found for i, pair in enumerate(zip(expected, got)) if (found := difference(*pair, f"{path}[{i}]"))), None)
    return None if type(expected) is type(got) and expected == got else f"{path}: expected {expected!r}, got {got!r}"


class Report:
    """Counts what is equal and what differs in one part of one file; `finish` prints it."""

    failed = False

    def __init__(self, file, part):
        self.file, self.part = file, part
        self.equal, self.differences = 0, []

    def compare(self, case, expected, got):
        """Counts a case, equal if both JSON values are. Returns whether they are."""
        found = difference(expected, got)
        return self.check(case, found is None, found)

    def check(self, case, holds, otherwise):
        """Counts a case that is equal if `holds`; `otherwise` says what is wrong."""
        if holds:
            self.equal += 1
        else:
            self.differences.append(f"{case}: {otherwise}")
        return bool(holds)

    def finish(self):
        """Prints the line of this part and the first differences. Every check of nothing is a difference."""
        if not self.equal and not self.differences:
            self.differences.append("nothing was compared")
        for text in self.differences[:DIFFERENCES_SHOWN]:
            print(f"  {self.file} {self.part}: {text}", file=sys.stderr)
        if len(self.differences) > DIFFERENCES_SHOWN:
            print(f"  {self.file} {self.part}: and {len(self.differences) - DIFFERENCES_SHOWN} more", file=sys.stderr)
        different = len(self.differences)
        print(f"real-contract\t{self.file}\t{self.part}\t{self.equal + different}\t{self.equal}\t{different}\t0", flush=True)
        Report.failed |= different > 0


def exit_status():
    """1 if a report of this process had a difference, otherwise 0."""
    return 1 if Report.failed else 0
