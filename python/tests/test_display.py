"""What notebooks show: well-formed, bounded, and safe whatever the texts of a trace say."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import reel
from reel._display.failure_flow import Flow, Sankey
from reel._display.images import data_uris, encoded, reduced

VOID = {"img", "input", "br"}
EVIL = "</script><script>evil()</script><img src=x onerror=\"evil()\">' onload='evil()"


class Page(HTMLParser):
    """The elements of a display; fails if they do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.texts.append(data)

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.elements)

    @property
    def text(self) -> str:
        return "\n".join(self.texts)

    def assert_safe(self, scripts: int = 0) -> None:
        """No script but ours, no handlers, nothing from the network."""
        assert self.count("script") == scripts
        for tag, attributes in self.elements:
            assert tag not in ("iframe", "object", "embed", "link", "base", "form")
            for name, value in attributes.items():
                assert not name.startswith("on"), (tag, name)
                if name in ("src", "href"):
                    assert value is not None and value.startswith("data:image/")


@pytest.fixture(scope="module")
def failed(played: Path) -> reel.Episode:
    """A failed episode without images."""
    return reel.open(next(played.glob("*wrong-receptacle*.mcap")))


@pytest.fixture(scope="module")
def good(played: Path) -> reel.Episode:
    """A successful episode with images."""
    return reel.open(next(played.glob("*oracle*.mcap")))


@pytest.fixture(scope="module")
def evil(tasks: reel.Tasks, tmp_path_factory: pytest.TempPathFactory) -> reel.Episode:
    """An episode whose agent says scripts."""

    def says(observation: reel.Observation) -> Any:
        said = {"reasoning": EVIL, "history": EVIL, "plan": EVIL, "raw": EVIL}
        if observation.step == 0:
            return {"name": "ask", "arguments": {"question": EVIL}, **said}
        if observation.step == 1:
            return {"name": EVIL, "arguments": {EVIL: EVIL}, **said}
        return {"name": "finish", "arguments": {}, **said}

    return reel.run(tasks[:1], says, name="evil", out=tmp_path_factory.mktemp("evil"), images=False)[0]


# --- episodes


def test_an_episode_shows_every_call(good: reel.Episode, failed: reel.Episode) -> None:
    for episode in (good, failed):
        text = episode._repr_html_()
        page = Page(text)
        page.assert_safe(scripts=1)
        assert len(text) < 1_500_000
        items = [attributes["data-call"] for tag, attributes in page.elements if tag == "li"]
        assert items == [str(call) for call in range(-1, len(episode))]
        assert 3 < page.count("img") <= len(episode) + 2
        for step in episode.steps:
            assert step.call in page.text
        assert episode.instruction in page.text and "Transcript" in page.text
        assert ("✓ success" in page.text) == episode.success
        assert "prefers-color-scheme:dark" in text and 'data-jp-theme-light="false"' in text
        ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
        assert len(ids) == 1 and f'getElementById("{ids[0]}")' in text
    assert good._repr_html_().count(ids[0]) == 0, "two displays have two ids"


def test_texts_of_a_trace_are_no_markup(evil: reel.Episode) -> None:
    page = Page(evil._repr_html_())
    page.assert_safe(scripts=1)
    assert page.text.count("evil()") > 10 and EVIL in page.text
    page = Page(evil.diff(evil.branch(1, [("finish", {})]))._repr_html_())
    page.assert_safe()
    assert "evil()" in page.text


def test_an_episode_of_an_older_simulator_and_one_that_was_aborted(golden: Path, good: reel.Episode, tmp_path: Path) -> None:
    for path in sorted((golden / "v2").rglob("*.mcap"))[:3]:
        Page(reel.open(path)._repr_html_()).assert_safe(scripts=1)
    early = good.at(2).play(record=tmp_path / "early.mcap", images=False).close()
    assert early is not None
    page = Page(early._repr_html_())
    page.assert_safe(scripts=1)
    assert "aborted" in page.text and "✓ success" not in page.text


