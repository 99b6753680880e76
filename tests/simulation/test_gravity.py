"""Gravity in the simulation: against the event-driven oracle, against physics, and its exact derivatives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.closed_loop import Initial, Outcome, simulate, simulate_torque
from jointid.simulation.excitation import trapezoids
from jointid.simulation.kernels import drive as kernels
from jointid.simulation.loop_input import prepare
from jointid.simulation.prescribed import prescribed_motion, simulate_drive_side
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import rotary
from tests.simulation.differences import error_beside_differences
from tests.simulation.kernel_case import run
from tests.simulation.oracle import Law, Plant
from tests.simulation.oracle import simulate as reference_of

WEIGHT = (40.0, 15.0, -2.0, 1.0)  # cos, sin, rate, angle
RIGID = Plant(inertia1=3.0, fv1=(4.0, 4.0), fc1=(3.0, 3.0), offset=0.5, gravity=WEIGHT)
FLEXIBLE = Plant(
    inertia1=2.0, fv1=(2.0, 2.0), fc1=(2.0, 2.0), offset=0.5, inertia2=3.0, fv2=(2.0, 2.0), fc2=(2.0, 3.0),
    stiffness=5e3, damping=5.0, gravity=WEIGHT,
)  # fmt: skip


def cascade(position_gain: float, velocity_gain: float, period: float) -> Law:
    """The law ``u = kv (kp (reference - q) - (q - q before) / period)`` in the oracle's form."""
    nothing = np.zeros(1)
    return Law(
        np.zeros((1, 1)),
        np.ones(1),
        nothing,
        np.array([velocity_gain / period]),
        -velocity_gain * (position_gain + 1 / period),
        500.0,
        nothing,
    )


def errors(plant: Plant, period: float, delay: float = 0.0) -> tuple[float, int]:
    """Largest error of the torque, of its peak, over 2.4 s of a link that swings by 2 rad; and the events."""
    rigid = plant.inertia2 is None
    position_gain, velocity_gain = (20.0, 150.0) if rigid else (10.0, 80.0)
    reference = trapezoids((1.0, 2.0), 8.0, 2.0, period, rest=0.1, duration=2.4)
    case = (
        cascade(position_gain, velocity_gain, period),
        position_gain * velocity_gain * reference,
        np.zeros(reference.size),
        period,
        delay,
        0.0,
    )
    expected = reference_of(plant, *case, np.zeros(2 if rigid else 4))
    status, u, _, counts = run(plant, *case, np.zeros(2 if rigid else 4))
    assert status == kernels.FINISHED
    return float(np.max(np.abs(u - expected.u)) / np.max(np.abs(expected.u))), int(counts[0])


@pytest.mark.parametrize("plant", [pytest.param(RIGID, marks=pytest.mark.slow), FLEXIBLE], ids=["rigid", "flexible"])
def test_agrees_with_the_oracle_to_second_order(plant: Plant) -> None:
    """Reversals, sticking and gravity as in a continuous drive, but for what holding over a part costs."""
    (coarse, _), (fine, events) = errors(plant, 2e-3), errors(plant, 1e-3)
    assert fine < 3e-7
    assert 3.5 < coarse / fine < 4.5
    assert events >= 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "plant", [pytest.param(RIGID, id="rigid", marks=pytest.mark.slow), pytest.param(FLEXIBLE, id="flexible")]
)
def test_agrees_with_the_oracle_where_a_period_has_two_parts(plant: Plant) -> None:
    assert errors(plant, 1e-3, delay=1.3e-3)[0] < 3e-7


LINK = Gravity("link", Counterbalance(cos=4.0, rate=1.0))
VALUES = {
    "motor_inertia": 2.0, "motor_viscous": 2.0, "motor_coulomb": 2.0, "stiffness": 5e3, "damping": 5.0,
    "load_inertia": 3.0, "load_viscous": 2.0, "load_coulomb": 2.0, "offset": 0.5, "gravity_cos": 40.0,
    "gravity_sin": 15.0, "counterbalance_cos": 4.0, "counterbalance_rate": 1.0,
}  # fmt: skip
SUMS = {"inertia": 5.0, "viscous": 4.0, "coulomb": 4.0} | {n: VALUES[n] for n in list(VALUES)[8:]}
CONTROLLER = Cascade(position_gain=10.0, velocity_gain=80.0, delay=0.6e-3)


