"""Derivatives of joints' simulations, against central differences: plants, laws and controllers in one table."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from jointid.models.controllers import PID, Cascade, FirstOrder, Notch, SecondOrder, number, numbers_of, with_numbers
from jointid.models.controllers.filters import DigitalFilter
from jointid.models.controllers.laws import StateSpaceController
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.paper.twin import TABLE_2
from jointid.records.chunks import cut
from jointid.records.record import Channel, Record, Tap, Timing
from jointid.simulation.excitation import trapezoids
from jointid.simulation.kernels import engine
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate
from tests.plants import LAWS, PIECES, Case, prismatic, rigid, rotary, with_law
from tests.simulation.differences import AT_REST, Sensitivities, error_beside_differences, sensitivities

T = 1e-3
RIGID = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
FLEXIBLE = dict(TABLE_2)
WAYS = {
    "motor_inertia": 70.0, "motor_viscous_forwards": 90.0, "motor_coulomb_forwards": 14.0,
    "motor_viscous_backwards": 60.0, "motor_coulomb_backwards": 9.0, "stiffness": 6e5, "damping": 150.0,
    "load_inertia": 40.0, "load_viscous_forwards": 100.0, "load_coulomb_forwards": 12.0,
    "load_viscous_backwards": 120.0, "load_coulomb_backwards": 8.0, "offset": 0.0,
}  # fmt: skip
SIZES = {
    "offset": 10.0, "constant_feedforward": 10.0, "initial_torque": 10.0, "initial_position": 0.01,
    "initial_velocity": 0.05, "delay": 10.0 * T, "reference_delay": T,
}  # fmt: skip
"""Of numbers that may be 0; and of a delay, of which less than a millionth of a period is nothing."""


def driven(timing: Timing = Timing.HELD, tap: Tap = Tap.COMMAND) -> Record:
    reference = trapezoids((0.05, 0.1), 1.0, 0.1, T, rest=0.15)
    return Record(
        torque=Channel(np.zeros(reference.size), "N", T, timing), tap=tap, reference=Channel(reference, "m", T)
    )


def slower() -> Record:
    """Return a record whose command is at half the log's rate."""
    reference = trapezoids((0.05, 0.1), 1.0, 0.05, 2 * T, rest=0.1)[:300]
    torque = Channel(np.zeros(600), "N", T, Timing.HELD)
    return Record(torque=torque, reference=Channel(reference, "m", 2 * T))


def check(
    loop: ClosedLoop, record: Record, values: dict[str, float], names: tuple[str, ...], start: Initial = AT_REST,
    worst: float = 2e-4, shares: tuple[float, ...] = (1e-6, 1e-5), *, to_right: tuple[str, ...] = (),
) -> Sensitivities:  # fmt: skip
    """Assert that derivatives of torque and positions are the differences, some of them to one side."""
    found = sensitivities(loop, prepare(loop, record), values, names, start, positions=True)
    assert found.run.outcome is Outcome.FINISHED
    for j, name in enumerate(names):
        now = values.get(name) or numbers_of(loop.controller).get(name)
        size = SIZES.get(name) or abs(now or 1e-3)
        size = values.get("motor_coulomb", size) if name == "offset" else size
        columns = tuple(one[:, j] for one in (found.torque, found.motor_position, found.load_position) if one.size)
        steps, back = tuple(share * size for share in shares), 0.0 if name in to_right else 1.0
        error = error_beside_differences(columns, loop, record, values, name, steps, start, back=back)
        assert error < (5.0 * worst if name.endswith("damping") else worst), name
    return found


def late(seed: int) -> Case:
    """Return a rigid axis whose torque acts a part of a period later."""
    case = rigid(prismatic(seed))
    return replace(case, loop=replace(case.loop, controller=with_numbers(case.loop.controller, {"delay": 1.5e-4})))


