"""Policies compared task by task."""
import math
from collections import Counter, defaultdict

import numpy

from .failures import judged
from .rows import ENDED, EPISODES, answers, distinct, first, group, lost, mean, of, ordered, success, without, won


def on_tasks():
    """Mean success by policy and task."""
    results = defaultdict(dict)
    for (policy, task), mine in group(ENDED, "policy", "task_digest"):
        results[policy][task] = mine
    return results


def chacha8(seed, count):
    """`count` numbers of 64 bits of ChaCha with 8 rounds, the key stretched from the seed by PCG32 (crate `rand_core`)."""
    words, mask = [], (1 << 64) - 1
    for _ in range(8):
        seed = (seed * 6364136223846793005 + 11634580027462260723) & mask
        word, turn = ((seed >> 18) ^ seed) >> 27 & 0xFFFFFFFF, seed >> 59
        words.append((word >> turn | word << (32 - turn)) & 0xFFFFFFFF)
    blocks = (count + 7) // 8
    begin = [numpy.full(blocks, word, numpy.uint32) for word in [0x61707865, 0x3320646E, 0x79622D32, 0x6B206574, *words]]
    counter = numpy.arange(blocks, dtype=numpy.uint64)
    begin += [counter.astype(numpy.uint32), (counter >> numpy.uint64(32)).astype(numpy.uint32)]
    begin += [*numpy.zeros((2, blocks), numpy.uint32)]
    x = [word.copy() for word in begin]

    def mix(a, b, c, d):
        for to, by, turned, bits in [(a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)]:
            x[to] += x[by]
            x[turned] ^= x[to]
            x[turned] = x[turned] << numpy.uint32(bits) | x[turned] >> numpy.uint32(32 - bits)

    for _ in range(4):
        for column in range(4):
            mix(column, column + 4, column + 8, column + 12)
        for column in range(4):
            mix(column, (column + 1) % 4 + 4, (column + 2) % 4 + 8, (column + 3) % 4 + 12)
    out = numpy.stack([word + start for word, start in zip(x, begin)], axis=1).astype(numpy.uint64)
    return (out[:, 0::2] | out[:, 1::2] << numpy.uint64(32)).reshape(-1)[:count]


def bootstrap(differences, samples, seed):
    """2.5 and 97.5 % percentiles of the means of resampled lists."""
    n = len(differences)
    draws = chacha8(seed, n * samples)
    half = numpy.uint64(32)
    low, high = draws & numpy.uint64(0xFFFFFFFF), draws >> half
    # floor(draw * n / 2^64) without 128 bits
    index = (high * numpy.uint64(n) + (low * numpy.uint64(n) >> half)) >> half
    means = sorted(numpy.array(differences)[index.astype(int)].reshape(samples, n).mean(axis=1))
    return [float(means[int((samples - 1) * part + 0.5)]) for part in (0.025, 0.975)]


@answers
def compared():
    rows, results = [], on_tasks()
    for a in sorted(results):
        for b in sorted(other for other in results if other > a):
            both = sorted(set(results[a]) & set(results[b]))
            if not both:
                continue
            pairs = [(success(results[a][task]), success(results[b][task])) for task in both]
            only_a = sum(one > 0.5 >= other for one, other in pairs)
            only_b = sum(other > 0.5 >= one for one, other in pairs)
            n = only_a + only_b
            tail = sum(math.comb(n, k) for k in range(min(only_a, only_b) + 1)) * 2 / 2**n
            low, high = bootstrap([one - other for one, other in pairs], 2000, 7)
            rows.append({
                "a": a, "b": b, "tasks": len(both), "success_a": mean(one for one, _ in pairs),
                "success_b": mean(other for _, other in pairs), "only_a": only_a, "only_b": only_b, "p": min(1.0, tail),
                "difference": mean(one - other for one, other in pairs), "low": low, "high": high,
            })
    return rows


@answers
def regressions():
    rows, results = [], on_tasks()
    for a in results:
        for b in results:
            for task in set(results[a]) & set(results[b]):
                one, other = results[a][task], results[b][task]
                if success(one) > 0.5 >= success(other):
                    rows.append({
                        "a": a, "b": b, **of(one[0], "family", "task_id"),
                        "success_a": success(one), "success_b": success(other),
                        "episodes_a": len(one), "episodes_b": len(other),
                        "trace_a": first(e["trace"] for e in won(one)), "trace_b": first(e["trace"] for e in lost(other)),
                        "task": task,
                    })
    return without(ordered(rows, "a", "b", "family", "task_id", "task"), "task")


@answers
def hardest_tasks():
    classes = {e["episode_id"]: judged(e)["class"] for e in lost(EPISODES)}
    rows = []
    for (task,), mine in group(ENDED, "task_digest"):
        failures = Counter(classes[e["episode_id"]] for e in mine if e["episode_id"] in classes)
        rows.append({
            **of(mine[0], "family", "task_id"), "policies": distinct(mine, "policy"), "solved_by": distinct(won(mine), "policy"),
            "episodes": len(mine), "success": success(mine), "done": mean(e["completion"] for e in mine),
            "length": mean(e["length"] for e in mine),
            "failure": min(failures, key=lambda name: (-failures[name], name), default=None),
            "instruction": min(e["instruction"] for e in mine),
            "task": task, "rounded": round(mean(e["completion"] for e in mine), 6),
        })
    return without(ordered(rows, "success", "rounded", "family", "task_id", "task"), "task", "rounded")


@answers
def unsteady_tasks():
    rows = []
    for (policy, task), mine in group(ENDED, "policy", "task_digest"):
        if won(mine) and lost(mine):
            rows.append({
                "policy": policy, **of(mine[0], "family", "task_id"), "episodes": len(mine), "seeds": distinct(mine, "seed"),
                "won": len(won(mine)), "success": success(mine), "trace_won": min(e["trace"] for e in won(mine)),
                "trace_lost": min(e["trace"] for e in lost(mine)), "task": task,
            })
    return without(ordered(rows, "policy", "family", "task_id", "task"), "task")
