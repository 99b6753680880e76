"""The report: every section for every method, one page that loads nothing, and hostile names that stay names."""

from __future__ import annotations

import json
import os
import re
import shlex
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import jointid as ji
from jointid.common.charts import mark, panels, styled, svg
from jointid.common.document import templates
from jointid.output.report import repetition
from tests.apps.cli.test_commands import EMPS, run
from tests.browser import opened
from tests.output.report import reports

SECTIONS = (
    "Result", "Parameters", "Torque", "Appendix", "The estimate in full", "Residual", "Spectra",
    "Frequency response", "Settings and data",
)  # fmt: skip


class Elements(HTMLParser):
    """The elements of a page, as a browser takes it apart."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture(scope="module")
def rigid_page() -> str:
    return reports.rigid().html()


@pytest.mark.parametrize("made", [reports.rigid, reports.idim, reports.flexible])
def test_every_section_is_there(made: object) -> None:
    assert callable(made)
    text = reports.marked(made())
    found = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert [one for one in found if one in SECTIONS] == list(SECTIONS)
    assert not re.search(r"\b(nan|None)\b", text)


def test_the_date_is_that_of_the_file(emps_path: Path, tmp_path: Path) -> None:
    joint, record = tmp_path / "joint.toml", tmp_path / "run.csv"
    joint.write_text("", encoding="utf-8")
    record.write_text("t", encoding="utf-8")
    os.utime(record, (86400.0 * 366, 86400.0 * 366))
    assert repetition(joint, [record], {}).record_date == "1971-01-02"
    assert repetition(joint, [tmp_path], {}).record_date  # of a folder
    one, both = repetition(joint, [record], {}), repetition(joint, [record, emps_path], {})
    record.write_text("t2", encoding="utf-8")
    hashes = {each.record_file_sha256 for each in (one, both, repetition(joint, [record, emps_path], {}))}
    assert len(hashes) == 3 and "--record run.csv" in one.command and "--record" not in both.command


def test_the_three_frequencies_are_marked() -> None:
    told = reports.flexible()
    expected = ji.FlexibleJoint.frequencies(told.estimate.values)
    assert told.data.response is not None
    assert told.data.response.modes == expected
    marks = [text.get_text() for text in told.figures["spectra"].axes[0].texts]
    assert [f"{name} {hertz:.1f} Hz" for name, hertz in (
        ("load locked", expected["load_locked"]), ("motor locked", expected["motor_locked"]),
        ("free-free", expected["free_free"]))] == marks[:3]  # fmt: skip


@pytest.mark.slow
def test_the_emps_report_is_one_small_file(emps_path: Path, tmp_path: Path) -> None:
    page, answer = tmp_path / "emps.html", tmp_path / "out.json"
    words = ("--html", page, "--json", answer, "-q", "--set", 'joint.name="the axis"', "--set", "method.name=didim")
    assert run("report", EMPS, "--record", emps_path, *words) == 0
    assert page.stat().st_size < 3_000_000
    text = page.read_text(encoding="utf-8")
    carried = json.loads(re.findall(r'id="jointid-answer">(.*?)</script>', text, re.DOTALL)[0])
    assert carried == json.loads(answer.read_text(encoding="utf-8"))
    assert shlex.split(carried["command"]) == [
        *("jointid", "report", "joint.toml", "--record", "DATA_EMPS.mat"),
        *("--set", 'joint.name="the axis"', "--set", "method.name=didim", "--html", "emps.html"),
    ]
    assert carried["joint_file"] == EMPS.read_text(encoding="utf-8")
    assert len(carried["record_file_sha256"]) == 64
    assert carried["estimate"]["data"]["fingerprint"] in text


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(rigid_page: str) -> None:
    elements = Elements(rigid_page)
    for tag, attributes in elements.found:
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), (tag, attributes)
    policy = next(m["content"] for m in elements.of("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith("default-src 'none';")
    assert "script-src" not in policy


def test_hostile_names_stay_names(rigid_page: str) -> None:
    assert {one.get("type") for one in Elements(rigid_page).of("script")} == {"application/json"}
    assert not any(attributes.get("href", "").startswith("javascript") for attributes in Elements(rigid_page).of("a"))
    carried = re.findall(r'id="jointid-answer">(.*?)</script>', rigid_page, re.DOTALL)[0]
    assert "<" not in carried
    assert json.loads(carried)["estimate"]["data"]["record"] == reports.EVIL


def test_a_chart_makes_no_element_of_a_name() -> None:
    @styled
    def draw(name: str) -> Figure:
        figure, (axes,) = panels((200,), title=name)
        axes.plot([0.0, 1.0, 2.0], label=name)
        mark(axes, 1.0, name)
        axes.set(xlabel=name, ylabel=name, title=name)
        return figure

    figures = [draw(name) for name in ("a name", reports.EVIL, r"$\none$")]
    friendly, hostile, _ = ([tag for tag, _ in Elements(svg(one, "x").decode()).found] for one in figures)
    assert set(hostile) == set(friendly)
    assert hostile.count("text") == friendly.count("text")


def test_no_two_elements_of_a_page_have_one_id(rigid_page: str) -> None:
    ids = [attributes["id"] for _, attributes in Elements(rigid_page).found if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(|href=")#(\w[^")]*)', rigid_page)) <= set(ids)


def test_inert_json_is_the_same_json() -> None:
    given = {"a": "</script><!-- & >", "b": ["\u2028", "\\u003c"]}
    text = templates().filters["inert"](json.dumps(given))
    assert not re.search("[<>&]", text)
    assert json.loads(text) == given


@pytest.mark.slow
def test_the_same_answer_gives_the_same_bytes(rigid_page: str) -> None:
    assert reports.rigid().html() == rigid_page


@pytest.mark.browser
def test_the_page_shows_its_charts_and_runs_no_name(rigid_page: str, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(rigid_page, encoding="utf-8")
    with opened(path, viewport={"width": 1280, "height": 900}) as (page, complaints):
        assert page.evaluate("document.querySelectorAll('figure > svg').length") >= 6
        assert page.title().startswith("<script>document.title='x'")  # a name, not a script
        assert page.evaluate("document.documentElement.scrollWidth") <= 1280
        assert complaints == []
    with opened(path, viewport={"width": 820, "height": 900}) as (page, _):
        assert page.evaluate("document.documentElement.scrollWidth") <= 820
