"""A second solution of the same equations: how far it lies away, and intervals that are wide enough for it."""

import numpy as np
import pytest
from scipy.signal import lfilter

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.estimation.problems.simulated import torque_problem
from jointid.models.controllers import Cascade
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record
from jointid.solvers.solve import LevenbergMarquardt, solve
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.model_tests import second_solution, widened_to_second
from jointid.uncertainty.position_dependent_error import Uncertainty, cells, uncertainty

TRUTH = np.array([2.0, 3e4])
PLACES = cells(np.sin(np.arange(2000) / 50), np.cos(np.arange(2000) / 50))


def equations(lack: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return instruments, sensitivities and torque; a part of it that no column has is in the instruments of one."""
    random = np.random.default_rng(3)
    J, lacks = random.standard_normal((2000, 2)) / [1.0, 1e4], random.standard_normal(2000)
    Z = J + 0.3 * lacks[:, np.newaxis] * [1.0, 0.0]
    return Z, J, J @ TRUTH + lack * lacks + 0.5 * random.standard_normal(2000)


def by_instruments(Z: FloatArray, J: FloatArray, torque: FloatArray) -> FloatArray:
    return np.linalg.solve(Z.T @ J, Z.T @ torque)


def judged(lack: float) -> tuple[FloatArray, FloatArray, FloatArray, Uncertainty]:
    Z, J, torque = equations(lack)
    error = torque - J @ by_instruments(J, J, torque)
    return Z, J, error, uncertainty(Influence(J, error), PLACES)


def test_of_linear_equations_the_step_ends_at_the_other_solution() -> None:
    Z, J, torque = equations(1.0)
    least = by_instruments(J, J, torque)
    step, _ = second_solution(Z, Influence(J, torque - J @ least))
    assert least + step == pytest.approx(by_instruments(Z, J, torque))


def test_the_deviation_is_what_noise_makes_of_the_step() -> None:
    Z, J, _ = equations(0.0)
    random = np.random.default_rng(5)
    steps, told = [], []
    for _ in range(100):
        torque = J @ TRUTH + random.standard_normal(2000)
        steps.append(by_instruments(Z, J, torque) - by_instruments(J, J, torque))
        told.append(second_solution(Z, Influence(J, torque - J @ by_instruments(J, J, torque)))[1].std)
    assert np.std(steps, axis=0) == pytest.approx(np.mean(told, axis=0), rel=0.3)


def test_what_a_model_lacks_widens_the_parameter_that_it_moves() -> None:
    Z, J, error, known = judged(1.0)
    wide = widened_to_second(known, Z, J, error, np.array([True, True]))
    (shift, _), _ = second_solution(Z, Influence(J, error))
    assert abs(shift) > 5 * known.covariance.std[0]
    assert wide.covariance.std[0] == pytest.approx(np.hypot(known.covariance.std[0], shift))
    assert wide.covariance.std[1] == pytest.approx(known.covariance.std[1], rel=0.02)


@pytest.mark.parametrize(("lack", "inside"), [(0.0, [True, True]), (1.0, [False, True]), (1.0, [False, False])])
def test_neither_a_true_model_nor_a_parameter_at_its_bound_widens_anything(lack: float, inside: list[bool]) -> None:
    Z, J, error, known = judged(lack)
    assert widened_to_second(known, Z, J, error, np.array(inside)) is known


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["torque_noise", "disturbance"])
def test_a_right_model_leaves_a_step_of_the_size_that_noise_makes(kind: str) -> None:
    """Of a simulated axis, under white noise on the log and under a coloured force in the loop."""
    truth = {"inertia": 0.1, "viscous": 0.2, "coulomb": 0.5, "offset": 0.1}
    law = Cascade(position_gain=20.0, velocity_gain=6.0, integral_gain=30.0, period=1e-3)
    loop, steps = ji.ClosedLoop(ji.RigidJoint(kind="revolute"), law), []
    time = np.arange(4000) * 1e-3
    reference = 0.3 * np.sin(7.0 * time) + 0.2 * np.sin(19.0 * time + 1.0) - 0.2 * np.sin(1.0)
    for seed in range(40):
        noise = np.random.default_rng(seed).standard_normal(time.size)
        noise = lfilter([1.0], [1.0, -0.95], noise) if kind == "disturbance" else noise
        record = simulated_record(loop, reference, truth, sample_time=1e-3, **{kind: 0.05 * noise / noise.std()})
        problem = torque_problem(record, loop, Filtering(), loop.joint.parameters)
        start = problem.vector(truth | {"initial_position": 0.0, "initial_velocity": 10.0, "initial_torque": 0.0})
        end = solve(problem, LevenbergMarquardt(1e-8), start)
        J, W = -end.jacobian, problem.filter(loop.joint.regressor(problem.simulate(end.x).motor)[0])
        step, deviation = second_solution(np.hstack([W, J[:, 4:]]), Influence(J, end.residual))
        steps.append((step / deviation.std)[:4])
    size = np.sqrt(np.mean(np.square(steps), axis=0))
    assert np.all((size > 0.5) & (size < 1.3)), size
    assert np.mean(np.abs(steps) > 2.0) <= 0.08
