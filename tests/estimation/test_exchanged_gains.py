"""The question whether position gain and velocity gain are exchanged."""

from __future__ import annotations

import pytest

from jointid.estimation.result.build_result import ask_of_gains
from jointid.models.controllers import PD, Cascade
from jointid.models.joints import FlexibleJoint, RigidJoint

RIGID = {"inertia": 5e-4}


def test_gains_that_are_exchanged_are_asked_about() -> None:
    wrong = Cascade(position_gain=0.8, velocity_gain=16.7, gain=0.72)
    (question,) = ask_of_gains(wrong, RigidJoint("revolute"), RIGID, 2.5e-4)
    assert question == (
        "a velocity loop of 2.4e+04 rad/s beside a position gain of 0.8 1/s, sampled every 0.00025 s; exchanged, they "
        "were 1.15e+03 rad/s and 16.7 1/s, as loops are: are position_gain and velocity_gain exchanged? (Kv of a drive "
        "is position_gain, Kp of its speed loop velocity_gain.)"
    )
    flexible = {"motor_inertia": 3e-4, "load_inertia": 2e-4}
    assert ask_of_gains(wrong, FlexibleJoint("revolute"), flexible, 2.5e-4) == (question,)


@pytest.mark.parametrize(
    "controller",
    [
        Cascade(position_gain=16.7, velocity_gain=0.8, gain=0.72),
        Cascade(position_gain=1e6, velocity_gain=0.8, gain=0.72),  # wrong, and no better exchanged
        PD(position_gain=0.8, derivative_gain=16.7),
    ],
)
def test_gains_that_can_be_are_not_asked_about(controller: Cascade | PD) -> None:
    assert ask_of_gains(controller, RigidJoint("revolute"), RIGID, 2.5e-4) == ()


def test_the_gains_of_the_benchmark_are_as_loops_are() -> None:
    emps = Cascade(position_gain=160.18, velocity_gain=243.45, gain=35.15)
    assert ask_of_gains(emps, RigidJoint("prismatic"), {"inertia": 95.0}, 1e-3) == ()
