"""The drawing of an axis: its values are the estimate's, nothing of it is cut, every text is escaped."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import pytest

from jointid.common.document import typeset
from jointid.common.transmission import Transmission
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import show_value
from jointid.output.figures.axis_drawing import draw_axis, resonance_sentence
from tests.estimates import amended
from tests.output.report import reports

TEXT = "{http://www.w3.org/2000/svg}text"
LETTER = 7.4  # px, at most on average


def texts(drawing: str) -> list[str]:
    return [one.text or "" for one in ET.fromstring(drawing).iter(TEXT)]


@pytest.mark.parametrize("kind", ["rigid", "flexible"])
def test_every_value_is_in_the_drawing_and_none_is_cut(kind: str) -> None:
    estimate = getattr(reports, kind)().estimate
    drawing = draw_axis(estimate)
    root = ET.fromstring(drawing)
    shown = [row for row in estimate.params.rows if row.name not in INITIAL]
    assert shown
    for row in shown:
        assert typeset(show_value(row)) in texts(drawing), row.name
    assert {"motor", "load"} <= {*texts(drawing)} if kind == "flexible" else "motor" not in texts(drawing)
    assert "kg m2" not in drawing
    left, top, wide, tall = map(float, root.attrib["viewBox"].split())
    for one in root.iter(TEXT):
        half = float(one.attrib.get("textLength", LETTER * len(one.text or ""))) / 2
        x, y = float(one.attrib["x"]), float(one.attrib["y"])
        assert top < y < tall, one.text
        assert one.attrib["text-anchor"] != "middle" or left <= x - half <= x + half <= wide, one.text


def test_the_sentence_has_resonance_and_antiresonance() -> None:
    estimate = reports.flexible().estimate
    found = estimate.frequencies
    stiffness, motor, load = (estimate.values[name] for name in ("stiffness", "motor_inertia", "load_inertia"))
    assert found["motor_locked"] == pytest.approx((stiffness / load) ** 0.5 / 6.283185307)
    assert found["free_free"] == pytest.approx((stiffness / load + stiffness / motor) ** 0.5 / 6.283185307)
    said = resonance_sentence(estimate)
    assert re.fullmatch(r"Resonance 29\.\d Hz, antiresonance 2\d\.\d Hz, from .*", said)
    assert typeset(said) in reports.marked(reports.flexible()).split("## Parameters")[0]
    assert resonance_sentence(reports.rigid().estimate) == ""


def test_a_gear_is_drawn_with_its_ratio_and_the_side_of_the_values() -> None:
    estimate = reports.rigid().estimate
    joint = replace(estimate.settings.joint, transmission=Transmission(load="revolute", ratio=98.6))
    drawing = draw_axis(amended(estimate, settings={"system": joint}))
    assert {"98.6:1", "values on the load side of the gear"} <= {*texts(drawing)}
    assert drawing.count("<circle") == 2


def hostile(estimate: Estimate) -> Estimate:
    rows = tuple(replace(row, unit='<b a="1">&') for row in estimate.params.rows)
    return amended(estimate, params={"rows": rows})


def test_a_hostile_unit_stays_text() -> None:
    drawing = draw_axis(hostile(reports.rigid().estimate))
    assert "<b" not in drawing
    assert any('<b a="1">&' in text for text in texts(drawing))
