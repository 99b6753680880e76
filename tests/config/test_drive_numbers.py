"""Learned numbers as the drive shows them: by its names, in its units, on its side of a gear, beside the declared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointid.config import load, loads
from jointid.controller_id.learned_controller import LearnedController, LearnedNumber, numbers_in_drive
from jointid.controller_id.structures import Structure
from jointid.models.controllers import Cascade, Controller
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.output.json import dumps, to_dict

GEARED = """
[joint]
kind = "revolute"
torque_constant = "0.72 N m/A"
[transmission]
ratio = 100
[record.channels]
torque = { column = "i", unit = "A" }
reference = { column = "r" }
motor_position = { column = "q" }
"""
DECLARED = """
[controller]
law = "cascade"
position_gain = "30 1/s"
velocity_gain = "0.8 A s/rad"
integral_time = "6 ms"
"""


def shown(text: str, made: Controller, folder: Path, **values: float) -> LearnedController:
    """What was learned of a joint file's drive: that law, with those of its numbers known to 1 %."""
    path = folder / "joint.toml"
    path.write_text(text, encoding="utf-8")
    file = load(path, learn=True)
    numbers = tuple(LearnedNumber(n, v, 0.005 * v, "", 0.99 * v, 1.01 * v) for n, v in values.items())
    learned = LearnedController(
        made, Structure(), numbers, np.eye(len(numbers)), (), (), (), 1.0, 0.01, 1.0, 1.0, 100.0, np.zeros(1), "N m",
        "rad", "run 1", file.joint.transmission,
    )  # fmt: skip
    return learned.beside(file.axis.drive_numbers(made))


def test_a_gain_that_may_be_below_0_has_a_time_from_its_upper_end() -> None:
    """Of an integral gain between -50 and 200 1/s the time is 5 ms or more; below 0 there is none."""
    to = DriveNumber("integral_gain", "integral_time", "ms", 1e3, inverse=True)
    [time] = numbers_in_drive([LearnedNumber("integral_gain", 75.0, 62.5, "1/s", -50.0, 200.0)], [to])
    assert (time.lower, time.upper) == (pytest.approx(5.0), np.inf)


def test_a_gain_on_the_load_is_the_drive_s_on_the_motor(tmp_path: Path) -> None:
    """72 N m of the load are one ampere, and a radian of the load 100 of the motor."""
    made = Cascade(position_gain=30.0, velocity_gain=84.0, integral_gain=160.0, gain=72.0)
    values = {"position_gain": 30.0, "velocity_gain": 84.0, "integral_gain": 160.0}
    learned = shown(GEARED + DECLARED, made, tmp_path, **values)
    assert '"feedforward": []' in dumps(to_dict(learned))
    position, velocity, time = learned.in_drive
    assert (velocity.value, velocity.unit, velocity.declared) == (pytest.approx(0.84), "A s/rad", pytest.approx(0.8))
    assert velocity.difference == pytest.approx(0.05)
    assert velocity.spread == pytest.approx(0.0084)
    assert (time.name, time.value, time.unit) == ("integral_time", pytest.approx(6.25), "ms")
    assert time.declared == pytest.approx(6.0)
    assert time.lower < 6.25 < time.upper
    assert (position.value, position.difference) == (pytest.approx(30.0), pytest.approx(0.0))


def test_a_law_that_speaks_torque_on_the_load_is_in_ampere_on_the_motor(tmp_path: Path) -> None:
    made = Cascade(position_gain=30.0, velocity_gain=72.0 * 84.0)
    (velocity,) = shown(GEARED + DECLARED, made, tmp_path, velocity_gain=72.0 * 84.0).in_drive
    assert velocity.value == pytest.approx(0.84)


def test_the_torque_constant_alone_tells_the_drive_s_unit(tmp_path: Path) -> None:
    made = Cascade(position_gain=30.0, velocity_gain=84.0, integral_gain=160.0, gain=72.0)
    velocity, integral = shown(GEARED, made, tmp_path, velocity_gain=84.0, integral_gain=160.0).in_drive
    assert (velocity.value, velocity.unit, velocity.declared) == (pytest.approx(0.84), "A s/rad", None)
    assert (integral.value, integral.unit, integral.declared) == (pytest.approx(160.0), "1/s", None)  # no stand-in


@pytest.mark.parametrize(
    ("said", "name", "value"),
    [("integral_time = 0.02", "integral_time", 0.02), ("integral_gain = 50", "integral_gain", 50.0)],
)
def test_an_integral_is_told_as_the_file_declares_it(said: str, name: str, value: float) -> None:
    law = f'[controller]\nlaw = "cascade"\nposition_gain = 30.0\nvelocity_gain = 84.0\n{said}\n'
    told = {one.number: one for one in loads(GEARED + law).declared_numbers}["integral_gain"]
    assert (told.name, told.of(50.0)) == (name, pytest.approx(value))


def test_a_filter_that_is_declared_by_its_cutoff_is_told_by_it() -> None:
    """Of any unit; one that is declared by its time constant is told by that."""
    law = DECLARED + 'velocity_filter = { kind = "first_order", cutoff = "0.2 kHz" }\n'
    told = {one.number: one for one in loads(GEARED + law).declared_numbers}["velocity_filter.time_constant"]
    assert (told.name, told.unit, told.declared) == ("velocity_filter.cutoff", "kHz", pytest.approx(0.2))
    assert told.of(1 / (2 * np.pi * 100.0)) == pytest.approx(0.1)
    timed = law.replace("cutoff", "time_constant").replace("0.2 kHz", "2 ms")
    told = {one.number: one for one in loads(GEARED + timed).declared_numbers}["velocity_filter.time_constant"]
    assert (told.name, told.unit, told.declared) == ("velocity_filter.time_constant", "ms", pytest.approx(2.0))
