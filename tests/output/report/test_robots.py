"""The report of a robot: what is refused, and torques with gaps."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.result.robot import SpringVerdict
from jointid.output.report import Report
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
    assert "It was not held against a record that it has not seen" in text
    answer = json.loads(told.answer())
    assert answer["estimate"]["schema"] == "jointid.Estimate/2" and answer["validation"] is None
    assert set(told.figures) == {"torque", "residual", "spectra"}
    assert np.ptp(told.figures["torque"].axes[0].lines[0].get_ydata()) > 0


def test_the_lines_of_the_torques_break_where_nothing_is_compared() -> None:
    records = records_of(arm(3), 2, noise=0.2)
    for axes in Report.of(identified(arm(3), records), records).figures["torque"].axes:
        for line in axes.lines:
            hidden = np.isnan(np.asarray(line.get_ydata()))
            assert 0 < np.mean(hidden) < 0.5