def test_images_fit_the_budget() -> None:
    noise = {call: np.random.default_rng(call).integers(0, 256, (480, 640, 3), dtype=np.uint8) for call in range(60)}
    for budget in (2_000_000, 300_000, 50_000):
        made = data_uris(noise, budget)
        assert 0 < sum(map(len, made.values())) <= budget and made.keys() <= noise.keys()
    assert len(data_uris(noise, 2_000_000)) == 60
    assert data_uris({}) == {}


def test_images_without_pillow(monkeypatch: pytest.MonkeyPatch, good: reel.Episode) -> None:
    pillow = pytest.importorskip("PIL.Image")
    image = good.frame()
    assert image is not None
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "PIL" else find(name, *rest))
    kind, data = encoded(image, reduce=4)
    assert kind == "image/png"
    decoded = np.asarray(pillow.open(BytesIO(data)))
    assert decoded.shape == (120, 160, 3) and np.array_equal(decoded, reduced(image, 4) & 0xF8)
    text = good._repr_html_()
    assert "data:image/png" in text and len(text) < 1_500_000


# --- explanations and comparisons


def test_an_explanation_shows_the_decisive_step_beside_a_better_future(failed: reel.Episode, good: reel.Episode) -> None:
    explanation = failed.blame()
    text = explanation._repr_html_()
    page = Page(text)
    page.assert_safe()
    assert explanation.decisive is not None and explanation.better is not None
    assert f"Call {explanation.decisive.index} decided" in page.text and explanation.decisive.call in page.text
    assert "A better future" in page.text and explanation.better.steps[explanation.decisive.index].call in page.text
    assert page.count("img") > 4 and len(text) < 1_500_000
    bare = failed.blame(alternatives=False)
    assert "No better future was kept" in Page(bare._repr_html_()).text
    assert "no call decided against it" in Page(good.blame()._repr_html_()).text


def test_verdicts_and_comparisons(failed: reel.Episode, good: reel.Episode) -> None:
    page = Page(good.replay()._repr_html_())
    page.assert_safe()
    assert "✓ exact" in page.text
    assert "calls are the same" in Page(good.diff(good)._repr_html_()).text
    page = Page(good.diff(good.branch(2, [("finish", {})]))._repr_html_())
    page.assert_safe()
    assert "The first 2 calls are the same." in page.text and "finish()" in page.text


# --- tables


def test_a_table_shows_types_and_its_first_rows(store: reel.Store) -> None:
    table = store.sql(
        "SELECT step AS n, reward, tool, success, error_code, terms, '<script>evil()</script>' AS \"<b>\" FROM steps ORDER BY step"
    )
    text = table._repr_html_()
    page = Page(text)
    page.assert_safe()
    assert page.count("tr") == 51 and "the first 50 are shown" in page.text and f"{len(table):,} rows" in page.text
    assert [word for word in page.texts if word in ("integer", "float", "text", "boolean", "list")][:4] == ["integer", "float", "text", "boolean"]
    assert "<script>evil()</script>" in page.text and "<b>" in page.text and "null" in page.text
    assert len(store.sql("SELECT * FROM steps")._repr_html_()) < 1_500_000
    assert "0 rows" in Page(store.sql("SELECT step FROM steps WHERE step > 1000")._repr_html_()).text


# --- the flow of failures


def test_failures_flow_to_their_classes(played: Path, tmp_path: Path) -> None:
    store = reel.Store.ingest(played, tmp_path / "store")
    before = reel.sankey(store)
    assert [flow.class_name for flow in before.flows] == ["not classified"] * len(before.flows)
    assert "reel taxonomy" in before._repr_html_()
    reel.command("taxonomy", store=tmp_path / "store")
    diagram = reel.sankey(store)
    assert (diagram.failures, diagram.episodes, diagram.successes) == (4, 8, 4)
    assert "4 failures in 8 episodes" in repr(diagram)
    page = Page(diagram._repr_html_())
    page.assert_safe()
    rows = store.sql("SELECT DISTINCT class, sub_class FROM failed_episodes").rows()
    for row in rows:
        assert row["class"] in page.text and row["sub_class"].replace("_", " ") in page.text
    root = ElementTree.parse(diagram.save(tmp_path / "flow.svg")).getroot()
    assert root.tag.endswith("svg") and len(root.findall(".//{*}path")) >= 2 * len(rows)
    assert reel.sankey(store, policy="oracle").flows == [] and reel.sankey(str(store.location), where="success").failures == 0
    assert "0 failures in 4" in reel.sankey(store, policy="oracle")._repr_html_()


