"""Units of a joint, and units and factors of the other side of its transmission; in ampere as in newton metres."""

import pytest

from jointid.common.transmission import Transmission
from jointid.models.friction import Friction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.position_forces import PositionHarmonics
from jointid.output.export.joint_model import cross
from tests.geared import TURNED_SCREW

R = abs(TURNED_SCREW.motor_per_load)


def test_units_follow_the_kind_and_the_torque() -> None:
    def units(joint: FlexibleJoint) -> dict[str, str]:
        return {p.symbol: joint.unit(p) for p in joint.parameters}

    prismatic, revolute = units(FlexibleJoint("prismatic")), units(FlexibleJoint("revolute"))
    assert [prismatic[symbol] for symbol in ("ZZ1", "K12", "Fv2")] == ["kg", "N/m", "N s/m"]
    assert [revolute[symbol] for symbol in ("ZZ2", "K12", "F12")] == ["kg m2", "N m/rad", "N m s/rad"]
    assert units(FlexibleJoint("revolute", torque_unit="A"))["K12"] == "A/rad"
    assert units(FlexibleJoint("prismatic", torque_unit="V"))["ZZ1"] == "V s2/m"


@pytest.mark.parametrize(
    ("torque_unit", "units"),
    [
        (None, {"stiffness": "N m/rad", "motor_inertia": "kg m2", "offset": "N m", "motor_viscous": "N m s/rad"}),
        ("A", {"stiffness": "A/rad", "motor_inertia": "A s2/rad", "offset": "A", "motor_viscous": "A s/rad"}),
    ],
)
def test_each_quantity_has_its_unit_and_its_power_of_the_ratio(torque_unit: str | None, units: dict[str, str]) -> None:
    joint = FlexibleJoint("prismatic", torque_unit=torque_unit, transmission=TURNED_SCREW)
    unit = torque_unit or "N"
    factors = {"stiffness": R**-2, "motor_inertia": R**-2, "offset": -1 / R, "motor_viscous": R**-2}
    for p in joint.parameters:
        if p.name in units:
            crossed = cross(TURNED_SCREW, p.name, joint.unit(p), unit)
            assert crossed == (p.name, units[p.name], pytest.approx(factors[p.name]))
    for name, here, there, factor in (
        ("load_coulomb", unit, torque_unit or "N m", 1 / R), ("initial_position", "m", "rad", -R),
        ("period", "m", "rad", R), ("log_delay", "s", "s", 1.0), ("velocity_gain", "as declared", "as declared", 1.0),
    ):  # fmt: skip
        assert cross(TURNED_SCREW, name, here, unit) == (name, there, pytest.approx(factor))


def test_both_ways_lead_back() -> None:
    """Over every parameter that a joint has, whatever the direction."""
    back = Transmission(load="prismatic", lead=0.010, sign=-1, side="motor")
    ripple = PositionHarmonics(0.01, 2)
    for joint in (RigidJoint("prismatic", Friction("asymmetric")), FlexibleJoint("prismatic", Friction("asymmetric"))):
        for p in (*joint.parameters, *ripple.parameters):
            name, unit, factor = cross(TURNED_SCREW, p.name, joint.unit(p), "N")
            assert cross(back, name, unit, "N m") == (p.name, joint.unit(p), pytest.approx(1 / factor))
            assert (name != p.name) == p.name.endswith(("forwards", "backwards"))