@pytest.mark.parametrize("make", [prismatic, rotary])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 40))])
def test_of_random_plants(make: Callable[[int], Case], seed: int) -> None:
    case = make(seed)
    found = check(case.loop, case.clean, case.truth, tuple(case.truth))
    assert np.array_equal(found.run.torque, simulate(case.loop, prepare(case.loop, case.clean), case.truth).torque)


ALONE = [(law,) for law in (*LAWS, *PIECES)]
COMBINED = [("asymmetric-presliding", "load ripple"), ("stribeck-drifting-load-dependent", "hysteretic")]
OF_RIGID = [(law,) for law in ("asymmetric-load-dependent", "presliding-load-dependent", "stribeck")]
LONG = [("elastic-load",), ("presliding-load-dependent",), *COMBINED, ("two-piece", "balanced", "stribeck")]
QUICK = [*product([prismatic], [laws for laws in ALONE if laws not in LONG]), *product([late], OF_RIGID)]
SLOW = [*product([prismatic], LONG), *product([rotary], [*ALONE, *COMBINED, ("link", "ripple", "cubic")])]


@pytest.mark.parametrize(("make", "laws"), [*QUICK, *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW)])
def test_of_every_law(make: Callable[[int], Case], laws: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """By every number of the joint, of its beginning and of its controller; of the positions, too.

    Friction that grows with a torque bends where that is nothing, which is no event of the run, and later steps depend
    on when an event is: differences need finer steps. So do those of a third mass, 0.7 % off by the default step.
    """
    case, law = make(1), "-".join(laws)
    record = cut(case.clean, 0, 8000)
    loop, values = with_law(case, *laws)
    if "load-dependent" in law or "stribeck" in law or "elastic" in law:
        monkeypatch.setattr(engine, "REACH", 0.1 * engine.REACH)
    experiment = prepare(loop, record)
    speed = 0.2 * float(np.ptp(simulate(case.loop, experiment, case.truth).motor_velocity))
    begin = Initial(position=float(experiment.axis.inputs[0, 0]), velocity=speed)
    of_law = [name for name, value in numbers_of(loop.controller).items() if value and np.isfinite(value)]
    names = (*(p.name for p in loop.joint.parameters), *of_law)
    worst = 1e-2 if "cubic" in law else 5e-3 if "hysteretic" in law or "load-dependent" in law else 2e-3
    check(loop, record, values, names, begin, worst, (3e-6, 3e-7))


WINDUP = StateSpaceController(
    A=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    B={"reference": [0.02, 0.0, 0.0], "position": [-0.02, 1.0, 0.0], "excess": [1e-7, 0.0, 0.0]},
    C=[2e5, 3e6, 3e6], D={"reference": 8e5, "position": -8e5 - 6e6}, limit=60.0,
)  # fmt: skip
"""An integrator with anti-windup, and a velocity over two samples: three states."""
TWO_RATES = Cascade(
    position_gain=60.0, velocity_gain=6e3, integral_gain=30.0, velocity_feedforward=0.9,
    velocity_filter=FirstOrder(0.6e-3), torque_filters=(SecondOrder(250.0), Notch(80.0, 20.0, 0.1)), period=250e-6,
    position_period=1e-3, position_offset=0.5e-3, delay=0.35e-3, interpolation="cubic", acceleration_feedforward=60.0,
    viscous_feedforward=90.0, coulomb_feedforward=10.0, reference_delay=0.6e-3,
)  # fmt: skip
LIMITED = replace(TWO_RATES, limit=70.0, velocity_limit=0.07)
AT_LIMIT = PID(
    position_gain=3e5, derivative_gain=6e3, integral_gain=3e6, limit=70.0, velocity_filter=FirstOrder(0.6e-3),
    period=250e-6,
)  # fmt: skip
GAINS = ("position_gain", "velocity_gain", "gain")
NUMBERS = (
    *GAINS, "integral_gain", "delay", "velocity_feedforward", "reference_delay", "acceleration_feedforward",
    "viscous_feedforward", "coulomb_feedforward", "velocity_filter.time_constant", "torque_filters.0.frequency",
    "torque_filters.0.damping", "torque_filters.1.frequency", "torque_filters.1.bandwidth", "torque_filters.1.depth",
    "initial_torque",
)  # fmt: skip
OF_LIMITS = (*GAINS, "integral_gain", "limit", "velocity_limit", "torque_filters.1.frequency", "initial_torque")


@dataclass(frozen=True)
class Lawful:
    """A controller, the numbers of its own that are tried, and which of the joints here it moves."""

    law: Any
    names: tuple[str, ...]
    values: dict[str, float]
    of_two_rates: bool = True


CONTROLLERS = {
    "filtered": Lawful(
        Cascade(position_gain=100.0, velocity_gain=7e3, velocity_filter=(0.5, 0.5)), (*GAINS, "delay"), WAYS, False
    ),
    "at its limit": Lawful(Cascade(position_gain=100.0, velocity_gain=7e3, limit=60.0), (*GAINS, "limit"), WAYS, False),
    "late": Lawful(Cascade(position_gain=60.0, velocity_gain=5e3, delay=1.4e-3), (*GAINS[:2], "delay"), WAYS, False),
    "digital": Lawful(
        Cascade(position_gain=80.0, velocity_gain=6e3, velocity_filter=DigitalFilter((0.4,), (1.0, -0.6))),
        GAINS[:2], WAYS, False,
    ),
    "state space": Lawful(WINDUP, ("gain", "limit"), WAYS, False),
    "two rates, rigid": Lawful(TWO_RATES, NUMBERS, RIGID),
    "two rates": Lawful(TWO_RATES, NUMBERS, FLEXIBLE),
    "without integral": Lawful(
        replace(TWO_RATES, integral_gain=0.0), ("position_gain", "constant_feedforward", "initial_torque"), RIGID
    ),
    "holds": Lawful(LIMITED, OF_LIMITS, FLEXIBLE),
    "tracks": Lawful(  # what is tracked must not lag, or it swings
        replace(LIMITED, anti_windup="track", torque_filters=(Notch(80.0, 20.0, 0.9),)), OF_LIMITS[:6], FLEXIBLE
    ),
    "winds up": Lawful(replace(LIMITED, anti_windup="none"), OF_LIMITS, FLEXIBLE),
    "PID that holds": Lawful(AT_LIMIT, ("position_gain", "derivative_gain", "integral_gain", "limit", "gain"), RIGID),
    "PID that tracks": Lawful(replace(AT_LIMIT, anti_windup="track"), ("integral_gain", "limit", "gain"), RIGID),
}  # fmt: skip
_QUICK = ("filtered", "tracks", "PID that tracks")


@pytest.mark.parametrize(
    "name", [name if name in _QUICK else pytest.param(name, marks=pytest.mark.slow) for name in CONTROLLERS]
)
def test_of_controllers(name: str) -> None:
    """From a start in motion, across reversals, sticking, delays and limits; of a limit that it acts."""
    case = CONTROLLERS[name]
    joint: Any = FlexibleJoint("prismatic") if "stiffness" in case.values else RigidJoint("prismatic")
    joint = replace(joint, friction=FRICTIONS["asymmetric"]) if case.values is WAYS else joint
    record, torque = (slower(), 15.0) if case.of_two_rates else (driven(), None)
    begin = Initial(1e-4, 0.005, torque) if case.of_two_rates else Initial(1e-3, 0.02)
    names = (*case.values, "initial_position", "initial_velocity", *case.names)
    right = ("delay",) if not number(case.law, "delay") else ()  # a delay of 0 is the shortest
    loop = ClosedLoop(joint, case.law)
    found = check(loop, record, case.values, names, begin, shares=(1e-6, 1e-5, 1e-4), to_right=right)
    assert (0.01 < found.run.at_limit < 0.9) == np.isfinite(number(case.law, "limit"))
    # Without positions most periods are followed in one step of their own.
    torque_alone = sensitivities(loop, prepare(loop, record), case.values, names, begin).torque
    assert np.allclose(torque_alone, found.torque, rtol=1e-9, atol=1e-9 * np.abs(found.torque).max(axis=0))


def test_of_numbers_that_are_0() -> None:
    """Of a delay that towards longer ones."""
    law = Cascade(
        position_gain=60.0, velocity_gain=6e3, integral_gain=30.0, velocity_feedforward=0.5, period=250e-6,
        torque_filters=(Notch(80.0, 20.0),),
    )  # fmt: skip
    names = ("acceleration_feedforward", "viscous_feedforward", "coulomb_feedforward", "constant_feedforward",
             "reference_delay", "torque_filters.0.depth")  # fmt: skip
    loop = ClosedLoop(RigidJoint("prismatic"), law)
    check(loop, slower(), RIGID, names, Initial(1e-4, 0.005), 3e-4, (1e-5, 1e-4, 1e-2, 1.0), to_right=names)


@pytest.mark.parametrize("delay", [0.3e-3, 1.25e-3])
def test_of_a_delay_in_an_averaged_measured_torque(delay: float) -> None:
    loop = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=60.0, velocity_gain=5e3, delay=delay))
    check(loop, driven(Timing.AVERAGED, Tap.MEASURED), RIGID, ("delay", "inertia"), shares=(1e-5,), to_right=("delay",))