def test_many_and_odd_names_make_a_diagram() -> None:
    flows = [Flow(f"<F{n % 7}>", f"class & {n % 5}", f"sub_{n}", 1 + n % 11) for n in range(200)]
    diagram = Sankey(flows, 5000, 5000 - sum(flow.episodes for flow in flows), "<title>")
    root = ElementTree.fromstring(diagram.svg())
    names = [text.text for text in root.iterfind(".//{*}text")]
    assert len(names) < 60 and "others" in names and "<F3>" in names
    numbers = [float(number) for path in root.iterfind(".//{*}path") for number in re.findall(r"-?[\d.]+", path.attrib["d"])]
    height = float(root.attrib["viewBox"].split()[3])
    assert min(numbers) >= 0 and max(numbers) <= max(height, 1000)


# --- in a browser


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_the_scrubber_runs_in_a_browser(evil: reel.Episode, failed: reel.Episode, tmp_path: Path) -> None:
    moves = """<script>window.evil=function(){document.title="evil"};
var all=document.querySelectorAll("input"),range=all[all.length-1];range.value=2;range.dispatchEvent(new Event("input"));
document.querySelectorAll(".clock button")[1].click();</script>"""
    path = tmp_path / "page.html"
    path.write_text(f"<!doctype html><meta charset=utf-8><title>good</title>{evil._repr_html_()}{failed._repr_html_()}{moves}")
    assert CHROMIUM is not None
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", path.as_uri()]
    dom = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True).stdout
    assert "<title>good</title>" in dom, "no text of the trace ran"
    assert [text for text in re.findall(r"<output>(.*?)</output>", dom)] == ["call 0 of 3", f"call 1 of {len(failed)}"]
    assert len(re.findall(r'<li data-call="\S+" class="[^"]*" aria-current="step">', dom)) == 2
    assert dom.count('class="stage"') == 2 and 'class="stage" hidden' not in dom


# --- the player


@pytest.fixture
def player(good: reel.Episode) -> Any:
    pytest.importorskip("anywidget")
    from reel.notebook import EpisodePlayer

    return EpisodePlayer(good)


def test_a_player_sends_images_that_are_asked_for(player: Any, good: reel.Episode, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[Any, list[bytes]]] = []
    monkeypatch.setattr(type(player), "send", lambda _self, content, buffers: sent.append((content, buffers)))
    last = len(good) - 1
    for wanted in (-1, 1, last):
        player._handle_custom_msg({"frame": wanted}, [])
    for nonsense in ({"frame": last + 1}, {"frame": "1"}, {"other": 1}, "text", None):
        player._handle_custom_msg(nonsense, [])
    assert [content["frame"] for content, _ in sent] == [-1, 1, last]
    assert sent[1][0]["of"] == 1 and sent[2][0]["of"] < last, "finish returns no image: the latest one is shown"
    assert all(content["type"].startswith("image/") and len(buffers[0]) > 5_000 for content, buffers in sent)
    state = player.get_state()
    assert len(str({name: state[name] for name in ("steps", "title", "ending")})) < 100_000, "no image is in the state"


def test_python_sees_where_the_user_is(player: Any, good: reel.Episode) -> None:
    seen: list[int] = []
    player.observe(lambda change: seen.append(change["new"]), "call")
    assert player.call == -1 and player.step is None
    # what the page does
    player.set_state({"call": 2})
    assert player.call == 2 and player.step.call == good.steps[2].call
    player.go(-1)
    player.go(None)
    assert seen == [2, len(good) - 1, -1]
    with pytest.raises(reel.ReelError, match="unknown call 99"):
        player.go(99)
    assert player.steps[0]["call"] == good.steps[0].call
