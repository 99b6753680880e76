"""Smooth laws: against a slow reference in rate form, and the exact drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.models.controllers import Cascade, numbers_of
from jointid.models.friction import FRICTIONS, PARTS
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.position_forces import Gravity, PositionHarmonics
from jointid.models.springs import SPRINGS
from jointid.records.record import Channel, Record
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.excitation import trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import Case, prismatic, rotary
from tests.simulation.kernel_case import run
from tests.simulation.oracle import Law, Plant, random_case
from tests.simulation.oracle import simulate as reference_in_pieces
from tests.simulation.smooth_oracle import Smooth, windup
from tests.simulation.smooth_oracle import simulate as reference

EVENTFUL = 9
# Two masses: without a delay, with one of 0.9 and of 2.5 periods.
SEEDS = (2, EVENTFUL, pytest.param(12, marks=pytest.mark.slow))
_PERIODS = 60
FINE = 0.005  # rad in a step


def _law(name: str, plant: Plant, own: FloatArray, duration: float) -> Smooth:
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
def test_agrees_with_a_reference_that_locates_every_event(seed: int, name: str) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    _, _, own, _ = run(plant, law, w[:150], post[:150], T, delay, before, x0)
    more = _law(name, plant, own, _PERIODS * T)
    w, post = w[:_PERIODS], post[:_PERIODS]
    status, u, x, counts = run(
        plant, law, w, post, T, delay, before, x0, laws=more.laws, places=more.places, reach=FINE
    )
    expected_u, expected_x = reference(plant, more, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 5 or seed != EVENTFUL
    np.testing.assert_allclose(u, expected_u, rtol=0, atol=1e-7 * np.abs(expected_u).max())
    np.testing.assert_allclose(x, expected_x, rtol=0, atol=1e-7 * np.abs(expected_x).max())


def _nothing_more(case: Case, friction: str = "drifting", spring: str = "cubic") -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with smooth laws that add nothing to what it is."""
    joint = replace(case.loop.joint, friction=FRICTIONS[friction]())
    if isinstance(joint, FlexibleJoint):
        joint = replace(joint, spring=SPRINGS[spring]())
    more = {p.name: 0.0 for p in joint.parameters if p.name not in case.truth}
    return replace(case.loop, joint=joint), case.truth | more


def _of_nothing(case: Case) -> dict[str, float]:
    """What a slider without stiffness, or a share of 0 that swings, may have all the same."""
    return {"hysteresis_torque": 1.0, "swinging_stiffness": 2.5 * case.truth["stiffness"], "swinging_damping": 1.0}


@pytest.mark.parametrize("make", [prismatic, rotary])
def test_laws_that_add_nothing_leave_the_exact_drive(make: Callable[[int], Case]) -> None:
    case = make(1)
    loop, values = _nothing_more(case)
    experiment = prepare(loop, case.clean)
    exact, found = (simulate(*one) for one in ((case.loop, experiment, case.truth), (loop, experiment, values)))
    assert found.outcome is Outcome.FINISHED
    assert found.events >= exact.events > 10
    for signal in ("torque", "motor_position", "load_velocity"):
        peak = np.abs(getattr(exact, signal)).max()
        np.testing.assert_allclose(getattr(found, signal), getattr(exact, signal), rtol=0, atol=3e-5 * peak)
    assert found.load is not None and exact.load is not None
    difference = np.abs(found.load.acceleration - exact.load.acceleration)
    assert np.median(difference) < 1e-5 * np.abs(exact.load.acceleration).max()


@pytest.mark.parametrize("spring", ["cubic", "hysteretic", "elastic-load"])
@pytest.mark.parametrize("make", [prismatic, rotary])
def test_laws_that_add_nothing_leave_the_derivatives_of_the_exact_drive(
    make: Callable[[int], Case], spring: str
) -> None:
    case = make(1)
    loop, values = _nothing_more(case, spring=spring)
    values |= {name: value for name, value in _of_nothing(case).items() if name in values}
    experiment = prepare(loop, case.clean)
    law = [name for name, value in numbers_of(loop.controller).items() if value and np.isfinite(value)]
    names = [*(p.name for p in case.loop.joint.parameters), "initial_position", "initial_velocity", *law]
    exact = simulate_sensitivities(case.loop, experiment, case.truth, names, positions=True)
    found = simulate_sensitivities(loop, experiment, values, names, positions=True)
    for i, name in enumerate(names):
        for signal in ("torque", "motor_position", "load_position"):
            column, expected = getattr(found, signal)[:, i], getattr(exact, signal)[:, i]
            assert np.linalg.norm(column - expected) <= 1e-3 * np.linalg.norm(expected), (name, signal)


