"""Four questions about episodes, in DuckDB: the yardstick that `reel query` is measured against.

  benchmark   per policy and family: episodes, success rate, completion, length, asks, SPL
  failures    per policy and rule-based class: failed episodes
  funnel      per policy: episodes, and how many reach each prefix of the canonical pipeline
  advantages  discounted returns from the steps' rewards, normed within their groups

Each is asked in the ways that a user of DuckDB would try, in a process of its own; all must give the same answer, and
the cheapest counts:

  store     the Parquet files that the Delta table lists, as they are
  lists     a table with a row an episode and a list a field of the steps, with list functions
  windows   a flat table with a row a step, with windows over each episode
  ordered   the same, relying on the order of its rows: `lag` needs no sort then
  text      the same, with the steps of an episode joined to one text
  grouped   the same, where aggregates suffice
  gathered  as lists, with the returns of a group in a list

`--prepare` writes the tables that are not there already; its time does not count. They hold what the store holds,
nothing derived but the number of the episode, which joins the steps of the flat table. An episode fails where `success`
is false; in the funnel, a tool that may be left out is reached with the one before it.

Needs PyPI duckdb and deltalake.

  sql_duckdb.py STORE --work DIR --prepare
  sql_duckdb.py STORE --work DIR [--questions failures funnel] [--variants lists ordered] [--answers FILE]
"""

import argparse
import json
import multiprocessing
import re
import statistics
import sys
import time
from pathlib import Path

import duckdb

THREADS = 2
RUNS = 3
FIELDS = ("step", "tool", "argument", "error_code", "goal_object", "reward")
EPISODE = ("policy", "success", "fuzzy", "asks", "group_id", "task_id")

GROUP_KEY = "coalesce(group_id, task_id || policy)"

PREPARE_LISTS = f"""
SELECT row_number() OVER () AS episode, {", ".join(EPISODE)},
  {", ".join(f"list_transform(steps, lambda s: s.{field}) AS {field}" for field in FIELDS)}
FROM episodes
"""
# An episode without steps keeps one row.
PREPARE_FLAT = f"""
SELECT episode, {", ".join(EPISODE)},
  {", ".join(f"unnest(CASE WHEN len(step) = 0 THEN [NULL] ELSE {field} END) AS {field}" for field in FIELDS)}
FROM lists
"""

BENCHMARK = """
SELECT policy, family, count(*) AS episodes, round(avg(CAST(success AS INT)), 6) AS success,
  round(avg(completion), 6) AS completion, round(avg(length), 6) AS length, round(avg(asks), 6) AS asks,
  round(avg(spl), 6) AS spl
FROM episodes
GROUP BY ALL ORDER BY ALL
"""

# `done`: the tools of the calls that succeeded. The rules stand in one CASE, so that none is tried where an earlier one holds.
FAILURES_LISTS = """
WITH calls AS (
  SELECT *, list_transform(list_zip(tool, error_code), lambda s: CASE WHEN s[2] IS NULL THEN s[1] END) AS done
  FROM lists
  WHERE NOT success
),
classes AS (
  SELECT policy,
    CASE
      WHEN NOT goal_object[len(done) + 1 - list_position(list_reverse(done), 'pick')] THEN 'Object Confusion'
      WHEN fuzzy AND asks = 0 OR NOT list_contains(done, 'place')
        OR (list_contains(error_code, 'door_closed') AND NOT list_contains(done, 'open')) THEN 'Key Action Missing'
      WHEN len(list_filter(
        list_zip(tool, tool[2:], tool[3:], tool[4:], argument, argument[2:], argument[3:], argument[4:]),
        lambda s: s[1] = 'nav_to' AND s[2] = 'nav_to' AND s[3] = 'nav_to' AND s[4] = 'nav_to'
          AND s[5] = s[7] AND s[6] = s[8] AND s[5] <> s[6]
      )) > 0 THEN 'Lost Memory'
      ELSE 'Other'
    END AS class
  FROM calls
)
SELECT policy, class, count(*) AS episodes
FROM classes
GROUP BY ALL ORDER BY ALL
"""
FAILURES_STORE = FAILURES_LISTS.replace("FROM lists", "FROM fields").replace(
    "WITH calls",
    """WITH fields AS (
  SELECT policy, fuzzy, asks, success,
    list_transform(steps, lambda s: s.tool) AS tool,
    list_transform(steps, lambda s: s.argument) AS argument,
    list_transform(steps, lambda s: s.error_code) AS error_code,
    list_transform(steps, lambda s: s.goal_object) AS goal_object
  FROM episodes
),
calls""",
)


