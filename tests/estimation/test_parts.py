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
"""


def require_truth(found: ji.Estimate) -> None:
    for name in NAMES:
        assert found[name].value == pytest.approx(TRUTH[name], abs=3.5 * found[name].stderr, rel=1e-9)
        assert found[name].stderr < 0.02 * TRUTH[name]


METHODS = [ji.DIDIM(), ji.DIDIM(outputs=("motor_position",)), ji.IDIM(), ji.IDIM(estimator="iv"), ji.DriveSideFit()]


@pytest.mark.parametrize(("method", "windows"), [(ji.DIDIM(), 2.5), *((one, False) for one in METHODS)])
def test_nothing_of_what_is_left_out_is_in_the_answer(method: Any, windows: float) -> None:
    record, model = replace(pushed(0.3), left_out=((FIRST, LAST),)), LOOP if method.name != "drive_side" else LOOP.joint
    asked: dict[str, Any] = {"checks": False, "windows": windows}
    found = ji.identify(record, model, method, **asked)
    require_truth(found)
    spoilt = record.torque.values + 5.0 * (record.counts(len(record.torque), STEP) == 0.0)
    spoilt = record.with_channels({"torque": replace(record.torque, values=spoilt)})
    again = ji.identify(spoilt, model, method, **asked)
    share = 1.0 if windows else 0.01  # of a deviation: how much of a window settles depends on its torque
    assert all(abs(again[name].value - found[name].value) < share * found[name].stderr for name in NAMES)


@pytest.mark.parametrize("method", ["idim", "drive_side"])
def test_tests_in_one_log_are_identified_together_as_the_refusal_says(tmp_path: Path, method: str) -> None:
    record = pushed(0.3)
    time, text = record.torque.time, FILE + f'[method]\nname = "{method}"'
    there = (time < FIRST) | (time >= LAST)
    table = np.column_stack([time + 100.0, record.torque.values, record.motor_position.values])[there]
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,i,q", comments="", fmt="%.12g")
    with pytest.raises(ji.RecordError) as refused:
        loads(text, tmp_path).record()
    parts = str(refused.value).partition("parts = ")[2].partition(" for")[0]
    assert json.loads(parts) == [[100.0, 102.999], [103.95, 107.999]]
    file = loads(text, tmp_path, [f"record.parts={parts}"])
    require_truth(file.identify_together())
    with pytest.raises(ji.MethodError):
        file.log()  # in windows a log is one record