def test_more_columns_than_the_kernel_follows_at_a_time_keep_their_order() -> None:
    joint = FlexibleJoint("prismatic", FRICTIONS["asymmetric"])
    loop = ClosedLoop(joint, Cascade(position_gain=100.0, velocity_gain=7e3))
    experiment = prepare(loop, driven())
    names = ["velocity_gain", *WAYS, "initial_position", "delay", "position_gain", "initial_velocity", "gain"]
    together = sensitivities(loop, experiment, WAYS, names, positions=True)
    for j, name in enumerate(names):
        alone = sensitivities(loop, experiment, WAYS, [name], positions=True)
        assert np.allclose(together.torque[:, [j]], alone.torque, rtol=1e-12, atol=1e-12 * np.abs(alone.torque).max())
        assert np.allclose(together.load_position[:, [j]], alone.load_position, rtol=1e-9, atol=1e-15)


def test_what_is_held_at_rest_forgets_the_velocity_it_was_to_begin_with() -> None:
    """Friction takes it at once, so it must not move what comes loose later; with positions and without."""
    loop = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=100.0, velocity_gain=2e3))
    experiment = prepare(loop, driven())
    slope = sensitivities(loop, experiment, RIGID, ["initial_velocity"]).torque
    assert np.any(slope[0]) and not np.any(slope[5:])
    kept = sensitivities(loop, experiment, RIGID, ["initial_velocity"], positions=True).torque
    assert np.allclose(slope, kept, rtol=1e-12, atol=1e-12 * np.abs(kept).max())


@pytest.mark.parametrize(
    ("gains", "outcome"),
    [((2e5, 1e6), Outcome.DIVERGED), ((110.0, 0.0), Outcome.FINISHED), ((60.0, 4000.0), Outcome.FINISHED)],
)
def test_an_unstable_loop_has_no_derivatives(gains: tuple[float, float], outcome: Outcome) -> None:
    """Held by its limit it swings on, and the effect of a small change grows beyond all numbers."""
    limit = 200.0 if outcome is Outcome.FINISHED else np.inf
    law = Cascade(period=2e-3, limit=limit, position_gain=20.0, velocity_gain=gains[0], integral_gain=gains[1])
    loop = ClosedLoop(RigidJoint("revolute"), law)
    record = Record(reference=Channel(trapezoids((1.0,), 5.0, 10.0, 2e-3, duration=20.0), "rad", 2e-3))
    values = {"inertia": 0.1, "viscous": 0.1, "coulomb": 0.5, "offset": 0.0}
    run = sensitivities(loop, prepare(loop, record), values, ["inertia", "velocity_gain"])
    assert run.run.outcome is outcome
    assert not run.torque.any()
