"""The report: every section for every method, one page that loads nothing, and hostile names that stay names."""

import json
import os
import re
import shlex
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from matplotlib.figure import Figure

import jointid as ji
from jointid.common.charts import mark, panels, styled, svg
from jointid.diagnostics.analysis import compute_response, estimate_spectra
from jointid.output.axis_drawing import axis_figure
from jointid.output.figures import response_figure
from jointid.output.json import keep, recall
from jointid.output.report import Report, _tune, repetition
from jointid.simulation.start import INITIAL
from tests.browser import opened
from tests.estimates import amended
from tests.estimation.robots.twin import arm, identified, records_of
from tests.joint_files import EXAMPLE as EMPS
from tests.output.report import reports
from tests.output.report.reports import Elements
from tests.rigid_axis import run
from tests.robots_plants import two

SECTIONS = (
    "Result", "Parameters", "Torque", "Appendix", "The estimate in full", "Residual", "Spectra",
    "Frequency response", "Settings and data",
)  # fmt: skip


@pytest.fixture(scope="module")
def rigid_page() -> str:
    return reports.rigid().html()


@pytest.mark.parametrize("kind", ["rigid", "idim", pytest.param("flexible", marks=pytest.mark.slow)])
def test_every_section_is_there(kind: str) -> None:
    text = reports.marked(replace(getattr(reports, kind)(), absent={"part": "one sentence,\nin two lines"}))
    assert "One sentence, in two lines." in text
    assert not re.search(r"\b(ZZ|K|Fv|Fc)[12]*\b", text.partition("## Appendix")[0])  # the paper's symbols
    found = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert [one for one in found if one in SECTIONS] == list(SECTIONS)
    assert not re.search(r"\b(nan|None)\b", text) and re.search(r"(6 s at 1000 Hz, 2 rad|12 s at .*, 0.2 m) at", text)


def test_what_to_do_stands_once_and_before_the_appendix() -> None:
    given = reports.flexible()
    (axis,) = given.diagnosis.axes  # type: ignore[union-attr]
    faulty = replace(given.diagnosis, axes=(replace(axis, faults=replace(axis.faults, explained=0.5)),))  # type: ignore[type-var]
    text = reports.marked(replace(given, diagnosis=faulty))
    assert text.partition("## Appendix")[0].count("What to do") == text.count("What to do") == 1


def test_the_date_is_that_of_the_file(emps_path: Path, tmp_path: Path) -> None:
    joint, record = tmp_path / "joint.toml", tmp_path / "run.csv"
    joint.write_text('controller = { law = "cascade", integral_time = "30 ms" }', encoding="utf-8")
    record.write_text("t", encoding="utf-8")
    os.utime(record, (86400.0 * 366, 86400.0 * 366))
    assert repetition(joint, [record], {}).record_date == "1971-01-02"
    of_folder = repetition(joint, [tmp_path], {}, ["joint.torque_constant=0.5", "record.channels.torque.tap=measured"])
    assert of_folder.record_date and of_folder.declared["Controller"] == "law cascade, integral time 30 ms"
    assert "0.5 (" in of_folder.declared["Drive"] and "actual value" in of_folder.declared["Drive"]
    changes = ["drive.profile=generic", "record.channels.torque.column=i"]
    assert "setpoint" not in repetition(joint, [record], {}, changes).declared["Drive"]  # a profile knows its signals
    one, both = repetition(joint, [record], {}), repetition(joint, [record, emps_path], {})
    record.write_text("t2", encoding="utf-8")
    hashes = {each.record_file_sha256 for each in (one, both, repetition(joint, [record, emps_path], {}))}
    assert len(hashes) == 3 and "--record run.csv" in one.command and "--record" not in both.command


@pytest.mark.parametrize("raised", [ji.MethodError, ji.RecordError, np.linalg.LinAlgError])
def test_a_report_is_written_whatever_ends_its_tuning(raised: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ji, "tune", Mock(side_effect=raised("by design")))
    estimate, record = reports.rigid().estimate, reports.rigid_record()[0]
    assert Report.of(estimate, record, profiles=[], tuning=True).absent == {"tuning": "by design"}
    with pytest.raises(ji.MethodError, match="relied"):
        _tune(Mock(**{"answer.trust.code": "not_reliable_yet"}))


