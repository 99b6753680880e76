"""The report: every section for every method, one page that loads nothing, and hostile names that stay names."""

from __future__ import annotations

import json
import re
import shlex
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.document import inert
from jointid.output.figures.charts import thin
from jointid.output.report.report import Report
from tests.apps.cli.test_commands import EMPS, run
from tests.browser import opened
from tests.output.report import reports

SECTIONS = (
    "Result", "Verdicts", "Parameters", "Torque", "Residual", "Spectra", "Frequency response", "Correlations",
    "Profiles", "Convergence", "Validation", "Settings and data",
)  # fmt: skip


DOCS = Path(__file__).resolve().parents[3] / "docs"


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
    text = made().markdown()
    assert re.findall(r"^## (.*)$", text, re.MULTILINE)[:4] == list(SECTIONS[:4])
    assert set(SECTIONS) <= set(re.findall(r"^## (.*)$", text, re.MULTILINE))
    assert not re.search(r"\b(nan|None)\b", text)


def test_a_refused_stiffness_of_a_short_record_is_told_too(stiff_axis: tuple[ji.Record, ji.Estimate]) -> None:
    record, estimate = stiff_axis
    told = ji.report_estimate(estimate, record, profiles=[], loop=False)
    text = told.markdown()
    assert "the stiffness cannot be told" in text
    assert "at least" in text.split("## Verdicts")[0]
    assert "## Lower bound of the stiffness" in text
    assert "bounds" in told.charts
    assert "Not available: A frequency response needs every parameter" in text


@pytest.mark.slow
def test_a_refused_stiffness_is_told_in_words_and_bounds(emps_path: Path) -> None:
    told = reports.refused(emps_path)
    text = told.markdown()
    assert "the stiffness cannot be told" in text
    assert "at least" in text.split("## Verdicts")[0]
    assert "## Lower bound of the stiffness" in text
    assert "bounds" in told.charts
    assert "Tests that would show the stiffness" in text
    assert set(SECTIONS) <= set(re.findall(r"^## (.*)$", text, re.MULTILINE))
    assert "Not available: A frequency response needs every parameter" in text
    html = told.html()
    assert len(html.encode()) < 3_000_000


def test_what_a_method_does_not_have_is_said() -> None:
    text = reports.idim().markdown()
    assert "Not available: Profiles and bootstraps are of DIDIM" in text
    assert "Not available: A linear regression is solved in one step" in text
    assert "## Controller and log" not in text
    assert "## Controller and log" in reports.rigid().markdown()


def test_the_three_frequencies_are_marked() -> None:
    told = reports.flexible()
    expected = ji.frequencies(told.estimate.values)
    assert told.dossier.response is not None
    assert told.dossier.response.modes == expected
    marks = [item.label for item in told.charts["spectra"].panels[0].items if type(item).__name__ == "Mark"]
    assert [f"{name} {hertz:.1f} Hz" for name, hertz in (
        ("load locked", expected["load_locked"]), ("motor locked", expected["motor_locked"]),
        ("free-free", expected["free_free"]))] == marks[:3]  # fmt: skip


def test_the_emps_report_is_one_small_file(emps_path: Path, tmp_path: Path) -> None:
    page, answer = tmp_path / "emps.html", tmp_path / "out.json"
    words = ("--html", page, "--json", answer, "-q", "--set", 'joint.name="the axis"', "--set", "method.name=didim")
    assert run("report", EMPS, "--record", emps_path, *words) == 0
    assert page.stat().st_size < 3_000_000
    text = page.read_text(encoding="utf-8")
    estimate = json.loads(answer.read_text(encoding="utf-8"))
    carried = json.loads(re.findall(r'id="jointid-answer">(.*?)</script>', text, re.DOTALL)[0])
    assert carried["estimate"] == estimate
    assert shlex.split(carried["command"]) == [
        *("jointid", "report", "joint.toml", "--record", "DATA_EMPS.mat"),
        *("--set", 'joint.name="the axis"', "--set", "method.name=didim", "--html", "emps.html"),
    ]
    assert carried["joint_file"] == EMPS.read_text(encoding="utf-8")
    assert len(carried["record_file_sha256"]) == 64
    assert estimate["record"]["torque_sha256"] in text
    # The whole record is drawn, every sample: no peak is hidden.
    assert "samples are drawn" not in text


