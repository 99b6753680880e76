"""Units and factors of the other side of a transmission; in ampere as in newton metres."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.common.transmission import OtherSide, Transmission
from jointid.models.disturbances import Drift, effect_parameters
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.position_forces import PositionHarmonics
from jointid.records.record import Channel, Timing, refer_channel
from tests.geared import TURNED_SCREW

R = abs(TURNED_SCREW.motor_per_load)


@pytest.mark.parametrize(
    ("torque_unit", "units"),
    [
        (None, {"stiffness": "N m/rad", "motor_inertia": "kg m2", "offset": "N m", "motor_viscous": "N m s/rad"}),
        ("A", {"stiffness": "A/rad", "motor_inertia": "A s2/rad", "offset": "A", "motor_viscous": "A s/rad"}),
    ],
)
def test_each_quantity_has_its_unit_and_its_power_of_the_ratio(torque_unit: str | None, units: dict[str, str]) -> None:
    joint = FlexibleJoint("prismatic", torque_unit=torque_unit, transmission=TURNED_SCREW)
    there = OtherSide(TURNED_SCREW, torque_unit or "N")
    factors = {"stiffness": R**-2, "motor_inertia": R**-2, "offset": -1 / R, "motor_viscous": R**-2}
    for p in joint.parameters:
        if p.name in units:
            assert there.unit(joint.unit(p)) == units[p.name]
            assert there.factor(p.name, joint.unit(p)) == pytest.approx(factors[p.name])
    assert there.factor("load_coulomb", torque_unit or "N") == pytest.approx(1 / R)
    assert (there.factor("initial_position", "m"), there.unit("m")) == (pytest.approx(-R), "rad")
    assert (there.factor("period", "m"), there.unit("m/s")) == (pytest.approx(R), "rad/s")
    assert (there.factor("log_delay", "s"), there.factor("velocity_gain", "as declared"), there.unit("s")) == (
        1.0,
        1.0,
        "s",
    )


def test_both_ways_lead_back() -> None:
    """Over every parameter that a joint and its effects have, whatever the direction."""
    back = Transmission(load="prismatic", lead=0.010, sign=-1, side="motor")
    effects = (PositionHarmonics(0.01, 2), Drift("both"))
    for joint in (RigidJoint("prismatic", AsymmetricFriction()), FlexibleJoint("prismatic", AsymmetricFriction())):
        here, there = OtherSide(TURNED_SCREW, "N"), OtherSide(back, "N m")
        for p in (*joint.parameters, *effect_parameters(effects)):
            unit, name = joint.unit(p), here.name(p.name)
            assert here.factor(p.name, unit) * there.factor(p.name, here.unit(unit)) == pytest.approx(1.0), p.name
            assert there.unit(here.unit(unit)) == unit
            assert there.name(name) == p.name
            assert (name != p.name) == p.name.endswith(("forwards", "backwards"))


def test_a_current_stays_a_current() -> None:
    logged = Channel(np.array([1.0, -2.0]), "A", 1e-3, Timing.AVERAGED, "run.csv: i_q")
    seen = refer_channel(TURNED_SCREW, "torque", logged, "motor")
    np.testing.assert_allclose(seen.values, -R * logged.values)
    assert (seen.unit, seen.timing, seen.source) == ("A", Timing.AVERAGED, "run.csv: i_q")
    speed = refer_channel(TURNED_SCREW, "reference_velocity", Channel(np.array([R]), "rad/s", 1e-3), "motor")
    assert (speed.values[0], speed.unit) == (pytest.approx(-1.0), "m/s")
