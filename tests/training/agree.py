"""How far two labellers who labelled failures blindly, and Reel, agree: class, sub-class and decisive step.

    python3 agree.py --reel reel --store store --index blind/index.json first.json second.json

A file of labels is {"NN": {"class": ..., "sub_class": ..., "step": n}}; the index (of transcripts.py) says which episode NN is. The store
needs `reel blame --store` and `reel taxonomy --store`. Shares have Wilson's 95% intervals. The baseline answers the most frequent class
and sub-class of the labeller that it is compared with, and the last call.
"""

import argparse
import collections
import json
import pathlib
import subprocess
import sys

from evaluate import wilson


def kappa(pairs):
    """Cohen's kappa of (one, other); None where both always say the same one thing."""
    ones, others = (collections.Counter(side) for side in zip(*pairs))
    chance = sum(ones[name] * others[name] for name in ones) / len(pairs) ** 2
    same = sum(one == other for one, other in pairs) / len(pairs)
    return None if chance == 1 else (same - chance) / (1 - chance)


def rate(hits):
    low, high = wilson(sum(hits), len(hits))
    return f"{sum(hits):3} of {len(hits)}  {100 * sum(hits) / len(hits):5.1f}% ({100 * abs(low):.0f} to {100 * high:.0f})"


def compare(title, ones, others):
    """Prints how two sets of answers agree on what both have."""
    both = sorted(ones.keys() & others.keys())
    print(f"\n{title}")
    if not both:
        sys.exit("  no episode has both answers: do the files name the same ones?")
    for field in ("class", "sub_class"):
        pairs = [(ones[key][field], others[key][field]) for key in both]
        found = kappa(pairs)
        print(f"  {field:12} {rate([one == other for one, other in pairs])}  kappa {'-' if found is None else f'{found:.2f}'}")
    apart = [None if None in (ones[key]["step"], others[key]["step"]) else abs(ones[key]["step"] - others[key]["step"]) for key in both]
    print(f"  {'step':12} {rate([far == 0 for far in apart])}")
    print(f"  {'step, 1 off':12} {rate([far is not None and far <= 1 for far in apart])}")


def naive(labels, last):
    """Says the same of all failures: the commonest labels of `labels`; and that the last call decided."""
    common = lambda field: collections.Counter(one[field] for one in labels.values()).most_common(1)[0][0]
    return {key: {"class": common("class"), "sub_class": common("sub_class"), "step": last[key]} for key in labels}


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--reel", required=True, help="the binary")
    options.add_argument("--store", required=True)
    options.add_argument("--index", required=True, type=pathlib.Path)
    options.add_argument("--disagreements", action="store_true", help="list what Reel and both labellers, who agree on the class, see differently")
    options.add_argument("labels", nargs=2, type=pathlib.Path)
    options = options.parse_args()

    episodes = {one["episode_id"]: key for key, one in json.loads(options.index.read_text()).items()}
    query = """SELECT e.episode_id, c.class, c.sub_class, c.step, l.last FROM episodes e JOIN classes c ON c.episode_id = e.episode_id
        JOIN (SELECT episode_id, max(step) AS last FROM steps GROUP BY episode_id) l ON l.episode_id = e.episode_id"""
    asked = [options.reel, "query", "--store", options.store, "--json", query]
    rows = json.loads(subprocess.run(asked, check=True, capture_output=True, text=True).stdout)
    reel = {episodes[row["episode_id"]]: row for row in rows if row["episode_id"] in episodes}
    if not reel:
        sys.exit(f"{options.store}: no classes of the episodes in {options.index}; run `reel blame` and `reel taxonomy` with this store")
    last = {key: row["last"] for key, row in reel.items()}

    fields = ("class", "sub_class", "step")
    read = lambda path: {key: {field: one.get(field) for field in fields} for key, one in json.loads(path.read_text()).items() if key in reel}
    first, second = map(read, options.labels)
    names = [path.stem for path in options.labels]
    compare(f"{names[0]} and {names[1]}", first, second)
    for name, labels in zip(names, (first, second)):
        compare(f"Reel and {name}", reel, labels)
        compare(f"baseline and {name}", naive(labels, last), labels)
    same = {key: one for key, one in first.items() if key in second and one["class"] == second[key]["class"]}
    if not same:
        return
    compare("Reel and those on whose class both agree (sub-class and step of the first)", reel, same)
    counts = collections.Counter((one["class"], reel[key]["class"]) for key, one in same.items())
    print("\nagreed class, Reel's class")
    for (agreed, told), count in counts.most_common():
        print(f"  {agreed:20} {told:20} {count:3}")
    if options.disagreements:
        for key, one in sorted(same.items()):
            if one["class"] != reel[key]["class"]:
                told = reel[key]
                print(f"  {key}: agreed {one['class']}, Reel {told['class']} / {told['sub_class']} at {told['step']}, the first's step {one['step']}")


if __name__ == "__main__":
    main()
