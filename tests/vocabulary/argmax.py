"""Open vocabulary against an argmax of its own: the oracle plays tasks with vectors from a file, and what every search meant is
computed again here, with exact arithmetic, from the tables and the file.

Several words share a direction, so that a search often means another category than its word: of equal similarities the first name
in alphabetical order counts. usage: argmax.py REEL TASKS FOLDER [PROFILE ...]
"""

import fractions
import json
import pathlib
import random
import subprocess
import sys

DIRECTIONS = [(2, 1, 0), (1, -1, 2)]
SEARCHES = """
SELECT e.episode_id, s.step, s.argument AS query, s.match_source, s.match_categories, e.task_digest
FROM steps s JOIN episodes e ON e.episode_id = s.episode_id WHERE s.tool = 'show_object_by_category'
"""


def main(reel, tasks, folder, profiles):
    def run(*arguments, fine=(0,)):
        done = subprocess.run([reel, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode in fine, f"reel {' '.join(map(str, arguments))}: {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        return done.stdout

    def query(store, sql):
        return json.loads(run("query", "--store", store, "--format", "json", sql))

    def play(name, *arguments):
        run("run", "--tasks", tasks, "--no-images", "--out", folder / name, *arguments, fine=(0, 3))
        run("ingest", folder / name, "--store", folder / f"{name}-store")
        return folder / f"{name}-store"

    store = play("words")
    categories = {}
    for row in query(store, "SELECT task_digest, category FROM objects"):
        categories.setdefault(row["task_digest"], set()).add(row["category"])
    texts = set().union(*categories.values()) | {row["query"] for row in query(store, SEARCHES)}
    draw = random.Random(35)
    vectors = {}
    for text in sorted(texts):
        scale = 2 ** draw.randrange(4)
        vectors[text] = [scale * part for part in draw.choice(DIRECTIONS)]
    path = folder / "vectors.json"
    path.write_text(json.dumps(vectors))

    def similarity(one, other):
        """The cosine, squared with its sign: exact."""
        dot = sum(a * b for a, b in zip(one, other))
        return fractions.Fraction(dot * abs(dot), sum(a * a for a in one) * sum(b * b for b in other))

    def meant(text, names):
        return min(names, key=lambda name: (-similarity(vectors[text], vectors[name]), name))

    for profile in profiles:
        store = play(profile, "--profile", profile, "--embedding-vectors", path)
        rows = query(store, SEARCHES)
        assert rows, "the oracle searched for nothing"
        other = 0
        for row in rows:
            expected = meant(row["query"], categories[row["task_digest"]])
            assert (row["match_source"], row["match_categories"]) == ("vectors.json", [expected]), f"{row}: {expected}"
            other += expected != row["query"]
        verdict = run("replay", folder / profile).splitlines()[-1]
        count = len(list((folder / profile).glob("*.mcap")))
        print(f"{profile}: {len(rows)} searches of {len({row['episode_id'] for row in rows})} episodes mean what the argmax says, "
              f"{other} of them another category than their word; {verdict}")  # fmt: skip
        assert other, "no search meant another category: the vectors test nothing"
        assert verdict.startswith(f"{count} of {count} traces replay exactly"), verdict


if __name__ == "__main__":
    reel, tasks, folder, *profiles = sys.argv[1:]
    main(reel, tasks, pathlib.Path(folder), profiles or ["paper", "real-gspo"])