def test_nothing_is_loaded_from_elsewhere(rigid_page: str) -> None:
    elements = Elements(rigid_page)
    for tag, attributes in elements.found:
        for name in ("src", "href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), (tag, attributes)
    policy = next(m["content"] for m in elements.of("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-eval" not in policy
    assert "script-src 'unsafe-inline'" not in policy


def test_hostile_names_stay_names(rigid_page: str) -> None:
    scripts = Elements(rigid_page).of("script")
    data = [s for s in scripts if s.get("type") == "application/json"]
    assert len(scripts) - len(data) == 2  # the library, and what starts it
    assert not any(attributes.get("href", "").startswith("javascript") for attributes in Elements(rigid_page).of("a"))
    carried = re.findall(r'id="jointid-answer">(.*?)</script>', rigid_page, re.DOTALL)[0]
    assert "<" not in carried
    assert json.loads(carried)["estimate"]["record"]["name"] == reports.EVIL
    markdown = reports.rigid().markdown()
    assert "<script" not in markdown
    assert "](javascript" not in markdown


def test_inert_json_is_the_same_json() -> None:
    given = {"a": "</script><!-- & >", "b": ["\u2028", "\\u003c"]}
    text = inert(json.dumps(given))
    assert not re.search("[<>&]", text)
    assert json.loads(text) == given


@pytest.mark.slow
def test_the_same_answer_gives_the_same_bytes(rigid_page: str) -> None:
    assert reports.rigid().html() == rigid_page
    told = reports.rigid()
    assert told.markdown() == told.markdown()


@pytest.mark.browser
def test_the_page_draws_its_plots_and_links_their_zoom(rigid_page: str, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(rigid_page, encoding="utf-8")
    with opened(path, viewport={"width": 1280, "height": 900}) as (page, complaints):
        page.wait_for_function("document.querySelectorAll('figure.drawn').length >= 6")
        page.wait_for_function("Bokeh.index.roots.length >= 6")
        assert page.title().startswith("<script>document.title='x'")  # a name, not a script
        assert page.evaluate("document.querySelectorAll('figure:not(.drawn)').length") == 0
        moved = page.evaluate(
            """() => {
                const root = Bokeh.index.roots.find(view => view.el.parentElement.id === "plot-torque").model
                const ranges = root.children.map(child => child[0].x_range)
                ranges[1].start = 2
                ranges[1].end = 3
                return ranges.map(range => [range.start, range.end])
            }"""
        )
        assert moved[1] == moved[2] == moved[3] == [2, 3]
        assert moved[0] != [2, 3]  # the zoom stays where it is
        assert page.evaluate("document.documentElement.scrollWidth") <= 1280
        assert complaints == []
    with opened(path, viewport={"width": 820, "height": 900}) as (page, _):
        assert page.evaluate("document.documentElement.scrollWidth") <= 820


@pytest.mark.browser
def test_without_scripts_and_on_paper_the_figures_are_still(rigid_page: str, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(rigid_page, encoding="utf-8")
    stills = "[...document.querySelectorAll('img.still')].every(i => i.offsetHeight > 50)"
    with opened(path, java_script_enabled=False) as (page, _):
        assert page.locator("img.still").first.bounding_box()["height"] > 50
    with opened(path) as (page, _):
        page.wait_for_function("document.querySelectorAll('figure.drawn').length >= 6")
        assert not page.evaluate(stills)
        page.emulate_media(media="print")
        assert page.evaluate(stills)
        assert not page.locator(".plot").first.is_visible()


def test_figures_and_markdown_need_no_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("bokeh", "bokeh.embed", "bokeh.resources", "jinja2"):
        monkeypatch.setitem(sys.modules, package, None)
    told = reports.rigid()
    written = told.save_markdown(tmp_path / "markdown")
    assert written[0].name == "report.md"
    text = written[0].read_text(encoding="utf-8")
    for name in re.findall(r"\]\(([a-z]+\.svg)\)", text):
        assert (tmp_path / "markdown" / name).read_bytes().startswith(b"<?xml")
    names = {path.name for path in told.save_figures(tmp_path / "figures")}
    assert {"torque.png", "torque.svg", "spectra.png", "profiles.svg"} <= names
    with pytest.raises(ji.ExtraError, match=r'pip install "jointid\[report\]"'):
        told.save(tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()
    assert run("report", EMPS, "--record", tmp_path / "none.mat", "--html", tmp_path / "p.html", "-q") == 2
    assert "jointid[report]" in capsys.readouterr().err


def test_a_page_is_named_html(tmp_path: Path) -> None:
    with pytest.raises(ji.RecordError, match=r"saved as \.html"):
        reports.rigid().save(tmp_path / "page.pdf")
    with pytest.raises(ji.RecordError, match="cannot be written"):
        reports.rigid().save(tmp_path / "none" / "page.html")


def test_thinning_keeps_every_peak() -> None:
    rng = np.random.default_rng(0)
    x, y = np.arange(100_000.0), rng.standard_normal(100_000)
    y[54_321], y[777] = 50.0, -60.0
    at, kept = thin(x, y, most=1000)
    assert at.size <= 1002
    assert np.all(np.diff(at) > 0)
    assert (kept.max(), at[kept.argmax()]) == (50.0, 54_321.0)
    assert (kept.min(), at[kept.argmin()]) == (-60.0, 777.0)
    assert thin(x[:10], y[:10], most=1000)[0].size == 10


def test_a_long_record_says_what_is_left_out() -> None:
    told = reports.rigid()
    many = 40_000
    estimate = told.estimate.amended(
        fit={
            "measured": np.resize(told.estimate.fit.measured, many),
            "predicted": np.resize(told.estimate.fit.predicted, many),
        }
    )
    longer = Report(replace(told.dossier, estimate=estimate, motion=None))
    assert f"of {many} samples are drawn" in longer.charts["torque"].caption
    assert "residual" not in longer.charts


@pytest.mark.docs
def test_the_program_of_the_documentation_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (DOCS / "report.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(page.split("```python\n")[1].split("```")[0], {})
    assert (tmp_path / "report.html").is_file()
    assert (tmp_path / "figures" / "torque.png").is_file()
    assert (tmp_path / "markdown" / "report.md").is_file()


def test_every_key_of_the_answer_is_documented() -> None:
    page = (DOCS / "answers.md").read_text(encoding="utf-8")
    section = page.split("## `jointid.report/1`")[1].split("\n## ")[0]
    answer = json.loads(reports.rigid().answer())
    for key in (*answer, *answer["profiles"][0]):
        assert key == "schema" or f"`{key}`" in section, key


def test_side_and_direction_are_said_of_what_they_change() -> None:
    gear = ji.Transmission(load="revolute", ratio=10.0)
    joint = ji.RigidJoint("revolute", ji.AsymmetricFriction(), transmission=gear)
    loop = ji.ClosedLoop(joint, ji.Cascade(kp=40.0, kv=0.02, ratio=gear.torque("motor")))
    values = {"inertia": 0.04, "viscous_forwards": 0.05, "coulomb_forwards": 0.1, "offset": 0.0}
    values |= {"viscous_backwards": 0.08, "coulomb_backwards": 0.2}
    reference = ji.trapezoids([0.5, 1.0, 2.0], 8.0, 2.0, 1e-3, duration=6.0)
    record = ji.simulated_record(loop, reference, values, sample_time=1e-3, name="geared")
    told = ji.report_estimate(ji.identify(record, loop), record, profiles=[], loop=False)
    result = told.markdown().split("## Verdicts")[0]
    assert "with viscous friction 0.050000" in result
    assert re.search(r"viscous friction \S+ ± \S+ N m s/rad forwards, \S+ ± \S+ N m s/rad backwards", result)
    assert "The transmission is 10:1, without loss (efficiency taken as 1); values are on the load side." in result
    charts = told.charts
    assert charts["torque"].panels[1].y_label == "torque, load side [N m]"
    assert charts["residual"].panels[0].x_label == "velocity, load side [rad/s]"
    assert "simulated torque lie on each other" in charts["torque"].caption
    assert "viscous friction of moving forwards" in charts["response"].caption
