"""Every law of friction, springs and gravity: values against slow references, derivatives against differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.models.springs import SPRINGS
from jointid.records.record import Channel, Record
from jointid.simulation.closed_loop import Initial, simulate, simulate_torque
from jointid.simulation.excitation import trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.prescribed import PARTS, prescribed_motion, simulate_drive_side
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import Case, prismatic, rotary
from tests.simulation.differences import error_beside_differences
from tests.simulation.kernel_case import FINE, run
from tests.simulation.oracle import Law, Plant, random_case
from tests.simulation.oracle import simulate as reference_in_pieces
from tests.simulation.smooth_oracle import Smooth, windup
from tests.simulation.smooth_oracle import simulate as reference
from tests.smooth_laws import LAWS, PIECES, with_law

EVENTFUL = 9
# Two masses: without a delay, with one of 0.9 and of 2.5 periods.
SEEDS = (2, EVENTFUL, pytest.param(12, marks=pytest.mark.slow))
_PERIODS = 60
NOTHING = np.zeros(0)
NO_LAW = Law(np.zeros((0, 0)), NOTHING, NOTHING, NOTHING, 0.0, math.inf, NOTHING)


def smooth_law(name: str, plant: Plant, own: FloatArray, duration: float) -> Smooth:
    """Return a law that shows in a motion, (periods, 4)."""
    e, travel = windup(own), float(np.ptp(own[:, 0]))
    torque = plant.stiffness * e
    laws = {
        "cubic": Smooth(cubic=0.8 * plant.stiffness / e**2),
        "hysteretic": Smooth(slider=0.4 * plant.stiffness, slips=0.1 * torque),
        "presliding": Smooth(presliding=(0.01 * travel, 0.03 * travel)),
        "load-dependent": Smooth(per_torque=0.2),
        "elastic-load": Smooth(swings=(0.4, 4.0 * plant.stiffness, 2.0 * plant.damping)),
        "ripple": Smooth(ripple=((0, 40.0 / travel, 0.1 * torque, 0.0), (1, 90.0 / travel, 0.0, 0.05 * torque))),
        "drifting": Smooth(
            drift=(-0.5 * min(plant.fv1) / duration, 0.8 * min(plant.fv2) / duration),
            fade=(0.6 * min(plant.fc1) / duration, -0.7 * min(plant.fc2) / duration),
        ),
    }
    whole = {
        field: getattr(law, field) for law in laws.values() for field in vars(law) if any(np.ravel(getattr(law, field)))
    }
    return Smooth(**whole) if name == "all together" else laws[name]


@pytest.mark.parametrize(
    "name",
    ["cubic", "hysteretic", "presliding", "load-dependent", "drifting", "elastic-load", "ripple", "all together"],
)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_smooth_law_agrees_with_a_reference_that_locates_every_event(seed: int, name: str) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    _, _, own, _ = run(plant, law, w[:150], post[:150], T, delay, before, x0)
    more = smooth_law(name, plant, own, _PERIODS * T)
    w, post = w[:_PERIODS], post[:_PERIODS]
    status, u, x, counts = run(
        plant, law, w, post, T, delay, before, x0, laws=more.laws, places=more.places, reach=FINE
    )
    expected_u, expected_x = reference(plant, more, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 5 or seed != EVENTFUL
    np.testing.assert_allclose(u, expected_u, rtol=0, atol=1e-7 * np.abs(expected_u).max())
    np.testing.assert_allclose(x, expected_x, rtol=0, atol=1e-7 * np.abs(expected_x).max())


def in_pieces(plant: Plant, law: str, own: FloatArray) -> Plant:
    """Return a plant with another law in pieces, or in gravity, which shows in its motion, (periods, 4)."""
    K, F, most = plant.stiffness, plant.damping, windup(own) if own.shape[1] > 2 else 0.0
    speeds = np.max(np.abs(own[:, 1::2]), axis=0)
    if "rises" in law or "falls" in law:
        points = []
        for fc, speed in zip((plant.fc1, plant.fc2), speeds, strict=False):
            more = (0.5 if "rises" in law else -0.5) * min(fc)
            points.append(((0.0, more), (0.02 * speed, 0.8 * more), (0.1 * speed, 0.2 * more), (0.3 * speed, 0.0)))
        plant = replace(plant, more1=points[0], more2=() if plant.inertia2 is None else points[1])
    if "backlash" in law:
        plant = replace(plant, pieces=((0.0, 0.0, 0.0, 0.0), (0.25 * most, 0.0, K, F)))
    if law == "three-piece":
        first, second = 0.3 * most, 0.7 * most
        torque = 0.6 * K * first
        then = (second, torque + K * (second - first), 1.5 * K, F)
        plant = replace(plant, pieces=((0.0, 0.0, 0.6 * K, F), (first, torque, K, F), then))
    if law == "gravity":
        travel, weight = float(np.ptp(own[:, 0])), 3.0 * max(*plant.fc1, 1e-3)
        plant = replace(plant, gravity=(weight, 0.4 * weight, 0.05 * weight / travel, 1.0 / travel))
    return plant


@pytest.mark.parametrize(
    ("seed", "name"),
    [
        (0, "rises"), (0, "falls"), (0, "gravity"), (1, "three-piece"), (1, "backlash"), (2, "rises"), (2, "falls"),
        (2, "rises beside backlash"), (2, "gravity"), (12, "falls"),
        *(pytest.param(seed, name, marks=pytest.mark.slow) for seed in (9, 12) for name in
          ("rises", "three-piece", "backlash", "gravity")),
    ],
)  # fmt: skip
def test_a_law_in_pieces_agrees_with_a_reference_that_locates_every_event(seed: int, name: str) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    w, post = w[:200], post[:200]
    _, _, own, _ = run(plant, law, w, post, T, delay, before, x0)
    own = own[:, :2] if plant.inertia2 is None else own
    plant = in_pieces(plant, name, own)
    status, u, x, counts = run(plant, law, w, post, T, delay, before, x0, reach=FINE)
    expected = reference_in_pieces(plant, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > (0 if name == "gravity" else 4)
    np.testing.assert_allclose(u, expected.u, rtol=0, atol=1e-7 * np.abs(expected.u).max())
    np.testing.assert_allclose(x[:, : expected.x.shape[1]], expected.x, rtol=0, atol=1e-7 * np.abs(expected.x).max())


@pytest.mark.parametrize("law", [*LAWS, *PIECES])
@pytest.mark.parametrize("make", [prismatic, pytest.param(rotary, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_differences_of_runs(make: Callable[[int], Case], law: str) -> None:
    """By every number of the joint, of its beginning and of its controller; of the positions, too."""
    case = make(1)
    loop, values = with_law(case, law)
    experiment = prepare(loop, case.clean)
    speed = 0.2 * float(np.ptp(simulate(case.loop, experiment, case.truth).motor_velocity))
    begin = Initial(position=float(experiment.inputs[0, 0]), velocity=speed, wound_up=1.0)
    own = [p.name for p in loop.joint.parameters]
    of_law = [name for name, value in numbers_of(loop.controller).items() if value and np.isfinite(value)]
    names = [*own, "initial_position", "initial_velocity", *of_law]
    found = simulate_sensitivities(loop, experiment, values, names, begin, positions=True)
    assert np.array_equal(found.response.torque, simulate_torque(loop, experiment, values, begin).torque)
    columns = found.torque, found.motor_position, found.load_position
    for i, name in enumerate(names):
        now = values.get(name) or numbers_of(loop.controller).get(name) or speed
        steps = tuple(by * (abs(now) or 1e-3) for by in (3e-6, 3e-7))
        own = tuple(column[:, i] for column in columns)
        error = error_beside_differences(own, loop, case.clean, values, name, steps, begin)
        assert error <= (1e-2 if law in PIECES else 5e-3), name


@pytest.mark.parametrize(
    "law", ["load-dependent", "asymmetric-load-dependent", "presliding-load-dependent", "stribeck"]
)
def test_friction_of_a_rigid_joint_has_derivatives(law: str) -> None:
    case = prismatic(1)
    joint = RigidJoint("prismatic", FRICTIONS[law]())
    loop = ClosedLoop(joint, with_numbers(case.loop.controller, {"delay": 1.5e-4}))
    sides = {name.removeprefix("motor_"): value for name, value in case.truth.items()}
    sides |= {"stribeck_force": 0.4 * sides["coulomb"], "stribeck_speed": 0.01}
    values = {p.name: sides.get(p.name, sides.get(p.name.rpartition("_")[0], 0.15)) for p in joint.parameters}
    values |= {"presliding_distance": 1e-3} if law.startswith("presliding") else {}
    experiment, names = prepare(loop, case.clean), [*values, "position_gain", "delay"]
    found = simulate_sensitivities(loop, experiment, values, names)
    for i, name in enumerate(names):
        now = abs(values.get(name) or numbers_of(loop.controller)[name])
        steps = 3e-6 * now, 3e-7 * now
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, steps)
        assert error <= 3e-3, name


@pytest.mark.parametrize(
    ("law", "values"),
    [
        ("cubic", {"cubic_stiffness": 0.0}),
        ("hysteretic", {"hysteresis_stiffness": 0.0, "hysteresis_torque": 1.0}),
        ("elastic-load", {"swinging_share": 0.0, "swinging_stiffness": 1e6, "swinging_damping": 1.0}),
        ("three-piece", {"torque_1": 20.0, "torque_2": 40.0}),
        ("stribeck", {"motor_stribeck_speed": 1.0, "load_stribeck_speed": 1.0}),
        ("drifting", {}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("make", [prismatic, rotary])
def test_laws_that_add_nothing_leave_the_exact_drive_and_its_derivatives(
    make: Callable[[int], Case], law: str, values: dict[str, float]
) -> None:
    case = make(1)
    joint = case.loop.joint
    other = replace(joint, friction=FRICTIONS[law]()) if law in FRICTIONS else replace(joint, spring=SPRINGS[law]())  # type: ignore[call-arg]
    loop, experiment = replace(case.loop, joint=other), prepare(case.loop, case.clean)
    same = dict.fromkeys(("stiffness_2", "stiffness_3"), case.truth["stiffness"])
    values = {p.name: (case.truth | same | values).get(p.name, 0.0) for p in other.parameters}
    exact, found = (simulate(*one) for one in ((case.loop, experiment, case.truth), (loop, experiment, values)))
    assert found.events >= exact.events > 10
    for signal in ("torque", "motor_position", "load_velocity"):
        peak = np.abs(getattr(exact, signal)).max()
        np.testing.assert_allclose(getattr(found, signal), getattr(exact, signal), rtol=0, atol=3e-5 * peak)
    assert found.load is not None and exact.load is not None
    difference = np.abs(found.load.acceleration - exact.load.acceleration)
    assert np.median(difference) < 1e-5 * np.abs(exact.load.acceleration).max()
    numbers = [name for name, value in numbers_of(loop.controller).items() if value and np.isfinite(value)]
    names = [p.name for p in joint.parameters if law != "three-piece" or p.name != "stiffness"]
    names += ["initial_position", "initial_velocity", *numbers]
    both = ((case.loop, experiment, case.truth), (loop, experiment, values))
    exactly, steps = (simulate_sensitivities(*one, names, positions=True) for one in both)
    for i, name in enumerate(names):
        for signal in ("torque", "motor_position", "load_position"):
            column, expected = getattr(steps, signal)[:, i], getattr(exactly, signal)[:, i]
            assert np.linalg.norm(column - expected) <= 1e-3 * np.linalg.norm(expected), (name, signal)


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
    motion, names = prescribed_motion(whole.motor_position, 1e-3), ("gravity_cos", joint.parameters[0].name)
    prescribed = simulate_drive_side(joint, motion, values, names)
    along = prescribed.torque.reshape(-1, PARTS).mean(axis=1)
    smooth = np.abs(whole.motor_velocity[:-1]) > 0.05
    assert np.sqrt(np.mean((along - whole.torque[:-1])[smooth] ** 2)) < 0.03 * np.std(whole.torque)
    for j, name in enumerate(names):
        ends = (simulate_drive_side(joint, motion, {**values, name: values[name] * (1 + by)}) for by in (1e-5, -1e-5))
        column = np.subtract(*(end.torque for end in ends)) / (2e-5 * values[name])
        assert np.linalg.norm(prescribed.derivatives[:, j] - column) < 1e-4 * np.linalg.norm(column), name


@pytest.mark.parametrize(("joint", "values"), HANGING, ids=["rigid", "flexible"])
def test_derivatives_of_a_link_that_begins_off_its_reference(joint: Joint, values: dict[str, float]) -> None:
    """By the delay, too, which moves no edge at the first sample."""
    loop, record = swing(joint, 0.6e-3)
    names, start = [*(p.name for p in joint.parameters), "initial_position", "delay"], Initial(0.32)
    found = simulate_sensitivities(loop, prepare(loop, record), values, names, start).torque
    for j, name in enumerate(names):
        size = 4.0 if name == "offset" else abs(values.get(name, 1e-3 if name == "delay" else 1.0))
        steps = tuple(size * np.logspace(-8, -4, 5))
        assert error_beside_differences((found[:, j],), loop, record, values, name, steps, start) < 1e-3, name


def test_a_load_that_friction_holds_stays_where_it_is_to_the_last_bit() -> None:
    plant = Plant(
        inertia1=2.0, fv1=(2.0, 2.0), fc1=(80.0, 80.0), offset=0.5, inertia2=3.0, fv2=(2.0, 2.0), fc2=(80.0, 80.0),
        stiffness=5e3, damping=5.0, gravity=(40.0, 15.0, -2.0, 1.0),
    )  # fmt: skip
    for position in np.random.default_rng(0).uniform(-1e-3, 1e-3, 20):  # less than the spring gives
        x0 = np.array([0.0, 0.0, position, 0.0])
        _, _, states, counts = run(plant, NO_LAW, np.zeros(500), np.zeros(500), 1e-3, 0.0, 0.0, x0)
        assert counts[0] == 0
        assert np.array_equal(states, np.tile(x0, (500, 1)))


def test_a_load_at_rest_hangs_where_its_spring_carries_it() -> None:
    _, _, load, _ = HANGING[1][0].start(VALUES, 0.7, 0.0)
    weight = 36.0 * math.cos(load) + 15.0 * math.sin(load) - 1.0 * load
    assert VALUES["stiffness"] * (0.7 - load) == pytest.approx(weight, rel=1e-13)


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
