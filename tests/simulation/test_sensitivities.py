"""The exact derivatives against central differences, across reversals, sticking, delays and limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from jointid.models.controllers import Cascade, DigitalFilter, StateSpaceController
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.paper.twin import twin
from jointid.records.record import Channel, Record, Tap, Timing
from jointid.simulation.closed_loop import Initial, Outcome, simulate_torque
from jointid.simulation.excitation import trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.plants import prismatic, rotary
from tests.simulation.differences import error_beside_differences

TWIN = twin("L19", noise="none")


@pytest.mark.parametrize("make", [prismatic, rotary])
@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(6, 50))])
def test_agree_with_central_differences_on_random_plants(make: Callable, seed: int) -> None:
    case = make(seed)
    record = case.clean
    names = [p.name for p in case.loop.joint.parameters]
    experiment = prepare(case.loop, record)
    found = simulate_sensitivities(case.loop, experiment, case.truth, names)
    assert np.array_equal(found.response.torque, simulate_torque(case.loop, experiment, case.truth).torque)
    for j, name in enumerate(names):
        size = case.truth["motor_coulomb" if name == "offset" else name]
        error = error_beside_differences(
            (found.torque[:, j],), case.loop, record, case.truth, name, (1e-6 * size, 1e-5 * size)
        )
        assert error < (3e-4 if name == "damping" else 1e-4), name


REFERENCE = trapezoids((0.05, 0.1), 1.0, 0.1, 1e-3, rest=0.15)
VALUES = {
    "motor_inertia": 70.0, "motor_viscous_forwards": 90.0, "motor_coulomb_forwards": 14.0,
    "motor_viscous_backwards": 60.0, "motor_coulomb_backwards": 9.0, "stiffness": 6e5, "damping": 150.0,
    "load_inertia": 40.0, "load_viscous_forwards": 100.0, "load_coulomb_forwards": 12.0,
    "load_viscous_backwards": 120.0, "load_coulomb_backwards": 8.0, "offset": 0.0,
}  # fmt: skip
ASYMMETRIC = FlexibleJoint("prismatic", friction=AsymmetricFriction())
WINDUP = StateSpaceController(
    A=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    B={"reference": [0.02, 0.0, 0.0], "position": [-0.02, 1.0, 0.0], "excess": [1e-7, 0.0, 0.0]},
    C=[2e5, 3e6, 3e6],
    D={"reference": 8e5, "position": -8e5 - 6e6},
    limit=60.0,
)  # an integrator with anti-windup, and a velocity over two samples: three states


def driven(timing: Timing = Timing.HELD, tap: Tap = Tap.COMMAND) -> Record:
    return Record(
        torque=Channel(np.zeros(REFERENCE.size), "N", 1e-3, timing), tap=tap, reference=Channel(REFERENCE, "m", 1e-3)
    )


@pytest.mark.parametrize(
    ("controller", "names"),
    [
        (
            Cascade(position_gain=100.0, velocity_gain=7e3, velocity_filter=(0.5, 0.5)),
            ("position_gain", "velocity_gain", "gain", "delay"),
        ),
        (
            Cascade(position_gain=100.0, velocity_gain=7e3, limit=60.0),
            ("position_gain", "velocity_gain", "gain", "limit"),
        ),
        (Cascade(position_gain=60.0, velocity_gain=5e3, delay=1.4e-3), ("position_gain", "velocity_gain", "delay")),
        (
            Cascade(position_gain=80.0, velocity_gain=6e3, velocity_filter=DigitalFilter((0.4,), (1.0, -0.6))),
            ("position_gain", "velocity_gain"),
        ),
        (WINDUP, ("gain", "limit")),
    ],
)
def test_agree_for_the_loop_and_the_start(controller: Cascade, names: tuple[str, ...]) -> None:
    """Both frictions asymmetric; stuck, sliding, at its limit; from a start in motion."""
    loop, start = ClosedLoop(ASYMMETRIC, controller), Initial(1e-3, 0.02)
    record = driven()
    wanted = (*VALUES, "initial_position", "initial_velocity", *names)[:20]
    found = simulate_sensitivities(loop, prepare(loop, record), VALUES, wanted, start, positions=True)
    assert found.response.outcome is Outcome.FINISHED
    assert found.response.events > 10
    # Without positions most periods are followed in one step of their own.
    torque = simulate_sensitivities(loop, prepare(loop, record), VALUES, wanted, start).torque
    assert np.allclose(torque, found.torque, rtol=1e-9, atol=1e-9 * np.abs(found.torque).max(axis=0))
    for j, name in enumerate(wanted):
        size = (
            VALUES.get(name)
            or {"initial_position": 0.1, "initial_velocity": 0.1, "offset": 10.0, "delay": 1e-3}.get(name)
            or float(getattr(controller, name))
        )
        columns, step = (
            (found.torque[:, j], found.motor_position[:, j]),
            (1e-5 if name in ("delay", "damping") else 1e-6) * size,
        )
        back = 0.0 if name == "delay" else 1.0  # a delay of 0 is the shortest
        error = error_beside_differences(columns, loop, record, VALUES, name, (step,), start, back=back)
        assert error < (3e-4 if name == "damping" else 2e-4), name


def test_more_columns_than_the_kernel_follows_at_a_time_keep_their_order() -> None:
    loop = ClosedLoop(ASYMMETRIC, Cascade(position_gain=100.0, velocity_gain=7e3))
    experiment = prepare(loop, driven())
    names = ["velocity_gain", *VALUES, "initial_position", "delay", "position_gain", "initial_velocity", "gain"]
    together = simulate_sensitivities(loop, experiment, VALUES, names, positions=True)
    assert len(names) > 16
    for j, name in enumerate(names):
        alone = simulate_sensitivities(loop, experiment, VALUES, [name], positions=True)
        assert np.allclose(together.torque[:, [j]], alone.torque, rtol=1e-12, atol=1e-12 * np.abs(alone.torque).max())
        assert np.allclose(together.load_position[:, [j]], alone.load_position, rtol=1e-9, atol=1e-15)


def test_what_is_held_at_rest_forgets_the_velocity_it_was_to_begin_with() -> None:
    """Friction takes it at once, so it must not move what comes loose later; with positions and without."""
    loop = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=100.0, velocity_gain=2e3))
    experiment = prepare(loop, driven())
    values = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    slope = simulate_sensitivities(loop, experiment, values, ["initial_velocity"]).torque
    assert np.any(slope[0]) and not np.any(slope[5:])
    kept = simulate_sensitivities(loop, experiment, values, ["initial_velocity"], positions=True).torque
    assert np.allclose(slope, kept, rtol=1e-12, atol=1e-12 * np.abs(kept).max())


@pytest.mark.parametrize("delay", [0.3e-3, 1.25e-3])
def test_a_delay_moves_the_edges_in_an_averaged_measured_torque(delay: float) -> None:
    loop = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=60.0, velocity_gain=5e3, delay=delay))
    record = driven(Timing.AVERAGED, Tap.MEASURED)
    values = {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    found = simulate_sensitivities(loop, prepare(loop, record), values, ["delay", "inertia"])
    for j, name in enumerate(("delay", "inertia")):
        step = 1e-8 if name == "delay" else 1e-4
        back = 0.0 if name == "delay" else 1.0
        error = error_beside_differences((found.torque[:, j],), loop, record, values, name, (step,), back=back)
        assert error < 2e-4, name


def test_a_candidate_that_cannot_be_simulated_has_no_slope() -> None:
    unstable = ClosedLoop(TWIN.loop.joint, Cascade(position_gain=2e3, velocity_gain=1e6, delay=3e-3))
    found = simulate_sensitivities(unstable, prepare(unstable, TWIN.record), TWIN.truth, ["stiffness", "position_gain"])
    assert found.response.outcome is Outcome.DIVERGED
    assert not found.torque.any()


@pytest.mark.parametrize("gains", [(110.0, 0.0), (60.0, 4000.0)])  # one too large, one beyond all numbers
def test_an_unstable_loop_that_its_limit_holds_has_no_derivatives(gains: tuple[float, float]) -> None:
    """It swings from limit to limit for ever, and what a small change does grows with every swing."""
    law = Cascade(
        period=2e-3, gain=1.0, limit=200.0, position_gain=20.0, velocity_gain=gains[0], integral_gain=gains[1]
    )
    loop = ClosedLoop(RigidJoint("revolute"), law)
    record = Record(reference=Channel(trapezoids((1.0,), 5.0, 10.0, 2e-3, duration=20.0), "rad", 2e-3))
    values = {"inertia": 0.1, "viscous": 0.1, "coulomb": 0.5, "offset": 0.0}
    run = simulate_sensitivities(loop, prepare(loop, record), values, ["inertia"])
    assert run.response.outcome is Outcome.FINISHED
    assert np.abs(run.response.torque).max() == 200.0
    assert not run.torque.any()
