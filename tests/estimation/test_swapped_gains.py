"""Gains that look swapped are asked about as soon as the reference is known; healthy ones are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.config import load
from jointid.estimation.record_warnings import ask_about_gains
from jointid.models.controllers import Cascade
from jointid.records.record import Channel
from jointid.simulation.excitation import trapezoids
from tests.mistakes import AxisName, axis, varied

T = 1e-3
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FILE = """
[joint]
kind = "revolute"
[record.channels]
torque = { column = "u" }
reference = { column = "r" }
[controller]
law = "cascade"
"""


def moves(step: float = 0.0) -> Channel:
    values = trapezoids((0.5, 1.0), 4.0, 1.0, T, 0.3, 8.0)
    return Channel(np.round(values / step) * step if step else values, "rad", T)


@pytest.mark.parametrize("step", [0.0, 1e-5])
def test_a_position_gain_with_which_no_axis_arrives_is_asked_about(step: float) -> None:
    """Kp = 0.8 A s/rad and Kv = 22 1/s, each in the other's place; the reference may be rounded."""
    question = ask_about_gains(Cascade(position_gain=0.8, velocity_gain=22.0), moves(step))
    assert question is not None
    assert "position_gain is 0.800 1/s" in question
    assert "are the two swapped?" in question
    assert ask_about_gains(Cascade(position_gain=22.0, velocity_gain=0.8), moves(step)) is None


def test_what_explains_the_lag_otherwise_is_not_asked_about() -> None:
    """A feed-forward makes up for the lag; and the other number in its place may lag as much."""
    swapped = Cascade(position_gain=0.8, velocity_gain=22.0)
    assert ask_about_gains(replace(swapped, velocity_feedforward=1.0), moves()) is None
    assert ask_about_gains(replace(swapped, velocity_gain=0.9), moves()) is None
    assert ask_about_gains(swapped, None) is None


def test_a_multisine_that_a_soft_loop_cannot_follow_is_not_asked_about() -> None:
    t = T * np.arange(8000)
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, 40)
    values = sum(np.sin(2 * np.pi * 0.5 * (k + 1) * t + phase) for k, phase in enumerate(phases))
    reference = Channel(np.asarray(values), "rad", T)
    assert ask_about_gains(Cascade(position_gain=2.0, velocity_gain=200.0), reference) is None


@pytest.mark.parametrize("name", ["rigid", "flexible", "screw", "fast"])
def test_healthy_drives_are_not_asked_about(name: AxisName) -> None:
    for seed in range(8):
        made = varied(axis(name), seed)
        assert ask_about_gains(made.controller, Channel(made.reference, "rad", made.rate)) is None


def test_the_public_record_is_not_asked_about(emps_path: Path) -> None:
    file = load(EXAMPLES / "emps" / "joint.toml")
    assert ask_about_gains(file.controller, file.record(emps_path).reference) is None
