"""Friction that is another towards standstill, and smooth laws of springs and friction, from torque and reference."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.diagnostics.validation import validate
from jointid.models.friction import FRICTIONS, Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.simulation.loop_input import prepare
from jointid.simulation.synthesis import simulate
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER
from tests.plants import FALLS, LAWS, RISES, Case, prismatic, rigid, slow, with_law

EMPS_RESIDUAL = {"symmetric": (4.48, 5.41), "stribeck": (3.79, 4.93), "asymmetric-stribeck": (2.72, 4.13)}


def noisy(case: Case, loop: ClosedLoop, values: dict[str, float], share: float = 0.01) -> Record:
    """The record of the drive with that friction, from torque and reference alone."""
    torque = simulate(loop, prepare(loop, case.clean), values).torque
    seen = torque + share * np.std(torque) * np.random.default_rng(3).standard_normal(torque.size)
    record = replace(case.clean, torque=replace(case.clean.torque, values=seen))
    return record.without("motor_position", "load_position")


@pytest.mark.parametrize("shares", [RISES, FALLS])
@pytest.mark.parametrize("is_rigid", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_friction_towards_standstill_is_told_of_both_sides(shares: dict[str, float], is_rigid: bool) -> None:
    case = rigid(prismatic(1)) if is_rigid else prismatic(1)
    case = replace(case, clean=cut(case.clean, 0, 12_000)) if is_rigid else case
    loop, values = slow(case, shares)
    estimate = identify(noisy(case, loop, values), loop)
    for row in (one for one in estimate.rows if one.name in values):
        assert abs(row.value - values[row.name]) < 3.5 * row.stderr, row.name
        assert not is_rigid or row.stderr < 0.05 * abs(values[row.name]), row.name
    assert is_rigid or estimate["stiffness"].stderr < 1e-3 * values["stiffness"]  # type: ignore[operator]


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_flexible_joint_tells_its_smooth_law(law: str) -> None:
    case = prismatic(1)
    loop, values = with_law(case, law)
    found = identify(noisy(case, loop, values), loop)
    assert abs(found["stiffness"].value - values["stiffness"]) < 3 * found["stiffness"].stderr
    for p in found.rows:
        if p.of_joint and p.value is not None and p.stderr:
            assert abs(p.value - values[p.name]) < 4.5 * p.stderr, p.name


@pytest.mark.parametrize("friction", list(EMPS_RESIDUAL))
def test_the_real_axis_has_less_friction_towards_standstill(friction: str, emps: Record, emps_pulses: Record) -> None:
    """The 7.7 N that the check of the loop finds near standstill are a law, which holds on the other record, too."""
    loop = ClosedLoop(RigidJoint("prismatic", friction=FRICTIONS[friction]), CONTROLLER)
    estimate = identify(emps.without("motor_position"), loop)
    fitted, kept = EMPS_RESIDUAL[friction]
    assert round(100 * estimate.fit.filtered_error, 2) == pytest.approx(fitted, abs=0.02)
    assert round(100 * validate(estimate, emps_pulses).filtered_error, 2) == pytest.approx(kept, abs=0.02)
    if friction != "symmetric":
        change = estimate["stribeck_force"]
        assert change.interval[0] < -7.7 < change.interval[1] < 0
        assert estimate["stribeck_speed"].value == pytest.approx(0.015, abs=0.001)


def test_a_change_that_leaves_no_friction_at_rest_is_no_joint() -> None:
    case = rigid(prismatic(1))
    loop, values = slow(case, FALLS)
    found = simulate(loop, prepare(loop, case.clean), values | {"stribeck_force": -1.1 * values["coulomb"]})
    assert found.outcome.name == "INVALID"


def test_the_lines_are_near_the_exponential() -> None:
    values = {"viscous": 0.0, "coulomb": 1.0, "stribeck_force": 1.0, "stribeck_speed": 2.0}
    speeds = np.linspace(1e-9, 8.0, 801)
    found = np.array([Friction("stribeck").drag(values, float(speed), 0.0) for speed in speeds])
    assert np.abs(found - 1.0 - np.exp(-((speeds / 2.0) ** 2))).max() < 0.005
    still, back, forth = (Friction("stribeck").drag(values, v, 0.0) for v in (0.0, -1.0, 1.0))
    assert (still, back) == (0.0, -forth)