def swing(kind: str = "rad", start: float = 0.3) -> Record:
    reference = start + trapezoids((2.0,), 8.0, 0.6, 1e-3, rest=0.2, duration=2.4)
    torque = Channel(np.zeros(reference.size), "N m" if kind == "rad" else "N", 1e-3, Timing.HELD)
    return Record(torque=torque, reference=Channel(reference, kind, 1e-3))


def test_a_load_that_friction_holds_stays_where_it_is_to_the_last_bit() -> None:
    plant = replace(FLEXIBLE, fc1=(80.0, 80.0), fc2=(80.0, 80.0))
    law = Law(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros(0), 0.0, math.inf, np.zeros(0))
    for position in np.random.default_rng(0).uniform(-1e-3, 1e-3, 20):  # less than the spring gives
        x0 = np.array([0.0, 0.0, position, 0.0])
        _, _, states, counts = run(plant, law, np.zeros(500), np.zeros(500), 1e-3, 0.0, 0.0, x0)
        assert counts[0] == 0
        assert np.array_equal(states, np.tile(x0, (500, 1)))


def test_a_load_at_rest_hangs_where_its_spring_carries_it() -> None:
    joint = FlexibleJoint(kind="revolute", gravity=LINK)
    _, _, load, _ = joint.start(VALUES, 0.7, 0.0)
    weight = 36.0 * math.cos(load) + 15.0 * math.sin(load) - 1.0 * load
    assert VALUES["stiffness"] * (0.7 - load) == pytest.approx(weight, rel=1e-13)


@pytest.mark.parametrize("model", ["rigid", "flexible"])
def test_the_equation_holds_where_the_torque_begins_to_act(model: str) -> None:
    """Torque = regressor times parameters, gravity among them, while everything slides."""
    joint, values = (RigidJoint, SUMS) if model == "rigid" else (FlexibleJoint, VALUES)
    loop = ClosedLoop(joint(kind="revolute", gravity=LINK), CONTROLLER)
    found = simulate(loop, prepare(loop, swing()), values)
    rows = loop.joint.regressor(found.motor, found.load) @ np.array([values[p.name] for p in loop.joint.parameters])
    sides = [found.motor] if found.load is None else [found.motor, found.load]
    sliding = np.all([np.abs(side.velocity) > 1e-2 for side in sides], axis=0)
    assert np.mean(sliding) > 0.4
    assert np.allclose(rows[0, sliding], found.torque[sliding], rtol=1e-11, atol=1e-9)
    if model == "flexible":
        assert np.allclose(rows[1, sliding], 0.0, atol=1e-9)


def test_a_constant_load_is_an_offset_to_the_torque_and_a_preload_to_the_spring() -> None:
    lifted = FlexibleJoint("prismatic", gravity=Gravity("constant"))
    plain = {n: v for n, v in VALUES.items() if n in {p.name for p in FlexibleJoint("prismatic").parameters}}
    record, loads = swing("m", 0.0), []
    for joint, values in (
        (lifted, plain | {"offset": 0.0, "gravity_constant": 25.0}),
        (FlexibleJoint("prismatic"), plain | {"offset": 25.0}),
    ):
        loop = ClosedLoop(joint, CONTROLLER)
        loads.append(simulate(loop, prepare(loop, record), values))
    assert np.allclose(loads[0].torque, loads[1].torque, atol=1e-9)
    assert loads[0].load_position is not None
    assert loads[1].load_position is not None
    assert np.allclose(loads[0].load_position, loads[1].load_position - 25.0 / VALUES["stiffness"], atol=1e-12)


def check_slopes(loop: ClosedLoop, record: Record, values: dict[str, float], start: Initial) -> int:
    """Check the derivatives of torque and position against central differences; return the events."""
    experiment = prepare(loop, record)
    names = [*(p.name for p in loop.joint.parameters), "initial_position"]
    found = simulate_sensitivities(loop, experiment, values, names, start, positions=True)
    assert found.response.outcome is Outcome.FINISHED
    assert np.array_equal(found.response.torque, simulate_torque(loop, experiment, values, start).torque)
    for j, name in enumerate(names):
        force = values.get("motor_coulomb", values.get("coulomb", 0.0))
        size, columns = force if name == "offset" else abs(values.get(name, 1.0)), (found.torque, found.motor_position)
        steps, own = tuple(size * np.logspace(-8, -4, 5)), tuple(column[:, j] for column in columns)
        assert error_beside_differences(own, loop, record, values, name, steps, start) < 2e-5, name
    return found.response.events


