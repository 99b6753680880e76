"""Gains that look swapped are asked about as soon as the reference is known; healthy ones are not."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import JointidError
from jointid.config import load, loads
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.problems.log_windows import Windowing
from jointid.estimation.record_warnings import ask_about_gains
from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.paper.twin import twin
from jointid.records.record import Channel
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
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


def test_a_share_of_the_travel_is_written_as_a_number() -> None:
    """12 % was 1e+01 %."""
    question = ask_about_gains(Cascade(position_gain=0.4, velocity_gain=4.0), moves())
    assert question is not None
    assert re.search(r"in its place it would be 1\d %: are the two swapped", question)


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


def test_the_paper_s_axis_is_not_asked_about() -> None:
    for name in ("L19", "L30"):
        made = twin(name)  # type: ignore[arg-type]
        assert ask_about_gains(made.loop.controller, made.record.reference) is None


def test_the_public_record_is_not_asked_about(emps_path: Path) -> None:
    file = load(EXAMPLES / "emps" / "joint.toml")
    assert ask_about_gains(file.controller, file.record(emps_path).reference) is None


@pytest.mark.slow
def test_the_question_comes_before_the_identification_and_is_kept_as_a_warning() -> None:
    """It is the first thing that is told; where an answer comes all the same, the question stands in it."""
    right = Cascade(position_gain=22.0, velocity_gain=0.8)
    values = {"inertia": 0.01, "viscous": 0.02, "coulomb": 0.05, "offset": 0.0}
    record = simulated_record(ClosedLoop(RigidJoint("revolute"), right), moves().values, values, sample_time=T)
    for windows in (None, Windowing(4.0)):
        asked = list[str]()
        loop = ClosedLoop(RigidJoint("revolute"), Cascade(position_gain=0.8, velocity_gain=22.0))
        found = identify(record, loop, IDIM(), windows=windows, progress=asked.append)
        assert "are the two swapped?" in asked[0] and asked[0] in found.checks.warnings
    record = record.without("motor_position")
    swapped, said = loads(FILE + "position_gain = 0.8\nvelocity_gain = 22.0\n"), list[str]()
    with suppress(JointidError):
        estimate = swapped.identify(record, said.append)
        assert any("swapped" in one for one in estimate.checks.warnings)
    assert "are the two swapped?" in said[0]
    told = list[str]()
    estimate = loads(FILE + "position_gain = 22.0\nvelocity_gain = 0.8\n").identify(record, told.append)
    assert not any("swapped" in one for one in (*told, *estimate.checks.warnings))
