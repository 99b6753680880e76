"""The sampled loop and its margins, against eigenvalues, python-control and responses of few points."""

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from jointid.models.controllers import Cascade, Notch, SampledLaw
from jointid.models.controllers.sampled import POSITION, scale
from jointid.models.friction import Friction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.linear import LinearJoints, SampledDrive, discretise, linear_joints
from jointid.paper.twin import CONTROLLERS, TABLE_2
from jointid.tuning.margins import NAMES, Margins, all_margins, joint_set, spectral_radius
from studies.margins import random_drive

PERIOD = 1e-3


def sample_joints(joints: LinearJoints, law: SampledLaw) -> SampledDrive:
    return discretise(joints.A, joints.B, law.period, law.delay)


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


@pytest.mark.filterwarnings("ignore:stability_margins. Falling back")
def test_margins_are_those_of_python_control() -> None:
    notched = replace(CONTROLLERS["L19"], integral_gain=20.0, torque_filters=(Notch(31.0, 15.0, 0.2),))
    law = notched.law(PERIOD)
    joint, values = FlexibleJoint("prismatic"), dict(TABLE_2)
    found = Margins(*joint_set(joint, [values], law).margins(law)[0])
    linear, (feedback, _) = linear_joints(joint, [values]), law.split()
    plant = control.ss(linear.A[0], linear.B[0][:, np.newaxis], np.eye(len(linear.A[0]))[:1], 0)
    chosen = feedback.B[0][:, [POSITION]], feedback.C[0][[law.output]], feedback.D[0][[law.output]][:, [POSITION]]
    loop = -control.ss(feedback.A[0], *chosen, PERIOD) * control.sample_system(plant, PERIOD, "zoh")
    gains, phases, distances, _, rates, _ = control.stability_margins(loop, returnall=True)
    assert found.gain == pytest.approx(min(gains[gains > 1]), rel=3e-3)
    assert math.degrees(found.phase) == pytest.approx(min(abs(phases)), rel=3e-3)
    assert found.modulus == pytest.approx(min(distances), rel=3e-3)
    assert found.delay == pytest.approx(min(np.radians(phases % 360) / rates), rel=3e-3)


def test_a_loop_that_is_not_stable_has_no_margins() -> None:
    law = scale(CONTROLLERS["L19"].law(PERIOD), 20.0)
    found = Margins(*joint_set(FlexibleJoint("prismatic"), [dict(TABLE_2)], law).margins(law)[0])
    assert not found.stable
    assert tuple(getattr(found, name) for name in NAMES) == (0.0,) * 5


def test_of_two_rates_stability_is_exact_and_margins_are_near() -> None:
    law = replace(CONTROLLERS["L19"], integral_gain=40.0, period=125e-6, position_period=1e-3).law(PERIOD)
    assert law.phases == 8
    linear = linear_joints(FlexibleJoint("prismatic"), [dict(TABLE_2)])
    gain = Margins(*joint_set(FlexibleJoint("prismatic"), [dict(TABLE_2)], law).margins(law)[0]).gain
    sampled = sample_joints(linear, law)
    assert spectral_radius(scale(law, 0.9 * gain), sampled)[0] < 1 < spectral_radius(scale(law, 1.1 * gain), sampled)[0]


def test_friction_that_differs_with_the_direction_is_taken_both_ways() -> None:
    ways = {"viscous_forwards": 50.0, "viscous_backwards": 4000.0, "coulomb_forwards": 20.0, "coulomb_backwards": 20.0}
    joint = RigidJoint("prismatic", friction=Friction("asymmetric"))
    law = Cascade(position_gain=50.0, velocity_gain=2e4).law(PERIOD)
    both = joint_set(joint, [{"inertia": 100.0, "offset": 0.0} | ways], law).margins(law)
    alone = [{"inertia": 100.0, "viscous": viscous, "coulomb": 0.0, "offset": 0.0} for viscous in (50.0, 4000.0)]
    each = [joint_set(RigidJoint("prismatic"), [values], law) for values in alone]
    np.testing.assert_allclose(both[0], np.min([one.margins(law)[0] for one in each], axis=0), rtol=3e-3)


def test_a_crossing_above_minus_one_bears_nearly_a_turn_of_delay_and_one_outside_bounds_the_reduction() -> None:
    late = np.exp(1j * np.radians(170.0))
    hertz = np.array([1.0, 2.0, 3.0])
    _, _, phase, delay, _ = all_margins(np.array([[2.0 * late, 0.5 * late, 0.1 + 0j]]), hertz)[0]
    assert phase == pytest.approx(np.radians(10.0))
    assert delay == pytest.approx(np.radians(350.0) / (2 * np.pi * 1.5))
    gain, reduction, *_, modulus = all_margins(np.array([[-1.5 + 0.1j, -1.5 - 0.1j, -0.25 + 0j]]), hertz)[0]
    assert (gain, reduction) == pytest.approx((4.0, 1.5))
    assert modulus == pytest.approx(0.075 / math.hypot(1.25, 0.1))  # from -1 to the line of the last two points