def test_gravity_beside_a_ripple_is_that_of_the_exact_drive() -> None:
    """The exact drive holds what gravity is over each period, at an error of second order in it."""
    plain = RigidJoint("revolute", gravity=Gravity("link", angle=0.7))
    values = {"inertia": 0.2, "viscous": 0.5, "coulomb": 1.0, "offset": 0.3, "gravity_cos": 4.0, "gravity_sin": -2.0}
    joint, still = replace(plain, ripple=PositionHarmonics(0.3)), {"harmonic_1_cosine": 0.0, "harmonic_1_sine": 0.0}
    reference = Record(reference=Channel(trapezoids([2.0, 6.0], 40.0, 3.0, 1e-3, duration=4.0), "rad", 1e-3))
    loop = ClosedLoop(plain, Cascade(position_gain=30.0, velocity_gain=20.0))
    exact = simulate(loop, prepare(loop, reference), values).torque
    found = simulate(replace(loop, joint=joint), prepare(loop, reference), values | still).torque
    rippled = simulate(replace(loop, joint=joint), prepare(loop, reference), values | dict.fromkeys(still, 1.0)).torque
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()
    assert np.abs(rippled - exact).max() > 0.1


def test_the_inverse_model_of_a_run_is_its_torque() -> None:
    """The columns of a ripple are those that a regression has."""
    case = prismatic(1)
    for side in ("motor", "load"):
        ripple = PositionHarmonics(0.05, 2, side)  # type: ignore[arg-type]
        joint = replace(case.loop.joint, ripple=ripple)
        loop, values = replace(case.loop, joint=joint), case.truth | {p.name: 3.0 for p in ripple.parameters}
        run = simulate(loop, prepare(loop, case.clean), values)
        moving = (run.motor.velocity != 0) & (run.motor.acceleration != 0)
        assert run.load is not None
        moving &= run.load.velocity != 0
        columns = joint.regressor(run.motor, run.load)
        found = columns @ np.array([values[p.name] for p in joint.parameters])
        np.testing.assert_allclose(found[0][moving], run.torque[moving], atol=1e-6 * np.abs(run.torque).max())
        np.testing.assert_allclose(found[1][moving], 0.0, atol=1e-6 * np.abs(run.torque).max())