def test_the_three_frequencies_are_marked() -> None:
    told = reports.flexible()
    expected = ji.FlexibleJoint.frequencies(told.estimate.values)
    assert told.response.modes == expected
    marks = [text.get_text() for text in told.figures["spectra"].axes[0].texts]
    assert [f"{name} {hertz:.1f} Hz" for name, hertz in (
        ("load locked", expected["load_locked"]), ("motor locked", expected["motor_locked"]),
        ("free-free", expected["free_free"]))] == marks[:3]  # fmt: skip
    # An estimate from a file keeps no torque, and has its frequency response.
    kept = replace(told.estimate, fit=replace(told.estimate.fit, measured=np.zeros(0), predicted=np.zeros(0)))
    assert len(response_figure(kept, told.response).axes) == 2


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
    assert carried["estimate"]["data"]["fingerprints"][0] in text


def test_nothing_is_loaded_from_elsewhere_and_ids_are_unique(rigid_page: str) -> None:
    elements = Elements(rigid_page)
    ids = [attributes["id"] for _, attributes in elements.found if "id" in attributes]
    assert len(ids) == len(set(ids)) and set(re.findall(r'(?:url\(|href=")#(\w[^")]*)', rigid_page)) <= set(ids)
    for tag, attributes in elements.found:
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), (tag, attributes)
    policy = next(m["content"] for m in elements.of("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';") and "script-src" not in policy


def test_hostile_names_stay_names(rigid_page: str) -> None:
    assert {one.get("type") for one in Elements(rigid_page).of("script")} == {"application/json"}
    assert not any(attributes.get("href", "").startswith("javascript") for attributes in Elements(rigid_page).of("a"))
    carried = re.findall(r'id="jointid-answer">(.*?)</script>', rigid_page, re.DOTALL)[0]
    assert "<" not in carried and json.loads(carried)["estimate"]["data"]["record"] == reports.EVIL


def test_a_chart_makes_no_element_of_a_name() -> None:
    @styled
    def draw(name: str) -> Figure:
        figure, (axes,) = panels((200,), title=name)
        axes.plot([0.0, 1.0, 2.0], label=name)
        mark(axes, 1.0, name)
        axes.set(xlabel=name, ylabel=name, title=name)
        return figure

    figures = [draw(name) for name in ("a name", reports.EVIL, r"$\none$")]
    friendly, hostile, _ = (Elements(svg(one, "x").decode()).tags for one in figures)
    assert set(hostile) == set(friendly)
    assert hostile.count("text") == friendly.count("text")


@pytest.mark.browser
def test_the_page_shows_its_charts_and_runs_no_name(rigid_page: str, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(rigid_page, encoding="utf-8")
    assert reports.rigid().html() == rigid_page, "the same bytes"
    with opened(path, viewport={"width": 1280, "height": 900}) as (page, complaints):
        assert page.evaluate("document.querySelectorAll('figure > svg').length") >= 6
        assert page.title().startswith("<script>document.title='x'")  # a name, not a script
        assert page.evaluate("document.documentElement.scrollWidth") <= 1280
        assert complaints == []
    with opened(path, viewport={"width": 820, "height": 900}) as (page, _):
        assert page.evaluate("document.documentElement.scrollWidth") <= 820


def test_the_motor_dips_at_the_motor_locked_frequency_and_peaks_at_the_free_free_one() -> None:
    found = compute_response(reports.flexible().estimate)
    motor = found.magnitude[0]
    near = (found.frequency > 15) & (found.frequency < 60)
    lowest = found.frequency[near][np.argmin(motor[near])]
    highest = found.frequency[near][np.argmax(motor[near])]
    assert lowest == pytest.approx(found.modes["motor_locked"], rel=0.02)
    assert highest == pytest.approx(found.modes["free_free"], rel=0.02)


def test_the_spectrum_of_white_noise_is_flat_and_of_the_right_size() -> None:
    noise = np.random.default_rng(0).standard_normal(50_000)
    _, measured, _, error = estimate_spectra(noise, np.zeros_like(noise), 1e-3)
    inner = error[2:-2]
    assert np.mean(inner**2) == pytest.approx(1.0 / 500.0, rel=0.03)  # variance 1 over 500 Hz
    assert np.array_equal(error, measured)
    with pytest.raises(ji.RecordError):
        estimate_spectra(noise[:20], noise[:20], 1e-3)


def test_what_is_refused_is_not_in_the_table_and_is_kept(tmp_path: Path) -> None:
    twin = two((9.0, None))
    loop, driven = twin.loop(), twin.records(2.0, multisine=0.01)
    logged = ji.simulate(loop, driven).records(driven)
    records = tuple(ji.Record(torque=one.torque, reference=one.reference) for one in logged)
    found = identified(loop, records, ji.DIDIM(evaluations=3))
    bounds = {"joint1.stiffness": 1234.0, "joint1.damping": None}
    rows = tuple(
        replace(row, value=None, stderr=None, lower_bound=bounds[row.name]) if row.name in bounds else row
        for row in found.rows
    )
    estimate = replace(found, rows=rows)
    keep(tmp_path / "kept.json", "key", estimate)
    back = recall(tmp_path / "kept.json", loop, "key")  # type: ignore[arg-type]
    assert back.to_dict() == estimate.to_dict() and np.array_equal(back.robot.values, estimate.robot.values)  # type: ignore[union-attr]
    told = Report.of(back, records)  # type: ignore[arg-type]
    text = reports.marked(told)
    assert "| joint1, stiffness | > 1234 |" in text
    answer = json.loads(told.answer())
    assert answer["estimate"]["schema"] == "jointid.Estimate/2" and answer["validation"] is None
    assert set(told.figures) == {"torque", "residual", "spectra"}
    assert np.ptp(told.figures["torque"].axes[0].lines[0].get_ydata()) > 0


@pytest.mark.slow
def test_a_robot_begins_with_its_joints() -> None:
    records = records_of(arm(3), 2, noise=0.2)
    report = Report.of(identified(arm(3), records), records)
    first, _, appendix = reports.marked(report).partition("## Appendix")
    assert "| joint3 |" in first and "| Izz1 |" in appendix
    assert not re.search(r"\b(I[xyz]{2}|m[xyz]|F[cv])\d", first)  # the inertial parameters
    for line in [line for axes in report.figures["torque"].axes for line in axes.lines]:
        assert 0 < np.mean(np.isnan(np.asarray(line.get_ydata()))) < 0.5, "it breaks where nothing is compared"


def texts(estimate: ji.Estimate) -> list[str]:
    return [one.get_text() for one in axis_figure(estimate).axes[0].texts]


@pytest.mark.parametrize("kind", ["rigid", "flexible"])
def test_every_value_is_in_the_drawing_and_none_is_cut(kind: str) -> None:
    estimate = getattr(reports, kind)().estimate
    shown = [row for row in estimate.rows if row.name not in INITIAL]
    assert shown
    for row in shown:
        assert str(row) in texts(estimate), row.name
    assert {"motor", "load"} <= {*texts(estimate)} if kind == "flexible" else "motor" not in texts(estimate)
    stiff = {"value": 4.05e7, "stderr": 2.2e6, "lack_of_fit": 0.0}
    estimate = replace(estimate, rows=[replace(p, **stiff) if p.name == "stiffness" else p for p in estimate.rows])
    assert ({"stiffness, N/µm", "40.5 ± 4.4"} <= {*texts(estimate)}) == (kind == "flexible")
    figure = axis_figure(estimate)
    figure.draw_without_rendering()
    width, height = figure.get_size_inches() * figure.dpi
    for one in figure.axes[0].texts:
        found = one.get_window_extent()
        assert -1 <= found.x0 < found.x1 <= width + 1 and -1 <= found.y0 < found.y1 <= height + 1, one.get_text()


def test_a_gear_is_drawn_with_its_ratio_and_the_side_of_the_values() -> None:
    estimate = reports.rigid().estimate
    joint = replace(estimate.settings.joint, transmission=ji.Transmission(load="revolute", ratio=98.6))
    found = texts(amended(estimate, settings={"system": joint}))
    assert {"98.6:1", "values on the load side of the gear"} <= {*found}