def failures_flat(window, same_episode):
    return f"""
WITH calls AS (
  SELECT episode, policy, fuzzy, asks, step, tool, error_code, goal_object,
    CASE WHEN tool = 'nav_to' THEN argument END AS went
  FROM flat
  WHERE NOT success
),
swung AS (
  SELECT *, {same_episode} went = lag(went, 2) OVER w AND lag(went) OVER w = lag(went, 3) OVER w
    AND went <> lag(went) OVER w AS swing
  FROM calls
  WINDOW w AS ({window})
),
facts AS (
  SELECT episode, any_value(policy) AS policy, any_value(fuzzy) AS fuzzy, any_value(asks) AS asks,
    coalesce(arg_max_null(goal_object, step) FILTER (tool = 'pick' AND error_code IS NULL), true) AS picked_right,
    coalesce(bool_or(tool = 'place' AND error_code IS NULL), false) AS placed,
    coalesce(bool_or(error_code = 'door_closed'), false) AS stuck,
    coalesce(bool_or(tool = 'open' AND error_code IS NULL), false) AS opened,
    coalesce(bool_or(swing), false) AS swings
  FROM swung
  GROUP BY episode
)
SELECT policy,
  CASE
    WHEN NOT picked_right THEN 'Object Confusion'
    WHEN fuzzy AND asks = 0 OR NOT placed OR (stuck AND NOT opened) THEN 'Key Action Missing'
    WHEN swings THEN 'Lost Memory'
    ELSE 'Other'
  END AS class,
  count(*) AS episodes
FROM facts
GROUP BY ALL ORDER BY ALL
"""


# The canonical pipeline: nav_to, show_object_by_category, gaze_at (or not), pick, nav_to, show_receptacles (or not), place.
# `reached`: its longest prefix, in tools; a tool that may be left out is reached with the one before it.
REACHED = """
SELECT policy, count(*) AS episodes, round(count_if(reached = 7) / count(*), 6) AS share,
  count_if(reached >= 1) AS reached_1, count_if(reached >= 2) AS reached_2, count_if(reached >= 3) AS reached_3,
  count_if(reached >= 4) AS reached_4, count_if(reached >= 5) AS reached_5, count_if(reached >= 6) AS reached_6,
  count_if(reached >= 7) AS reached_7
FROM facts
GROUP BY ALL ORDER BY ALL
"""


def funnel_text(texts):
    """From one text an episode, its tools with a comma before and after each."""
    show, gaze, pick = ",nav_to,show_object_by_category,", "gaze_at,", "pick,"
    picks = [f"{show}{pick}", f"{show}{gaze}{pick}"]
    navs = [f"{start}nav_to," for start in picks]
    places = [f"{start}{receptacles}place," for start in navs for receptacles in ("", "show_receptacles,")]

    def has(parts):
        return " OR ".join(f"contains(tools, '{part}')" for part in parts)

    return f"""
WITH texts AS ({texts}),
facts AS (
  SELECT policy,
    CASE
      WHEN {has(places)} THEN 7
      WHEN {has(navs)} THEN 6
      WHEN {has(picks)} THEN 4
      WHEN {has([show])} THEN 3
      WHEN {has([",nav_to,"])} THEN 1
      ELSE 0
    END AS reached
  FROM texts
)
{REACHED}
"""


