"""Every law of friction, springs and gravity in its loop: derivatives against differences, equations, starts."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.records.record import Channel, Record
from jointid.simulation.drive_side import PARTS, DriveSideRun, prescribe, run_drive_side
from jointid.simulation.excitation import trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate
from tests.plants import prismatic, rotary
from tests.simulation.differences import drive_side_slopes, error_beside_differences, sensitivities

LINK = Gravity("link", Counterbalance(cos=4.0, rate=1.0))
VALUES = {
    "motor_inertia": 2.0, "motor_viscous": 2.0, "motor_coulomb": 2.0, "stiffness": 5e3, "damping": 5.0,
    "load_inertia": 3.0, "load_viscous": 2.0, "load_coulomb": 2.0, "offset": 0.5, "gravity_cos": 40.0,
    "gravity_sin": 15.0, "counterbalance_cos": 4.0, "counterbalance_rate": 1.0,
}  # fmt: skip
SUMS = {"inertia": 5.0, "viscous": 4.0, "coulomb": 4.0} | {n: VALUES[n] for n in list(VALUES)[8:]}
HANGING = [(RigidJoint("revolute", gravity=LINK), SUMS), (FlexibleJoint("revolute", gravity=LINK), VALUES)]


def swing(joint: Joint, delay: float = 0.0) -> tuple[ClosedLoop, Record]:
    """Return a loop of a link, and its record."""
    case = rotary(1)
    reference = 0.3 + trapezoids((2.0,), 8.0, 0.6, 1e-3, rest=0.2, duration=2.4)
    law = type(case.loop.controller)(position_gain=10.0, velocity_gain=80.0, delay=delay)  # type: ignore[call-arg]
    return ClosedLoop(joint, law), Record(reference=Channel(reference, "rad", 1e-3))


@pytest.mark.parametrize(("joint", "values"), HANGING, ids=["rigid", "flexible"])
def test_the_equation_of_a_link_in_gravity_holds(joint: Joint, values: dict[str, float]) -> None:
    """Torque = regressor times parameters while everything slides; also of a ripple, and along the drive side."""
    loop, record = swing(joint)
    for other in (joint, replace(joint, ripple=PositionHarmonics(0.3, 2))):
        known = values | {p.name: 0.3 for p in other.parameters if p.name.startswith("harmonic")}
        found = simulate(replace(loop, joint=other), prepare(loop, record), known)
        rows = other.regressor(found.motor, found.load) @ np.array([known[p.name] for p in other.parameters])
        sides = [found.motor] if found.load is None else [found.motor, found.load]
        sliding = np.all([np.abs(side.velocity) > 1e-2 for side in sides], axis=0)
        assert np.mean(sliding) > 0.4
        assert np.allclose(rows[0, sliding], found.torque[sliding], rtol=1e-11, atol=1e-9)
        assert np.allclose(rows[1:, sliding], 0.0, atol=1e-9)
    whole = simulate(loop, prepare(loop, record), values)
    names = ("gravity_cos", joint.parameters[0].name)
    motion = prescribe(whole.motor_position[:, np.newaxis], 1e-3, PARTS)

    def along_with(other: dict[str, float]) -> DriveSideRun:
        return run_drive_side(motion, Numbers.of_joint(joint, other))

    prescribed = along_with(values)
    moved = drive_side_slopes(prescribed, [Place(0, name) for name in names])[:, 0]
    along = prescribed.torque.reshape(-1, PARTS).mean(axis=1)
    smooth = np.abs(whole.motor_velocity[:-1]) > 0.05
    assert np.sqrt(np.mean((along - whole.torque[:-1])[smooth] ** 2)) < 0.03 * np.std(whole.torque)
    for j, name in enumerate(names):
        ends = (along_with({**values, name: values[name] * (1 + by)}) for by in (1e-5, -1e-5))
        column = np.subtract(*(end.torque[:, 0] for end in ends)) / (2e-5 * values[name])
        assert np.linalg.norm(moved[:, j] - column) < 1e-4 * np.linalg.norm(column), name


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "values"), HANGING, ids=["rigid", "flexible"])
def test_derivatives_of_a_link_that_begins_off_its_reference(joint: Joint, values: dict[str, float]) -> None:
    """By the delay, too, which moves no edge at the first sample."""
    loop, record = swing(joint, 0.6e-3)
    names, start = [*(p.name for p in joint.parameters), "initial_position", "delay"], Initial(0.32)
    found = sensitivities(loop, prepare(loop, record), values, names, start).torque
    for j, name in enumerate(names):
        size = 4.0 if name == "offset" else abs(values.get(name, 1e-3 if name == "delay" else 1.0))
        steps = tuple(size * np.logspace(-8, -4, 5))
        assert error_beside_differences((found[:, j],), loop, record, values, name, steps, start) < 1e-3, name


def test_a_constant_load_is_an_offset_to_the_torque_and_a_preload_to_the_spring() -> None:
    case = prismatic(1)
    lifted = replace(case.loop.joint, gravity=Gravity("constant"))
    found = []
    for joint, more in ((lifted, {"offset": 0.0, "gravity_constant": 25.0}), (case.loop.joint, {"offset": 25.0})):
        loop = replace(case.loop, joint=joint)
        found.append(simulate(loop, prepare(loop, case.clean), case.truth | more))
    one, other = found
    assert np.allclose(one.torque, other.torque, atol=1e-6)
    assert one.load_position is not None and other.load_position is not None
    assert np.allclose(one.load_position, other.load_position - 25.0 / case.truth["stiffness"], atol=1e-11)
