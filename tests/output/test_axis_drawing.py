"""The drawing of an axis: its values are the estimate's, and nothing of it is cut."""

from __future__ import annotations

from dataclasses import replace

import pytest

from jointid.common.transmission import Transmission
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import show_value
from jointid.output.figures.axis_drawing import axis_figure
from tests.estimates import amended
from tests.output.report import reports


def texts(estimate: Estimate) -> list[str]:
    return [one.get_text() for one in axis_figure(estimate).axes[0].texts]


@pytest.mark.parametrize("kind", ["rigid", "flexible"])
def test_every_value_is_in_the_drawing_and_none_is_cut(kind: str) -> None:
    estimate = getattr(reports, kind)().estimate
    shown = [row for row in estimate.params.rows if row.name not in INITIAL]
    assert shown
    for row in shown:
        assert show_value(row) in texts(estimate), row.name
    assert {"motor", "load"} <= {*texts(estimate)} if kind == "flexible" else "motor" not in texts(estimate)
    figure = axis_figure(estimate)
    figure.draw_without_rendering()
    width, height = figure.get_size_inches() * figure.dpi
    for one in figure.axes[0].texts:
        found = one.get_window_extent()
        assert -1 <= found.x0 < found.x1 <= width + 1 and -1 <= found.y0 < found.y1 <= height + 1, one.get_text()


def test_a_gear_is_drawn_with_its_ratio_and_the_side_of_the_values() -> None:
    estimate = reports.rigid().estimate
    joint = replace(estimate.settings.joint, transmission=Transmission(load="revolute", ratio=98.6))
    found = texts(amended(estimate, settings={"system": joint}))
    assert {"98.6:1", "values on the load side of the gear"} <= {*found}