def funnel_windows():
    """All six steps before a step in one window."""

    def tool(back):
        return f"tool_{back}" if back else "tool"

    def show(back):
        return f"({tool(back)} = 'show_object_by_category' AND {tool(back + 1)} = 'nav_to')"

    def pick(back):
        return f"({tool(back)} = 'pick' AND ({show(back + 1)} OR ({tool(back + 1)} = 'gaze_at' AND {show(back + 2)})))"

    def nav(back):
        return f"({tool(back)} = 'nav_to' AND {pick(back + 1)})"

    place = f"(tool = 'place' AND ({nav(1)} OR (tool_1 = 'show_receptacles' AND {nav(2)})))"
    return f"""
WITH calls AS (
  SELECT episode, policy, tool, {", ".join(f"lag(tool, {back}) OVER w AS tool_{back}" for back in range(1, 7))}
  FROM flat
  WINDOW w AS (PARTITION BY episode ORDER BY step)
),
facts AS (
  SELECT any_value(policy) AS policy,
    max(CASE
      WHEN {place} THEN 7
      WHEN {nav(0)} THEN 6
      WHEN {pick(0)} THEN 4
      WHEN {show(0)} THEN 3
      WHEN tool = 'nav_to' THEN 1
      ELSE 0
    END) AS reached
  FROM calls
  GROUP BY episode
)
{REACHED}
"""


# Each stage looks at the one before; `step` says how many rows before belong to the same episode.
FUNNEL_ORDERED = f"""
WITH marked AS (
  SELECT episode, policy, step, tool,
    step >= 1 AND tool = 'show_object_by_category' AND lag(tool) OVER () = 'nav_to' AS marked
  FROM flat
),
picked AS (
  SELECT *,
    tool = 'pick'
      AND ((step >= 1 AND lag(marked) OVER ())
        OR (step >= 2 AND lag(tool) OVER () = 'gaze_at' AND lag(marked, 2) OVER ())) AS pick
  FROM marked
),
carried AS (
  SELECT *, step >= 1 AND tool = 'nav_to' AND lag(pick) OVER () AS carry FROM picked
),
placed AS (
  SELECT *,
    tool = 'place'
      AND ((step >= 1 AND lag(carry) OVER ())
        OR (step >= 2 AND lag(tool) OVER () = 'show_receptacles' AND lag(carry, 2) OVER ())) AS place
  FROM carried
),
facts AS (
  SELECT any_value(policy) AS policy,
    max(CASE WHEN place THEN 7 WHEN carry THEN 6 WHEN pick THEN 4 WHEN marked THEN 3 WHEN tool = 'nav_to' THEN 1 ELSE 0 END)
      AS reached
  FROM placed
  GROUP BY episode
)
{REACHED}
"""

# Over `returns`: group_key and j, the discounted return of an episode.
NORMED = """
SELECT count(*) AS episodes, round(sum(j), 6) AS sum_j, round(sum(abs(advantage)), 6) AS sum_abs, round(max(advantage), 6) AS max
FROM (
  SELECT j, (j - mean) / (std + 1e-6) AS advantage
  FROM returns
  JOIN (SELECT group_key, avg(j) AS mean, stddev_pop(j) AS std FROM returns GROUP BY group_key) USING (group_key)
)
"""
# Horner's rule from the last reward on.
RETURN = "list_reduce(list_reverse({}), lambda later, reward: 0.99::DOUBLE * later + reward, 0::DOUBLE)"


# The same with each group's returns in a list, so that the episodes are read once.
GATHERED = """
SELECT count(*) AS episodes, round(sum(j), 6) AS sum_j, round(sum(abs(advantage)), 6) AS sum_abs, round(max(advantage), 6) AS max
FROM (
  SELECT j, (j - mean) / (std + 1e-6) AS advantage
  FROM (SELECT unnest(js) AS j, mean, std
    FROM (SELECT list(j) AS js, avg(j) AS mean, stddev_pop(j) AS std FROM returns GROUP BY group_key))
)
"""


def advantages(returns, normed=NORMED):
    return f"WITH returns AS ({returns}) {normed}"


