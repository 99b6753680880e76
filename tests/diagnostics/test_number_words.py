"""Numbers of a controller that is not as declared, told in the joint file's own quantities and units."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pytest

import jointid as ji
from jointid.config import File, loads
from jointid.diagnostics.faults.fault import FaultTest
from jointid.diagnostics.faults.numbers import describe_in_drive, number_fault
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record

RIGID = """
[joint]
kind = "revolute"
model = "rigid"
torque_constant = "0.5 N m/A"
[transmission]
ratio = 50
[record.channels]
torque = { column = "i", unit = "A" }
reference = { column = "r" }
[controller]
law = "cascade"
position_gain = "20 1/s"
velocity_gain = "0.055 A s/rad"
integral_time = "50 ms"
velocity_filter = { kind = "first_order", cutoff = "160 Hz" }
"""
FLEXIBLE = """
[joint]
kind = "prismatic"
model = "flexible"
[record.channels]
torque = { column = "f" }
reference = { column = "r" }
[controller]
law = "cascade"
position_gain = "2400/min"
velocity_gain = "6 N s/mm"
integral_time = "0.1 s"
"""
VALUES: Mapping[str, dict[str, float]] = {
    RIGID: {"inertia": 4.0, "viscous": 12.0, "coulomb": 20.0, "offset": 3.0},
    FLEXIBLE: {
        "motor_inertia": 50.0, "motor_viscous": 90.0, "motor_coulomb": 10.0, "stiffness": 9e5, "damping": 160.0,
        "load_inertia": 45.0, "load_viscous": 110.0, "load_coulomb": 10.0, "offset": -3.0,
    },
}  # fmt: skip


def logged(file: File, text: str, changed: Mapping[str, float]) -> Record:
    """The record of the drive whose law has other numbers than the file declares."""
    law = file.controller
    assert law is not None
    declared = numbers_of(law)
    loop = ClosedLoop(file.joint, with_numbers(law, {n: by * declared[n] for n, by in changed.items()}))
    speeds, most, travel = ((0.5, 1.0, 1.5), 8.0, 1.0) if text == RIGID else ((0.05, 0.1, 0.15), 3.0, 0.06)
    reference = trapezoids(speeds, most, travel, 1e-3, duration=8.0)
    noise = 0.5 * np.random.default_rng(1).standard_normal((2, reference.size))
    return simulated_record(
        loop, reference, VALUES[text], sample_time=1e-3, disturbance=noise[0], torque_noise=noise[1]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "changed", "said"),
    [
        (RIGID, {"integral_gain": 1 / 1.2}, r"the integral time is (\S+)(?: ± \S+)? ms, declared 50 ms"),
        (RIGID, {"position_gain": 1.1}, r"the position gain is (\S+)(?: ± \S+)? 1/s, declared 20 1/s"),
        (FLEXIBLE, {"integral_gain": 1.2}, r"the integral time is (\S+)(?: ± \S+)? s, declared 0\.1 s"),
    ],
)
def test_a_loop_that_is_not_as_declared_is_told_in_the_file_s_own_quantities(
    text: str, changed: Mapping[str, float], said: str
) -> None:
    """In the check's sentence, in the clause of the first line, and as the drive itself has it."""
    file = loads(text)
    assert file.loop is not None
    record = logged(file, text, changed)
    estimate = ji.identify(record, file.loop, shown=file.declared_numbers)
    verdict, [(name, by)] = estimate.checks.verdicts[-1], changed.items()
    there = next(one for one in file.declared_numbers if one.number == name)
    assert there.declared is not None
    truth = there.declared / by if there.inverse else there.declared * by
    for words in (verdict.said, verdict.reasons[0].brief):
        found = re.search(said, words)
        assert found is not None, words
        assert float(found[1]) == pytest.approx(truth, rel=0.01)


TIME = DriveNumber("integral_gain", "integral_time", "ms", 1e3, inverse=True, declared=50.0)
GAIN = DriveNumber("velocity_gain", "S-0-0100 velocity_gain", "A s/rad", 0.1, declared=0.55)
CUTOFF = DriveNumber("velocity_filter.time_constant", "velocity_filter.cutoff", "Hz", 0.5 / np.pi, True, 160.0)


@pytest.mark.parametrize(
    ("there", "declared", "size", "std", "said"),
    [
        (TIME, 20.0, -4.0, 0.5, "the integral time is 62.5 ± 4.2 ms, declared 50 ms"),
        (TIME, 20.0, 4.0, 0.5, "the integral time is 41.7 ± 1.8 ms, declared 50 ms"),
        (TIME, 20.0, -16.0, 3.0, "the integral time is at least 100 ms, declared 50 ms"),
        (TIME, 20.0, 4.0, 3.0, "the integral time is smaller than declared, by how much this record does not tell"),
        (TIME, 20.0, 60.0, 3.0, "torque, reference, ratio or a gain is wrong by a factor (the integral time alone "
         "would be about 12.5 ms, declared 50 ms)"),
        (TIME, 20.0, -30.0, 3.0, "torque, reference, ratio or a gain is wrong by a large factor (the integral time "
         "alone would have to change its sign)"),
        (GAIN, 5.5, -1.0, 0.1, "the S-0-0100 velocity gain is 0.450 ± 0.020 A s/rad, declared 0.55 A s/rad"),
        (GAIN, 5.5, 0.011, 0.002, "the S-0-0100 velocity gain is 0.5511 ± 4.0e-04 A s/rad, declared 0.55 A s/rad"),
        (GAIN, 5.5, -5.0, 1.0, "the S-0-0100 velocity gain is at most 0.250 A s/rad, declared 0.55 A s/rad"),
        (CUTOFF, 1e-3, 2e-4, 1e-5, "the cutoff of the velocity filter is 133 ± 2.2 Hz, declared 159.155 Hz"),
    ],
)  # fmt: skip
def test_a_number_is_told_as_the_drive_shows_it(
    there: DriveNumber, declared: float, size: float, std: float, said: str
) -> None:
    """A longer time is a smaller gain, and the longer half of its interval is told."""
    test = FaultTest(number_fault(there.number), (), declared, size, std, size / std, 1e-9)
    assert describe_in_drive(there, test, spread=True) == said