@pytest.mark.parametrize("delay", [0.0, 0.6e-3])
@pytest.mark.parametrize("model", ["rigid", "flexible"])
def test_the_derivatives_agree_with_central_differences(model: str, delay: float) -> None:
    joint, values = (RigidJoint, SUMS) if model == "rigid" else (FlexibleJoint, VALUES)
    controller = replace(CONTROLLER, delay=delay)
    heavy = ClosedLoop(joint(kind="revolute", gravity=replace(LINK, angle=1.2)), controller)
    assert check_slopes(heavy, swing(), values, Initial(0.32)) >= 3


@pytest.mark.parametrize("model", ["rigid", "flexible"])
def test_the_derivative_by_the_delay_agrees(model: str) -> None:
    """But for what moves with the edges in the error of holding: 1e-5 of the derivative."""
    joint, values = (RigidJoint, SUMS) if model == "rigid" else (FlexibleJoint, VALUES)
    loop, ends = ClosedLoop(joint(kind="revolute", gravity=LINK), CONTROLLER), []
    found = simulate_sensitivities(loop, prepare(loop, swing()), values, ["delay"], Initial(0.32)).torque[:, 0]
    for by in (-1e-7, 1e-7):
        late = ClosedLoop(loop.joint, replace(CONTROLLER, delay=CONTROLLER.delay + by))
        ends.append(simulate(late, prepare(late, swing()), values, Initial(0.32)).torque)
    assert np.linalg.norm(found - (ends[1] - ends[0]) / 2e-7) < 5e-5 * np.linalg.norm(found)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2, 3))])
def test_the_derivatives_agree_on_random_plants(seed: int) -> None:
    case, rng = rotary(seed), np.random.default_rng([seed, 3])
    assert case.clean.torque is not None
    assert case.clean.reference is not None
    size, travel = float(np.std(case.clean.torque.values)), float(np.ptp(case.clean.reference.values))
    gravity = Gravity("link", angle=float(rng.uniform(0.2, 1.5)) / travel)
    cos, sin = rng.uniform(-1, 1, 2) * size
    values = case.truth | {"gravity_cos": float(cos), "gravity_sin": float(sin)}
    assert isinstance(case.loop.joint, FlexibleJoint)
    heavy, home = replace(case.loop.joint, gravity=gravity), Initial(float(case.clean.reference.values[0]))
    check_slopes(ClosedLoop(heavy, case.loop.controller), case.clean, values, home)
    values = {n: values[n] for n in ("offset", "gravity_cos", "gravity_sin")} | {
        name: values[f"motor_{name}"] + values[f"load_{name}"] for name in ("inertia", "viscous", "coulomb")
    }
    check_slopes(ClosedLoop(heavy.rigid, case.loop.controller), case.clean, values, home)


@pytest.mark.parametrize("model", ["rigid", "flexible"])
def test_the_drive_side_sees_the_same_gravity(model: str) -> None:
    """The torque along the motor's motion is that of the loop."""
    joint, values = (RigidJoint, SUMS) if model == "rigid" else (FlexibleJoint, VALUES)
    loop = ClosedLoop(joint(kind="revolute", gravity=LINK), replace(CONTROLLER, delay=0.0))
    whole = simulate(loop, prepare(loop, swing()), values)
    motion = prescribed_motion(whole.motor_position, 1e-3)
    names = ("gravity_cos", "gravity_sin", *(("load_inertia",) if model == "flexible" else ("inertia",)))
    found = simulate_drive_side(loop.joint, motion, values, names)
    along = found.torque.reshape(-1, 4).mean(axis=1)
    smooth = np.abs(whole.motor_velocity[:-1]) > 0.05
    assert np.sqrt(np.mean((along - whole.torque[:-1])[smooth] ** 2)) < 0.03 * np.std(whole.torque)
    for j, name in enumerate(names):
        ends = [
            simulate_drive_side(loop.joint, motion, {**values, name: values[name] * (1 + by)}).torque
            for by in (-1e-5, 1e-5)
        ]
        column = (ends[1] - ends[0]) / (2e-5 * values[name])
        assert np.linalg.norm(found.derivatives[:, j] - column) < 1e-4 * np.linalg.norm(column), name
