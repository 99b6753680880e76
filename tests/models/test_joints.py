"""Joints: regressor times parameters is the torque, units follow the kind, the numbers of the paper follow."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.models.friction import AsymmetricFriction, SymmetricFriction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.position_forces import Motion
from jointid.paper.twin import TABLE_2, TABLE_4


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
