"""Stores: questions in SQL, Arrow without copies, LazyFrames."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import polars as pl
import pytest

import reel


def test_an_answer_goes_to_every_library(store: reel.Store) -> None:
    table = store.sql("SELECT policy, count(*) AS episodes FROM episodes GROUP BY policy ORDER BY policy")
    assert table.columns == ["policy", "episodes"] and len(table) == 2
    rows = [{"policy": "oracle", "episodes": 4}, {"policy": "wrong-receptacle", "episodes": 4}]
    assert table.rows() == rows == list(table)
    assert pl.DataFrame(table).to_dicts() == rows == table.to_polars().to_dicts()
    duckdb = pytest.importorskip("duckdb")
    answer = table
    assert duckdb.sql("SELECT sum(episodes) FROM answer").fetchall() == [(8,)] and answer is table
    pytest.importorskip("pyarrow")
    assert table.to_pyarrow().to_pylist() == rows
    pytest.importorskip("pandas")
    assert table.to_pandas().to_dict("records") == rows


def test_nested_columns_and_empty_answers_survive(store: reel.Store) -> None:
    nested = store.sql("SELECT episode_id, steps FROM episodes").to_polars()
    assert nested.schema["steps"].base_type() is pl.List and nested["steps"].list.len().min() > 3
    empty = store.sql("SELECT episode_id, step FROM steps WHERE step > 1000")
    assert len(empty) == 0 and pl.DataFrame(empty).columns == ["episode_id", "step"]


def test_whole_decimals_are_integers(store: reel.Store) -> None:
    query = """
        SELECT CAST(18446744073709551615 AS DECIMAL(20, 0)) AS largest, CAST(-3 AS DECIMAL(38, 0)) AS negative,
          CAST(1.5 AS DECIMAL(5, 2)) AS half, CAST(NULL AS DECIMAL(20, 0)) AS none, '7' AS text, 7 AS number"""
    row = {"largest": 2**64 - 1, "negative": -3, "half": 1.5, "none": None, "text": "7", "number": 7}
    assert store.sql(query).rows() == [row] == list(store.sql(query))
    seeds = store.sql("SELECT seed, sum(CAST(1 AS DECIMAL(5, 0))) AS episodes FROM episodes GROUP BY seed")
    assert seeds.rows() == [{"seed": 0, "episodes": 8}] and seeds.rows(1) == []
    assert all(type(value) is int for value in seeds.rows()[0].values())
    assert "<small>integer</small>" in seeds._repr_html_()


def test_questions_have_parameters_names_and_ends(store: reel.Store) -> None:
    answer = store.sql("SELECT count(*) AS n FROM episodes WHERE policy = $policy", parameters={"policy": "oracle"})
    assert answer.rows() == [{"n": 4}]
    assert "policy" in store.named("benchmark").columns
    assert {"episodes", "steps"} <= set(store.tables())
    with pytest.raises(reel.ReelError, match="only questions are allowed"):
        store.sql("DROP TABLE episodes")
    with pytest.raises(reel.ReelError, match="no_such_column"):
        store.sql("SELECT no_such_column FROM steps")
    with pytest.raises(reel.ReelError):
        store.sql("SELECT count(*) FROM steps a, steps b, steps c, steps d, steps e", timeout=0.5)
    with pytest.raises(reel.ReelError):
        reel.Store(store.location + "-not-there")


def test_columns_of_one_name_are_refused(store: reel.Store) -> None:
    table = store.sql("SELECT a.step, b.step FROM steps a JOIN steps b ON a.episode_id = b.episode_id LIMIT 3")
    assert table.columns == ["step", "step"] and len(table) == 3
    with pytest.raises(reel.ReelError, match=r"two columns of the answer are named `step`.*AS first_step"):
        table.rows()


def test_tables_have_types_slices_and_pickle(store: reel.Store) -> None:
    table = store.sql("SELECT episode_id, step, reward, args FROM (SELECT *, [tool] AS args FROM steps) ORDER BY episode_id, step")
    assert list(table.schema) == table.columns
    assert table.schema["episode_id"] == "Utf8View" and table.schema["reward"] == "Float64"
    assert table.schema["args"].startswith("List(")
    again = pickle.loads(pickle.dumps(table))
    assert again.schema == table.schema and again.rows() == table.rows() and str(again) == str(table)
    empty = pickle.loads(pickle.dumps(store.sql("SELECT step FROM steps WHERE step > 1000")))
    assert len(empty) == 0 and empty.columns == ["step"]
    rows = table.rows()
    assert table.rows(-2) == rows[-2:] and table.rows(1, -1) == rows[1:-1] and table.rows(5, 2) == []
    for call in (lambda: store.sql("SELECT 1", memory=-1), lambda: reel.Store(store.location, -1)):
        with pytest.raises(ValueError, match=r"(memory|version)=-1: give an integer from 0 to"):
            call()


def test_streams_come_batch_by_batch_and_once(store: reel.Store) -> None:
    stream = store.sql("SELECT * FROM steps", stream=True)
    total = sum(len(batch) for batch in stream)
    assert total == store.sql("SELECT count(*) AS n FROM steps").rows()[0]["n"]
    again = store.sql("SELECT episode_id FROM steps", stream=True)
    assert len(pl.DataFrame(again)) == total
    with pytest.raises(reel.ReelError, match="taken already"):
        pl.DataFrame(again)


def test_a_scan_equals_the_question(store: reel.Store) -> None:
    whole = store.sql("SELECT * FROM steps").to_polars()
    lazy = store.scan("steps")
    assert lazy.collect_schema() == whole.schema
    key = ["episode_id", "step"]
    predicates = [
        pl.col("policy") == "oracle",
        (pl.col("step") > 3) & pl.col("error_code").is_null(),
        pl.col("tool").is_in(["pick", "place"]) | (pl.col("reward") < 0),
        ~pl.col("tool").str.starts_with("nav") & (pl.col("step") != 2),
        # SQL cannot check these: Polars does
        pl.col("step") % 2 == 1,
        (pl.col("policy") == "oracle") & (pl.col("tool").str.len_chars() > 4),
        pl.col("episode_id").is_first_distinct(),
    ]
    for predicate in predicates:
        expected = whole.filter(predicate).select([*key, "tool"]).sort(key)
        found = lazy.filter(predicate).select([*key, "tool"]).collect().sort(key)
        assert found.equals(expected), str(predicate)
        assert len(lazy.filter(predicate).head(3).collect()) == min(3, len(expected))
    assert lazy.select(pl.len()).collect().item() == len(whole)
    assert lazy.group_by("policy").agg(pl.len()).collect()["len"].sum() == len(whole)


def test_what_is_wanted_is_pushed_down(store: reel.Store) -> None:
    plan = store.scan("steps").filter(pl.col("policy") == "oracle").select("step").explain()
    assert "REEL steps" in plan and "FILTER" not in plan.split("REEL steps")[0]


def test_traces_are_scanned_without_a_store(played: Path, store: reel.Store) -> None:
    found = reel.scan_traces(played / "*oracle*.mcap").select("episode_id", "step").collect()
    expected = store.scan().filter(pl.col("policy") == "oracle").select("episode_id", "step").collect()
    assert found.sort("episode_id", "step").equals(expected.sort("episode_id", "step"))


def test_patterns_are_expressions(store: reel.Store) -> None:
    patterns = ["^ !ask* pick", "nav_to show_object_by_category .. pick[ok]", "place", "pick[not goal_object]"]
    episodes = store.scan("episodes")
    for pattern in patterns:
        quoted = pattern.replace("'", "''")
        expected = store.sql(
            f"SELECT episode_id, sequence_match(steps, '{quoted}') AS match, sequence_count(steps, '{quoted}') AS count, "
            f"sequence_find(steps, '{quoted}') AS find FROM episodes ORDER BY episode_id"
        ).to_polars()
        steps = pl.col("steps").reel  # type: ignore[attr-defined]
        found = episodes.select(
            "episode_id", match=steps.match(pattern), count=steps.count(pattern), find=steps.find(pattern)
        ).collect()
        assert found.sort("episode_id").equals(expected), pattern
    columns = episodes.select(
        first=pl.col("steps").reel.first_step("pick"),  # type: ignore[attr-defined]
        texts=pl.col("steps").reel.texts("tool"),  # type: ignore[attr-defined]
        values=pl.col("steps").reel.values("reward"),  # type: ignore[attr-defined]
        swing=pl.col("steps").reel.oscillation(),  # type: ignore[attr-defined]
        tail=pl.col("steps").reel.prevailing_tail("[failed]"),  # type: ignore[attr-defined]
    ).collect()
    assert columns.schema["texts"] == pl.List(pl.String) and columns.schema["values"] == pl.List(pl.Float64)
    with pytest.raises(pl.exceptions.ComputeError, match="sequence_match"):
        episodes.select(pl.col("steps").reel.match("pick[")).collect()  # type: ignore[attr-defined]
    with pytest.raises(pl.exceptions.ComputeError, match="takes the steps"):
        episodes.select(pl.col("policy").reel.match("pick")).collect()  # type: ignore[attr-defined]


def test_a_training_set_leads_back(store: reel.Store, tmp_path: Path) -> None:
    report = reel.export_sft(store, tmp_path / "set", format="trl", images="none")
    assert sum(report["examples"].values()) > 10
    with pytest.raises(reel.ReelError, match="this folder is not empty"):
        reel.export_sft(store, Path(__file__).parent)


def test_the_first_rows_are_taken_before_they_are_filtered(store: reel.Store) -> None:
    every = store.sql("SELECT * FROM steps").to_polars()
    for rows in (5, 20):
        lazy = store.scan("steps").head(rows).filter(pl.col("tool") == "nav_to").collect()
        eager = every.head(rows).filter(pl.col("tool") == "nav_to")
        assert lazy.height == eager.height < rows
    infinite = store.scan("steps").filter(pl.col("reward") < math.inf).collect()
    assert infinite.height == every.height


def test_named_questions_take_parameters(store: reel.Store) -> None:
    worse = store.named("regressions", a="oracle", b="wrong-receptacle")
    better = store.named("regressions", a="wrong-receptacle", b="oracle")
    assert worse.rows() != better.rows()
    with pytest.raises(reel.ReelError, match="no query is named none_such; there are summary"):
        store.named("none_such", a="x")


@pytest.mark.parametrize("value", [None, math.nan, ["a"], b"a"])
def test_a_parameter_that_is_no_value_is_refused(store: reel.Store, value: object) -> None:
    with pytest.raises(reel.ReelError, match="parameter policy is"):
        store.sql("SELECT count(*) FROM episodes WHERE policy = $policy", parameters={"policy": value})


@pytest.mark.parametrize("seconds", [-1.0, math.nan])
def test_a_time_limit_that_is_none_is_refused(store: reel.Store, seconds: float) -> None:
    with pytest.raises(reel.ReelError, match="timeout is"):
        store.sql("SELECT 1", timeout=seconds)
    assert len(store.sql("SELECT 1 AS one", timeout=math.inf)) == 1


def test_traces_that_cannot_be_read_are_named(played: Path, tmp_path: Path) -> None:
    good = next(iter(sorted(played.glob("*.mcap"))))
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(good.read_bytes()[:1000])
    with pytest.warns(UserWarning, match="1 traces were not read.*damaged.mcap"):
        reel.Store.ingest([good, damaged], tmp_path / "store")