def test_accelerations_balance_friction_that_drifts() -> None:
    """Inertia times acceleration is what the torque leaves beside friction and spring, of both sides."""
    case = prismatic(1)
    loop, values = _nothing_more(case)
    drifts = {"motor_viscous": 0.5, "motor_coulomb": -0.3, "load_viscous": -0.4, "load_coulomb": 0.2}
    record = case.clean.with_channels({n: replace(c, values=c.values[:3000]) for n, c in case.clean.items()})
    experiment = prepare(loop, record)
    time = experiment.sample_time * np.arange(experiment.samples)
    values |= {f"{name}_drift": share * values[name] / time[-1] for name, share in drifts.items()}
    run = simulate(loop, experiment, values)
    assert run.load is not None
    spring = values["stiffness"] * (run.load.position - run.motor.position)
    spring += values["damping"] * (run.load.velocity - run.motor.velocity)
    for side, motion, push in (
        ("motor", run.motor, run.torque - values["offset"] + spring),
        ("load", run.load, -spring),
    ):
        viscous, coulomb = (values[f"{side}_{part}"] + values[f"{side}_{part}_drift"] * time for part in PARTS)
        left = push - viscous * motion.velocity - coulomb * np.sign(motion.velocity)
        moving = motion.velocity != 0
        expected = left[moving] / values[f"{side}_inertia"]
        np.testing.assert_allclose(motion.acceleration[moving], expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_a_mass_under_presliding_friction_creeps_until_its_spring_carries_it() -> None:
    """A constant push below Fc moves it by s ln(1 / (1 - push / Fc)), where the wound-up friction carries the push."""
    plant = Plant(inertia1=1.0, fv1=(2000.0, 2000.0), fc1=(10.0, 10.0), offset=-6.0)
    nothing = np.zeros(0)
    law = Law(np.zeros((0, 0)), nothing, nothing, nothing, 0.0, np.inf, nothing)
    w, more = np.zeros(5000), Smooth(presliding=(1e-3, 0.0))
    _, _, x, _ = run(plant, law, w, w, 1e-3, 0.0, 0.0, np.zeros(2), laws=more.laws)
    assert x[-1, 0] == pytest.approx(1e-3 * np.log(1 / (1 - 0.6)), rel=1e-4)


def test_a_stop_at_the_end_of_a_period_ends_no_simulation() -> None:
    """What rounding leaves of a period after it is no step that is too short."""
    nothing = np.zeros(0)
    law = Law(np.zeros((0, 0)), nothing, nothing, nothing, 0.0, np.inf, nothing)
    for speed in (0.1, 0.2, 1.0, 1.0 / 3.0):
        for periods in range(3, 30):
            plant = Plant(inertia1=1.0, fc1=(speed / (periods * 1e-3),) * 2)
            w = np.zeros(periods + 3)
            status, _, x, _ = run(plant, law, w, w, 1e-3, 0.0, 0.0, np.array([0.0, speed]), laws=Smooth().laws)
            assert status == 0 and abs(x[-1, 1]) < 1e-12


@pytest.mark.parametrize("make", [prismatic, rotary])
def test_friction_that_winds_up_over_next_to_nothing_is_coulombs(make: Callable[[int], Case]) -> None:
    """However stiff it then is; what it differs by is the motion of a mass that it holds, as the root of its length."""
    case = make(1)
    exact = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    loop = replace(case.loop, joint=replace(case.loop.joint, friction=FRICTIONS["presliding"]()))
    for share, within in ((1e-6, 5e-2), (1e-9, 2e-3), (1e-12, 5e-5)):
        length = share * float(np.ptp(exact.motor_position))
        values = case.truth | {"motor_presliding_distance": length, "load_presliding_distance": length}
        found = simulate(loop, prepare(loop, case.clean), values)
        assert found.outcome is Outcome.FINISHED
        assert np.abs(found.torque - exact.torque).max() < within * np.abs(exact.torque).max()


@pytest.mark.parametrize("kernel", ["exact", "in steps"])
@pytest.mark.parametrize("eps", [6e-5, 2e-4, 1e-3])
@pytest.mark.parametrize("period", [2e-3, 3e-2])
def test_a_velocity_that_dips_below_nothing_for_a_moment_is_seen(kernel: str, eps: float, period: float) -> None:
    """A load that swings in a motion, just faster than its mean, turns round twice at each swing."""
    stiffness, inertia, speed, coulomb = 1e4, 1.0, 0.1, 1e-3
    plant = Plant(inertia1=1e9, inertia2=inertia, stiffness=stiffness, fc2=(coulomb, coulomb))
    nothing = np.zeros(0)
    law = Law(np.zeros((0, 0)), nothing, nothing, nothing, 0.0, np.inf, nothing)
    w = np.zeros(round(0.08 / period))
    pulled = speed * (1 + eps) * np.sqrt(stiffness * inertia) + coulomb
    case = plant, law, w, w, period, 0.0, 0.0, np.array([0.0, speed, -pulled / stiffness, speed])
    laws = None if kernel == "exact" else Smooth().laws
    status, _, x, counts = run(*case, laws=laws, reach=FINE)
    expected = reference_in_pieces(*case)
    assert status == 0
    assert counts[0] == len(expected.events) == 2
    np.testing.assert_allclose(x[:, [1, 3]], expected.x[:, [1, 3]], rtol=0, atol=1e-8 * speed)


@pytest.mark.parametrize("name", ["damping", "load_coulomb"])
def test_a_number_at_its_bound_has_the_derivative_to_the_side_of_joints(name: str) -> None:
    case = prismatic(1)
    loop, values = _nothing_more(case)
    experiment, at = prepare(loop, case.clean), {name: 0.0}
    exact = simulate_sensitivities(case.loop, experiment, case.truth | at, [name]).torque
    found = simulate_sensitivities(loop, experiment, values | at, [name]).torque
    assert np.linalg.norm(exact) > 1.0
    assert np.linalg.norm(found - exact) < 0.05 * np.linalg.norm(exact)


def test_friction_that_grows_with_the_load_is_in_balance_at_the_first_sample() -> None:
    law, values = (
        FRICTIONS["load-dependent"](),
        {"load_viscous": 0.0, "load_coulomb": 2.0, "load_friction_per_torque": 0.2},
    )
    for velocity, load in ((1.0, 50.0), (-1.0, 50.0), (1.0, -50.0), (-1.0, 0.5)):
        drag = law.drag(values, velocity, load, "load_")
        assert drag == pytest.approx(np.sign(velocity) * (2.0 + 0.2 * abs(load + drag)))


@pytest.mark.parametrize("velocity", [0.0, 1e-9, 1e-5])
def test_what_has_not_wound_up_does_not_drag_at_the_first_sample(velocity: float) -> None:
    case = prismatic(1)
    joint = case.loop.joint
    loop = replace(case.loop, joint=replace(joint, friction=FRICTIONS["presliding"]()))
    values = case.truth | {"motor_presliding_distance": 1e-4, "load_presliding_distance": 1e-4}
    experiment = prepare(loop, case.clean)
    found = simulate(loop, experiment, values, Initial(velocity=velocity))
    rest = simulate(loop, experiment, values)
    assert np.abs(found.torque - rest.torque).max() <= 1e-3 + 1e6 * velocity
