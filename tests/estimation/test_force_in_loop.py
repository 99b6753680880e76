"""A random force in the loop lets friction slide: the intervals have to hold what that moves."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import ignore_progress
from jointid.estimation.force_in_loop import find_force, widen_for_force
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.springs import visible
from jointid.models.controllers import Cascade
from jointid.paper.twin import twin
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import trapezoids
from jointid.simulation.start import INITIAL
from jointid.simulation.synthesis import simulated_record
from jointid.solvers.solve import LevenbergMarquardt, Solution, solve
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.position_dependent_error import Repeatable, Uncertainty, uncertainty
from tests.servos import Servo, servo

SUMS = ("inertia", "viscous", "coulomb")
RESTING = tuple(pytest.param(seed, marks=pytest.mark.slow) for seed in (5, 8, 14, 25))
"""Servos under forces of 1 to 6 % of the torque of their ramps: their Coulomb friction comes out 13 to 45 % small."""


def solved(axis: Servo) -> tuple[ji.Estimate, ClosedLoopProblem, Solution]:
    """Return the estimate of a servo that begins at rest, and where plain least squares ends beside it."""
    problem = torque_problem(axis.record, axis.loop, Filtering(), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    found = ji.identify(axis.record, axis.loop, checks=False)
    start = problem.vector({row.name: row.value or 0.0 for row in found.rows})
    return found, problem, solve(problem, LevenbergMarquardt(1e-7), start)


@pytest.mark.parametrize("seed", RESTING)
def test_a_force_is_found_and_intervals_hold_what_it_moves(seed: int) -> None:
    axis = servo(seed)
    estimate, problem, end = solved(axis)
    for row in (estimate["coulomb"], estimate["viscous"]):
        assert abs(row.value - axis.truth[row.name]) <= 2 * row.stderr
    assert len([note for note in estimate.notes if "force in the loop" in note]) == 1
    at, truth = [p.name for p in problem.free].index("coulomb"), axis.truth["coulomb"]
    before = end.x[at] - truth
    assert before < -0.1 * truth  # too little friction, without the force
    exact = Uncertainty(Covariance(np.zeros(end.x.size), np.eye(end.x.size)), Repeatable(0.0, 0.0, None))
    _, (there, force) = widen_for_force(exact, problem, end.x, -end.jacobian)
    assert abs(there[at] - truth) < 0.25 * abs(before)
    assert force.rms == pytest.approx(axis.force, rel=0.3)


@pytest.mark.slow
def test_neither_noise_on_the_log_nor_a_residual_of_nothing_is_a_force() -> None:
    axis = servo(9)
    assert axis.force == 0.0
    _, problem, end = solved(axis)
    run = problem.simulate(end.x)
    found = find_force(problem, end.x, run, problem.measured - run.torque)
    assert found is None or found.rms < 0.02 * float(np.std(problem.measured))
    assert find_force(problem, end.x, run, np.zeros(problem.measured.size)) is None


@pytest.mark.parametrize("noise", ["disturbance", "white"])
def test_an_axis_that_never_rests_is_not_moved(noise: str) -> None:
    """The twin's force is 8 % of its torque; friction never holds it, and its intervals stay as they are."""
    axis = twin("L19", noise=noise)  # type: ignore[arg-type]
    problem = torque_problem(axis.record, axis.loop, Filtering(cutoff=60.0), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    x = problem.vector({**axis.truth, "initial_position": 0.0})
    error, slopes = problem.linearise(x)
    known = uncertainty(Influence(slopes, error), problem.cells(problem.simulate(x)))
    assert widen_for_force(known, problem, x, -slopes) == (known, None)


@pytest.mark.slow
def test_sums_beside_a_refused_spring_hold_what_a_force_moves() -> None:
    """Without the force they were 6.7 and 3.8 deviations off."""
    axis = servo(5)
    loop = replace(axis.loop, joint=ji.FlexibleJoint("revolute"))
    half = {f"{side}_{name}": 0.5 * axis.truth[name] for side in ("motor", "load") for name in SUMS}
    problem = torque_problem(axis.record, loop, Filtering(), loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    start = dict.fromkeys(INITIAL, 0.0) | half | {"stiffness": 1e9, "damping": 0.0, "offset": axis.truth["offset"]}
    x = problem.vector(start)
    error, J = problem.linearise(x)
    known = uncertainty(Influence(J, error), problem.cells(problem.simulate(x)))
    found = visible(problem, x, J, known, (2, 2), ignore_progress, ())
    assert not found.shown
    for name in SUMS:
        assert abs(found.rigid[name] - axis.truth[name]) <= 2 * found.std[name]
    assert "force in the loop" in str(found.notes[0])


def test_a_log_far_slower_than_the_loop_shows_no_force() -> None:
    """The loop's crossover is at 160 Hz, and the log at 16 Hz: no frequency is left to look at."""
    axis, every = servo(25), 64
    truth = {"inertia": 0.1, "viscous": 0.2, "coulomb": 2.0, "offset": 0.3}
    loop = replace(axis.loop, controller=Cascade(position_gain=30.0, velocity_gain=100.0, period=1e-3))
    reference = trapezoids((1.0, 2.0, 3.0), 10.0, 1.5, 1e-3, rest=0.5, duration=12.0)
    whole = simulated_record(loop, reference, truth, sample_time=1e-3)
    slow = [
        ji.Channel(v[::every], unit, every * 1e-3) for v, unit in ((whole.torque.values, "N m"), (reference, "rad"))
    ]
    record = ji.Record(torque=slow[0], reference=slow[1])
    problem = torque_problem(record, loop, Filtering(), loop.joint.parameters)
    x = problem.vector(truth | dict.fromkeys(INITIAL, 0.0))
    assert find_force(problem, x, problem.simulate(x), problem.measured) is None
