"""The derivatives of loops under named laws by the numbers the laws are made of, against central differences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.models.controllers import PID, Cascade, FirstOrder, Notch, SecondOrder, number
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.closed_loop import Initial, Outcome
from jointid.simulation.excitation import trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.simulation.differences import error_beside_differences

COMMAND, LOG = 2e-3, 1e-3
REFERENCE = trapezoids((0.05, 0.1), 1.0, 0.05, COMMAND, rest=0.1)[:300]
RIGID = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
FLEXIBLE = {
    "motor_inertia": 70.2, "motor_viscous": 92.0, "motor_coulomb": 10.0, "stiffness": 8e5, "damping": 126.0,
    "load_inertia": 34.8, "load_viscous": 110.0, "load_coulomb": 10.4, "offset": -3.16,
}  # fmt: skip
BASE = Cascade(
    position_gain=60.0, velocity_gain=6e3, integral_gain=30.0, velocity_feedforward=0.9,
    velocity_filter=FirstOrder(0.6e-3),
    torque_filters=(SecondOrder(250.0), Notch(80.0, 20.0, 0.1)), period=250e-6, position_period=1e-3,
    position_offset=0.5e-3, delay=0.35e-3, interpolation="cubic", acceleration_feedforward=60.0,
    viscous_feedforward=90.0, coulomb_feedforward=10.0, reference_delay=0.6e-3,
)  # fmt: skip
NUMBERS = (
    "position_gain", "velocity_gain", "integral_gain", "gain", "delay", "velocity_feedforward",
    "reference_delay", "acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward",
    "velocity_filter.time_constant", "torque_filters.0.frequency",
    "torque_filters.0.damping", "torque_filters.1.frequency", "torque_filters.1.bandwidth", "torque_filters.1.depth",
    "initial_torque", "initial_position", "initial_velocity",
)  # fmt: skip
LIMITS = (
    "limit",
    "velocity_limit",
    "position_gain",
    "velocity_gain",
    "integral_gain",
    "gain",
    "torque_filters.1.frequency",
    "initial_torque",
)


def driven() -> Record:
    samples = round(REFERENCE.size * COMMAND / LOG)
    torque = Channel(np.zeros(samples), "N", LOG, Timing.HELD)
    return Record(torque=torque, reference=Channel(REFERENCE, "m", COMMAND))


SIZES = {"constant_feedforward": 10.0, "initial_torque": 10.0, "initial_position": 0.01, "initial_velocity": 0.05}


def check(law: Any, joint: Joint, names: tuple[str, ...]) -> tuple[float, np.ndarray]:
    """Assert that the derivatives are the differences; return how often the law is limited, and the former."""
    values = RIGID if joint.model == "rigid" else FLEXIBLE
    loop, start = ClosedLoop(joint, law), Initial(1e-4, 0.005, 15.0)
    wanted = (*values, *names)[:40]
    found = simulate_sensitivities(loop, prepare(loop, driven()), values, wanted, start)
    assert found.response.outcome is Outcome.FINISHED
    for j, name in enumerate(wanted):
        size = SIZES.get(name) or values.get(name) or number(law, name)
        steps = tuple(share * size for share in (1e-6, 1e-5, 1e-4))
        error = error_beside_differences((found.torque[:, j],), loop, driven(), values, name, steps, start)
        assert error < (1e-3 if name == "damping" else 2e-4), name
    return found.response.at_limit, found.torque


@pytest.mark.parametrize(
    "joint",
    [RigidJoint("prismatic"), pytest.param(FlexibleJoint("prismatic"), marks=pytest.mark.slow)],
    ids=["rigid", "flexible"],
)
def test_every_number_of_a_cascade_at_two_rates(joint: Joint) -> None:
    check(BASE, joint, NUMBERS)
    # An integral that begins with a given torque makes good what is constant.
    check(replace(BASE, integral_gain=0.0), joint, ("position_gain", "constant_feedforward"))


@pytest.mark.parametrize(
    "windup", ["hold", pytest.param("track", marks=pytest.mark.slow), pytest.param("none", marks=pytest.mark.slow)]
)
def test_limits_that_act(windup: Any) -> None:
    law = replace(BASE, limit=70.0, velocity_limit=0.07, anti_windup=windup)
    if windup == "track":  # what is tracked must not lag, or it swings
        law = replace(law, torque_filters=(Notch(80.0, 20.0, 0.9),))
    names = tuple(name.replace("filters.1", f"filters.{len(law.torque_filters) - 1}") for name in LIMITS)
    limited, slopes = check(law, FlexibleJoint("prismatic"), names)
    assert 0.03 < limited < 0.9
    assert np.any(slopes[:, 9] != 0.0)
    assert np.any(slopes[:, 10] != 0.0)


@pytest.mark.parametrize("windup", ["hold", "track"])
def test_a_pid_at_its_limit(windup: Any) -> None:
    law = PID(
        position_gain=3e5,
        derivative_gain=6e3,
        integral_gain=3e6,
        anti_windup=windup,
        limit=70.0,
        velocity_filter=FirstOrder(0.6e-3),
        period=250e-6,
    )
    names = (
        "position_gain",
        "derivative_gain",
        "integral_gain",
        "limit",
        "gain",
        "velocity_filter.time_constant",
        "initial_torque",
    )
    limited, _ = check(law, RigidJoint("prismatic"), names)
    assert 0.01 < limited < 0.9


def test_what_is_0_has_a_slope_all_the_same() -> None:
    """Of a delay that towards longer ones."""
    law = Cascade(
        position_gain=60.0,
        velocity_gain=6e3,
        integral_gain=30.0,
        velocity_feedforward=0.5,
        period=250e-6,
        torque_filters=(Notch(80.0, 20.0),),
    )
    loop, start = ClosedLoop(RigidJoint("prismatic"), law), Initial(1e-4, 0.005)
    names = ("acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward", "constant_feedforward",
             "reference_delay", "torque_filters.0.depth")  # fmt: skip
    found = simulate_sensitivities(loop, prepare(loop, driven()), RIGID, names, start)
    for j, name in enumerate(names):
        steps = (1e-9, 1e-8, 1e-7) if name.endswith("delay") else (1e-5, 1e-3, 1e-1)
        own, record = (found.torque[:, j],), driven()
        assert error_beside_differences(own, loop, record, RIGID, name, steps, start, back=0.0) < 3e-4, name
