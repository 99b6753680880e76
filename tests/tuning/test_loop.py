"""The sampled loop and its margins, against python-control, against eigenvalues, and against finer sampling."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.models.controllers import PID, POSITION, Cascade, Controller, FirstOrder, Notch, SampledLaw, scale
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.linear import (
    LinearJoints,
    SampledDrive,
    discretise,
    linear_joints,
)
from jointid.paper.twin import CONTROLLERS, TABLE_2
from jointid.tuning.margins import NAMES, Margins, all_margins, joint_set, spectral_radius
from studies.margins import random_drive

SERVO = Cascade(
    position_gain=80.0,
    velocity_gain=8557.0,
    integral_gain=40.0,
    velocity_filter=FirstOrder(0.5e-3),
    velocity_feedforward=1.0,
    acceleration_feedforward=60.0,
    torque_filters=(Notch(180.0, 60.0, 0.1),),
    limit=1000.0,
    period=125e-6,
    position_period=1e-3,
    delay=125e-6,
    interpolation="linear",
)
"""A servo drive of today, whose velocity loop runs every 125 us."""

PERIOD = 1e-3
RIGID = {"inertia": 105.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}


def sample_joints(joints: LinearJoints, law: SampledLaw) -> SampledDrive:
    return discretise(joints.A, joints.B, law.period, law.delay)


def other(joint: FlexibleJoint | RigidJoint, values: dict[str, float], law: SampledLaw) -> Any:
    """The loop cut open as python-control has it; the law has no delay."""
    import control

    linear = linear_joints(joint, [values])
    outputs = np.eye(linear.B.shape[1])[:1]
    plant = control.sample_system(control.ss(linear.A[0], linear.B[0][:, np.newaxis], outputs, 0), law.period, "zoh")
    feedback, _ = law.split()
    out = law.output
    made = control.ss(
        feedback.A[0],
        feedback.B[0][:, [POSITION]],
        feedback.C[0][[out]],
        feedback.D[0][[out]][:, [POSITION]],
        law.period,
    )
    return -made * plant


LAWS: list[tuple[str, Controller]] = [
    ("the paper's", CONTROLLERS["L19"]),
    (
        "P-PI",
        replace(
            CONTROLLERS["L19"],
            integral_gain=20.0,
            velocity_filter=FirstOrder(1e-3),
            torque_filters=(Notch(31.0, 15.0, 0.2),),
        ),
    ),
    ("PID", PID(position_gain=8e5, derivative_gain=1.2e4, integral_gain=1e6)),
]


@pytest.mark.filterwarnings("ignore:stability_margins. Falling back")  # to a response, of polynomials of high order
@pytest.mark.parametrize(
    ("joint", "values"), [(FlexibleJoint("prismatic"), dict(TABLE_2)), (RigidJoint("prismatic"), RIGID)]
)
@pytest.mark.parametrize(("name", "controller"), LAWS)
def test_margins_are_those_of_python_control(
    joint: FlexibleJoint | RigidJoint, values: dict[str, float], name: str, controller: Controller
) -> None:
    import control

    law = controller.law(PERIOD)
    found = Margins(*joint_set(joint, [values], law).margins(law)[0])
    loop = other(joint, values, law)
    gains, phases, distance, _, rates, _ = control.stability_margins(loop, returnall=True)
    assert found.gain == pytest.approx(min(g for g in gains if g > 1), rel=3e-3), name
    assert math.degrees(found.phase) == pytest.approx(min(map(abs, phases)), rel=3e-3)
    assert found.modulus == pytest.approx(min(distance), rel=3e-3)
    delays = [math.radians(phase % 360) / rate for phase, rate in zip(phases, rates, strict=True)]
    assert found.delay == pytest.approx(min(delays), rel=3e-3)


@pytest.mark.parametrize("seed", range(12))
def test_a_loop_becomes_unstable_where_its_margins_say(seed: int) -> None:
    drive = random_drive(seed)
    controller = drive.loop.controller
    law = controller.law(drive.period)
    linear = linear_joints(drive.loop.joint, [drive.truth])
    margins = Margins(*joint_set(drive.loop.joint, [drive.truth], law).margins(law)[0])

    def stable(law: SampledLaw) -> bool:
        return bool(spectral_radius(law, sample_joints(linear, law))[0] < 1)

    assert stable(law)
    assert stable(scale(law, 0.99 * margins.gain))
    assert not stable(scale(law, 1.01 * margins.gain))
    if margins.reduction < math.inf:
        assert stable(scale(law, 1.01 / margins.reduction))
        assert not stable(scale(law, 0.99 / margins.reduction))
    assert stable(replace(law, delay=law.delay + 0.96 * margins.delay))
    assert not stable(replace(law, delay=law.delay + 1.04 * margins.delay))


def test_a_loop_that_is_not_stable_has_no_margins() -> None:
    law = scale(CONTROLLERS["L19"].law(PERIOD), 20.0)
    found = Margins(*joint_set(FlexibleJoint("prismatic"), [dict(TABLE_2)], law).margins(law)[0])
    assert not found.stable
    assert tuple(getattr(found, name) for name in NAMES) == (0.0,) * 5


def test_of_two_rates_stability_is_exact_and_margins_are_near() -> None:
    law = SERVO.law(PERIOD)
    assert law.phases == 8
    linear = linear_joints(FlexibleJoint("prismatic"), [dict(TABLE_2)])
    gain = Margins(*joint_set(FlexibleJoint("prismatic"), [dict(TABLE_2)], law).margins(law)[0]).gain
    sampled = sample_joints(linear, law)
    assert spectral_radius(scale(law, 0.9 * gain), sampled)[0] < 1 < spectral_radius(scale(law, 1.1 * gain), sampled)[0]


def test_friction_that_differs_with_the_direction_is_taken_both_ways() -> None:
    ways = {"viscous_forwards": 50.0, "viscous_backwards": 4000.0, "coulomb_forwards": 20.0, "coulomb_backwards": 20.0}
    joint = RigidJoint("prismatic", friction=AsymmetricFriction())
    law = Cascade(position_gain=50.0, velocity_gain=2e4).law(PERIOD)
    both = joint_set(joint, [{"inertia": 100.0, "offset": 0.0} | ways], law).margins(law)
    each = [
        joint_set(
            RigidJoint("prismatic"),
            [{"inertia": 100.0, "viscous": ways[f"viscous_{way}"], "coulomb": 0.0, "offset": 0.0}],
            law,
        )
        for way in ("forwards", "backwards")
    ]
    np.testing.assert_allclose(both[0], np.min([one.margins(law)[0] for one in each], axis=0), rtol=3e-3)


def test_a_crossing_above_minus_one_bears_nearly_a_turn_of_delay_and_one_outside_bounds_the_reduction() -> None:
    late = np.exp(1j * np.radians(170.0))
    hertz = np.array([1.0, 2.0, 3.0])
    _, _, phase, delay, _ = all_margins(np.array([[2.0 * late, 0.5 * late, 0.1 + 0j]]), hertz)[0]
    assert phase == pytest.approx(np.radians(10.0))
    assert delay == pytest.approx(np.radians(350.0) / (2 * np.pi * 1.5))
    gain, reduction, *_ = all_margins(np.array([[-1.5 + 0.1j, -1.5 - 0.1j, -0.25 + 0j]]), hertz)[0]
    assert (gain, reduction) == pytest.approx((4.0, 1.5))
