"""Joints: regressor times parameters is the torque, units follow the kind, the numbers of the paper follow."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity, adjust_parameters
from jointid.models.controllers import Cascade
from jointid.models.friction import AsymmetricFriction, SymmetricFriction, find_friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.position_forces import Motion
from jointid.paper.twin import TABLE_2, TABLE_4
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record


@pytest.mark.parametrize("friction", [SymmetricFriction(), AsymmetricFriction()])
def test_regressor_times_parameters_is_the_inverse_dynamics(friction: SymmetricFriction) -> None:
    random = np.random.default_rng(1)
    joint = RigidJoint("prismatic", friction=friction)
    velocity, acceleration = random.normal(size=(2, 200))
    velocity[:20] = 0.0
    values = {p.name: random.uniform(0.5, 2.0) for p in joint.parameters}
    fv, fv_back, fc, fc_back = joint.friction.directions(values, "")
    force = np.where(velocity > 0, fv * velocity + fc, np.where(velocity < 0, fv_back * velocity - fc_back, 0.0))
    expected = values["inertia"] * acceleration + force + values["offset"]
    motion = Motion(np.zeros(200), velocity, acceleration)
    found = joint.regressor(motion)[0] @ np.array(list(values.values()))
    assert np.allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_what_the_simulation_balances_is_the_model() -> None:
    """The torque of a simulated flexible joint at the motor equals (2) of the paper on its own states."""
    joint = FlexibleJoint("prismatic")
    loop = ClosedLoop(
        joint, Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15)
    )
    reference = trapezoids((0.1,), 0.8, 0.05, 1e-4)
    made = simulated_record(loop, reference, TABLE_2, sample_time=1e-4)
    assert made.motor_position is not None
    assert made.load_position is not None
    q1, q12 = made.motor_position.values, made.load_position.values
    v12, a12 = np.gradient(q12, 1e-4), np.gradient(np.gradient(q12, 1e-4), 1e-4)
    steady = slice(400, 1200)
    spring = TABLE_2["stiffness"] * (q12 - q1) + TABLE_2["damping"] * np.gradient(q12 - q1, 1e-4)
    zero = TABLE_2["load_inertia"] * a12 + TABLE_2["load_viscous"] * v12 + TABLE_2["load_coulomb"] * np.sign(v12)
    assert np.max(np.abs(zero + spring)[steady]) < 0.02 * np.max(np.abs(spring))


def test_units_follow_the_kind_and_the_torque() -> None:
    def units(joint: FlexibleJoint) -> dict[str, str]:
        return {p.symbol: joint.unit(p) for p in joint.parameters}

    prismatic, revolute = units(FlexibleJoint("prismatic")), units(FlexibleJoint("revolute"))
    assert prismatic["ZZ1"] == "kg"
    assert prismatic["K12"] == "N/m"
    assert prismatic["Fv2"] == "N s/m"
    assert revolute["ZZ2"] == "kg m2"
    assert revolute["K12"] == "N m/rad"
    assert revolute["F12"] == "N m s/rad"
    assert units(FlexibleJoint("revolute", torque_unit="A"))["K12"] == "A/rad"
    assert units(FlexibleJoint("prismatic", torque_unit="V"))["ZZ1"] == "V s2/m"


def test_the_three_frequencies_of_the_tables() -> None:
    """Recomputed from print; the paper floors 29.51 and 27.53 to 29.0 and 27.0."""
    assert {k: round(v, 2) for k, v in FlexibleJoint.frequencies(TABLE_2).items()} == {
        "free_free": 29.51, "motor_locked": 24.13, "load_locked": 16.99,
    }  # fmt: skip
    assert {k: round(v, 2) for k, v in FlexibleJoint.frequencies(TABLE_4).items()} == {
        "free_free": 27.53, "motor_locked": 21.48, "load_locked": 17.21,
    }  # fmt: skip


def test_the_sums_of_the_tables() -> None:
    assert FlexibleJoint.rigid_sums(TABLE_2) == pytest.approx(
        {"inertia": 105.0, "viscous": 202.0, "coulomb": 20.4, "offset": -3.16}
    )
    assert FlexibleJoint.rigid_sums(TABLE_4) == pytest.approx(
        {"inertia": 115.1, "viscous": 205.0, "coulomb": 20.0, "offset": -3.16}
    )


def test_the_offset_is_fixed_beside_asymmetric_friction() -> None:
    offset = RigidJoint("prismatic", friction=AsymmetricFriction()).parameters[-1]
    assert (offset.name, offset.free, offset.start) == ("offset", False, 0.0)


def test_a_friction_that_is_not_known_is_refused() -> None:
    with pytest.raises(MethodError, match=r'Friction "dahl" is not known; use symmetric, asymmetric, .*, presliding'):
        find_friction("dahl")


def test_adjusting_a_parameter_that_is_not_there_lists_those_that_are() -> None:
    with pytest.raises(MethodError, match="No parameter is called stiffness; this model has inertia, viscous"):
        adjust_parameters(
            RigidJoint("prismatic").parameters, {"stiffness": Parameter("stiffness", "K12", Quantity.STIFFNESS)}
        )
