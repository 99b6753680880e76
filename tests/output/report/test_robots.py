"""The report of a robot: what is refused, and torques with gaps."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.result.robot import SpringVerdict
from jointid.output.report import Report
from jointid.output.report.data_sheet import data_sheets
from jointid.records.record import Record
from jointid.simulation.synthesis import simulate
from tests.estimation.robots.twin import arm, identified, records_of
from tests.output.report import reports
from tests.robots_plants import two


def test_what_is_refused_is_not_in_the_table() -> None:
    twin = two((9.0, None))
    loop, driven = twin.loop(), twin.records(2.0, multisine=0.01)
    logged = simulate(loop, driven).records(driven)
    records = tuple(Record(torque=one.torque, reference=one.reference) for one in logged)
    found = identified(loop, records, DIDIM(evaluations=3))
    part = replace(found.require_robot(), springs=(SpringVerdict("joint1", False, None, None, 1234.0),))
    bounds = {"joint1.stiffness": 1234.0, "joint1.damping": None}
    rows = tuple(
        replace(row, value=None, stderr=None, lower_bound=bounds[row.name]) if row.name in bounds else row
        for row in found.params.rows
    )
    estimate = replace(found, robot=part, params=replace(found.params, rows=rows))
    told = Report.of(estimate, records)
    text = reports.marked(told)
    assert "| joint1, stiffness | c | > 1234 |" in text
    sheet = text.split("## Data sheet")[1].split("\n## ")[0]
    assert "| stiffness | > 1234 | N\u202fm/rad | refused |" in sheet
    assert re.search(r"\| armature \| 0\.8\d+ ± \S+ \| kg\u202fm² \|", sheet)
    gains = [loop.controllers[k].position_gain for k in range(2)]  # type: ignore[attr-defined]
    assert [float(kp) for kp in re.findall(r"\| kp \| (\S+) \|", sheet)] == pytest.approx(gains, rel=1e-4)
    assert "It was not held against a record that it has not seen" in text
    answer = json.loads(told.answer())
    assert answer["estimate"]["schema"] == "jointid.Estimate/2" and answer["validation"] is None
    assert set(told.figures) == {"torque", "residual", "spectra"}
    assert np.ptp(told.figures["torque"].axes[0].lines[0].get_ydata()) > 0


def test_the_data_sheet_says_in_which_sum_an_armature_is() -> None:
    robot, records = arm(3), records_of(arm(3), 2, noise=0.2)
    law = ji.controller.PD(position_gain=50.0, derivative_gain=2.0, limit=9.0, delay=5e-4)
    estimate = identified(robot, records)
    first, _, last = (table.rows for table in data_sheets(estimate, [law] * 3))
    with pytest.raises(ji.MethodError):
        list(data_sheets(estimate, [law] * 4))
    assert first[0] == ("armature", "-", "kg m2", "only in the sum Izz1")
    (armature,) = (row for row in last if row[0] == "armature")
    assert armature[1].startswith("1.000") and armature[3] == ""
    assert [row[0] for row in last[1:3]] == ["damping", "friction loss"]
    assert last[-4:] == (
        ("kp", "50.000", "N m/rad", "declared"), ("kd", "2.0000", "N m s/rad", "declared"),
        ("limit", "9.0000", "N m", "declared"), ("delay", "0.5", "ms", "declared"),
    )  # fmt: skip


def test_the_lines_of_the_torques_break_where_nothing_is_compared() -> None:
    records = records_of(arm(3), 2, noise=0.2)
    for axes in Report.of(identified(arm(3), records), records).figures["torque"].axes:
        for line in axes.lines:
            hidden = np.isnan(np.asarray(line.get_ydata()))
            assert 0 < np.mean(hidden) < 0.5
