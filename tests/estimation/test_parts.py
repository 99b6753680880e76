"""What is left out of a record does not count; parts of a log are several records."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.config import loads
from tests.diagnostics.test_in_time import LOOP, STEP, TRUTH, pushed
from tests.estimation.robots import test_several_logs as robot

FIRST, LAST = 3.0, 3.95  # s, of a push and of what the loop takes to forget it
NAMES = ("inertia", "viscous", "coulomb")
FILE = """
[joint]
kind = "revolute"
[record]
file = "log.csv"
[record.channels]
torque = { column = "i", unit = "N m", timing = "held" }
motor_position = { column = "q" }
reference = { column = "r" }
[controller]
law = "cascade"
position_gain = 25.0
velocity_gain = 2.0
integral_gain = 2.0
"""


def require_truth(found: ji.Estimate) -> None:
    for name in NAMES:
        assert found[name].value == pytest.approx(TRUTH[name], abs=3.5 * found[name].stderr, rel=1e-9)
        assert found[name].stderr < 0.02 * TRUTH[name]


def spoilt(record: ji.Record) -> ji.Record:
    values = record.torque.values + 5.0 * (record.counts(len(record.torque), STEP) == 0.0)
    return record.with_channels({"torque": replace(record.torque, values=values)})


METHODS = [ji.DIDIM(), ji.DIDIM(outputs=("motor_position",)), ji.IDIM(), ji.IDIM(estimator="iv"), ji.DriveSideFit()]


@pytest.mark.parametrize(("method", "windows"), [(ji.DIDIM(), 2.5), *((one, False) for one in METHODS)])
def test_nothing_of_what_is_left_out_is_in_the_answer(method: Any, windows: float) -> None:
    record, model = replace(pushed(0.3), left_out=((FIRST, LAST),)), LOOP if method.name != "drive_side" else LOOP.joint
    asked: dict[str, Any] = {"checks": False, "windows": windows}
    found = ji.identify(record, model, method, **asked)
    require_truth(found)
    again = ji.identify(spoilt(record), model, method, **asked)
    share = 1.0 if windows else 0.01  # of a deviation: how much of a window settles depends on its torque
    assert all(abs(again[name].value - found[name].value) < share * found[name].stderr for name in NAMES)


@pytest.mark.parametrize("method", ["idim", "drive_side", "didim"])
def test_tests_in_one_log_are_identified_together_as_the_refusal_says(tmp_path: Path, method: str) -> None:
    record = pushed(0.3)
    time, text = record.torque.time, FILE + f'[method]\nname = "{method}"'
    there = (time < FIRST) | (time >= LAST)
    columns = [time + 100.0, *(getattr(record, n).values for n in ("torque", "motor_position", "reference"))]
    table = np.column_stack(columns)[there]
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,i,q,r", comments="", fmt="%.12g")
    with pytest.raises(ji.RecordError) as refused:
        loads(text, tmp_path).record()
    parts = str(refused.value).partition("parts = ")[2].partition(" for")[0]
    assert json.loads(parts) == [[100.0, 102.999], [103.95, 107.999]]
    file = loads(text, tmp_path, [f"record.parts={parts}"])
    require_truth(file.identify_together())
    with pytest.raises(ji.MethodError):
        file.log()  # in windows a log is one record


@pytest.mark.parametrize("model", [robot.LOOP, robot.LOOP.robot])
def test_nothing_of_what_a_robot_leaves_out_is_in_its_answer(model: Any) -> None:
    records = [replace(one, left_out=((1.5, 2.2),)) for one in robot.LOGS[0]]
    found, again = (ji.identify(each, model, checks=False) for each in (records, [*map(spoilt, records)]))
    assert all(abs(again[row.name].value - row.value) < 0.1 * row.stderr for row in found.rows)