# By question and variant.
QUERIES = {
    "benchmark": {"store": BENCHMARK},
    "failures": {
        "store": FAILURES_STORE,
        "lists": FAILURES_LISTS,
        "windows": failures_flat("PARTITION BY episode ORDER BY step", ""),
        "ordered": failures_flat("", "step >= 3 AND"),
    },
    "funnel": {
        "store": funnel_text(
            "SELECT policy, ',' || array_to_string(list_transform(steps, lambda s: s.tool), ',') || ',' AS tools FROM episodes"
        ),
        "lists": funnel_text("SELECT policy, ',' || array_to_string(tool, ',') || ',' AS tools FROM lists"),
        "windows": funnel_windows(),
        "ordered": FUNNEL_ORDERED,
        "text": funnel_text(
            "SELECT any_value(policy) AS policy, coalesce(',' || string_agg(tool, ',' ORDER BY step) || ',', '') AS tools"
            " FROM flat GROUP BY episode"
        ),
    },
    "advantages": {
        "store": advantages(
            f"SELECT {GROUP_KEY} AS group_key,"
            f" {RETURN.format('list_transform(steps, lambda s: s.reward)')} AS j FROM episodes"
        ),
        "lists": advantages(f"SELECT {GROUP_KEY} AS group_key, {RETURN.format('reward')} AS j FROM lists"),
        "gathered": advantages(f"SELECT {GROUP_KEY} AS group_key, {RETURN.format('reward')} AS j FROM lists", GATHERED),
        "grouped": advantages(
            f"SELECT any_value({GROUP_KEY}) AS group_key, coalesce(sum(reward * pow(0.99::DOUBLE, step)), 0) AS j"
            " FROM flat GROUP BY episode"
        ),
    },
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("--work", required=True, type=Path, help="folder for the prepared tables")
    parser.add_argument("--prepare", action="store_true", help="write the prepared tables")
    parser.add_argument("--questions", nargs="*", choices=QUERIES, default=list(QUERIES))
    parser.add_argument("--variants", nargs="*", help="only these ways of asking; all by default")
    parser.add_argument("--answers", type=Path, help="write the answers as JSON")
    options = parser.parse_args()
    if options.prepare:
        prepare(options.store, options.work)
    answers = {}
    for question in options.questions:
        variants = [name for name in QUERIES[question] if not options.variants or name in options.variants]
        figures = {name: in_own_process(options.store, options.work, QUERIES[question][name]) for name in variants}
        if not figures:
            sys.exit(f"{question} is not asked in any of these ways")
        best = min(figures, key=lambda name: figures[name]["cpu_s"])
        answer = answers[question] = figures[best]["answer"]
        for name in variants:
            if not same(figures[name].pop("answer"), answer):
                sys.exit(f"{question}: {name} and {best} give different answers")
        print(json.dumps({"question": question, "best": best, **figures[best], "variants": figures}))
    if options.answers:
        options.answers.write_text(json.dumps(answers, indent=1) + "\n")


def same(one, other):
    """Whether two answers are equal, but for the last of six digits."""

    def near(a, b):
        return abs(a - b) <= 1.5e-6 * max(1, abs(a)) if isinstance(a, float) and isinstance(b, float) else a == b

    return len(one) == len(other) and all(len(a) == len(b) and all(map(near, a, b)) for a, b in zip(one, other))


def connect(store, work):
    connection = duckdb.connect()
    connection.execute(f"SET threads = {THREADS}; SET enable_progress_bar = false")
    connection.execute(f"CREATE VIEW episodes AS FROM read_parquet({files(store)})")
    for table in ("lists", "flat"):
        path = work / f"{table}.parquet"
        if path.exists():
            connection.execute(f"CREATE VIEW {table} AS FROM read_parquet('{path}')")
    return connection


def files(store):
    """The Parquet files of the episodes at the newest version."""
    from deltalake import DeltaTable

    return DeltaTable(store / "episodes").file_uris()


def prepare(store, work):
    work.mkdir(parents=True, exist_ok=True)
    for table, query in (("lists", PREPARE_LISTS), ("flat", PREPARE_FLAT)):
        path = work / f"{table}.parquet"
        if not path.exists():
            connect(store, work).execute(f"COPY ({query}) TO '{path}' (COMPRESSION zstd)")


def in_own_process(store, work, query):
    """Runs a query where its memory is its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(measure, (store, work, query))


def measure(store, work, query):
    connection = connect(store, work)
    answer = connection.execute(query).fetchall()
    cpu, wall = [], []
    for _ in range(RUNS):
        start = time.process_time(), time.perf_counter()
        connection.execute(query).fetchall()
        cpu.append(time.process_time() - start[0])
        wall.append(time.perf_counter() - start[1])
    return {
        "rows": len(answer),
        "cpu_s": round(statistics.median(cpu), 4),
        "wall_s": round(statistics.median(wall), 4),
        "peak_rss_bytes": peak_rss_bytes(),
        "answer": answer,
    }


def peak_rss_bytes():
    """Of this process alone, which the kernel's maximum for a child is not."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])


if __name__ == "__main__":
    main()
