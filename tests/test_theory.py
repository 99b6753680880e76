"""The numbers of docs/how-it-works.md hold for the code; (T..) are the equations of that page."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from jointid.common.arrays import FloatArray
from jointid.estimation.parameters import INITIAL_STATE
from jointid.estimation.problems.simulated import torque_problem
from jointid.models.controllers import POSITION
from jointid.paper.twin import CONTROLLERS, twin
from jointid.records.record import Channel, Timing
from jointid.records.signals.filtering import Filtering, apply_window, differentiate_twice, window_torque

T = 1e-3


def test_noise_of_an_inverted_law() -> None:
    law = CONTROLLERS["L19"].law(T)
    direct = law.D[0, 0, POSITION]
    inverse = law.A[0] - np.outer(law.B[0, :, POSITION], law.C[0, 0]) / direct
    assert np.max(np.abs(np.linalg.eigvals(inverse))) == pytest.approx(0.870, abs=5e-4)


def test_the_gain_of_the_decimation_and_the_weights_of_the_window() -> None:
    constant = Filtering(cutoff=60.0).resolve(T).decimate(np.ones(3000), T)
    assert constant[100] == pytest.approx(10 ** (-0.05 / 10), rel=1e-9)
    assert 1 / constant[100] - 1 == pytest.approx(0.0116, abs=5e-5)
    pulse = np.zeros(20)
    pulse[10] = 1.0

    def weights(timing: Timing) -> FloatArray:
        return window_torque(Channel(pulse, "N", T, timing))[7:14]

    assert np.allclose(8 * weights(Timing.HELD), [0, 0, 1, 3, 3, 1, 0])
    assert np.allclose(8 * weights(Timing.AVERAGED), [0, 1, 3, 3, 1, 0, 0])
    assert np.allclose(32 * weights(Timing.SAMPLED), [0, 1, 8, 14, 8, 1, 0])


def test_simpson_s_rule_and_the_differences_are_of_fourth_order() -> None:
    def errors(hertz: float) -> FloatArray:
        w = 2 * math.pi * hertz
        q = np.exp(1j * w * np.arange(400) * T)
        parts = [differentiate_twice(part, T) for part in (q.real, q.imag)]
        velocity, acceleration = (parts[0][i] + 1j * parts[1][i] for i in (0, 1))
        window = apply_window(q) / q / np.sinc(w * T / math.pi) ** 2
        columns = (window, velocity / (1j * w * q) * window, acceleration / (-(w**2) * q) * window)
        return np.array([column[200].real - 1 for column in columns])

    x = 2 * math.pi * 20.0 * T
    assert np.allclose(errors(20.0)[:2], [x**4 / 90, -(x**4) / 45], rtol=0.01)
    assert errors(40.0)[2] / errors(20.0)[2] == pytest.approx(64.0, rel=0.05)  # sixth order
    assert np.allclose(errors(60.0), [2.3e-4, -4.3e-4, 6.6e-6], rtol=0.02)


def test_the_inverse_model_s_deviations_are_not_those_of_the_torque() -> None:
    axis = twin("L19", noise="none")
    fixed = tuple(p.fix(0.0) for p in INITIAL_STATE)
    problem = torque_problem(axis.record, axis.loop, Filtering(cutoff=60.0), axis.loop.joint.parameters, fixed)
    truth = axis.truth
    x = problem.vector(truth)
    raw = problem.log.columns(*problem.run(x), problem.parameters.keys)[0]
    run = problem.simulate(x)
    columns = problem.loop.joint.regressor(run.motor, run.load)
    J, W = problem.filter(raw), np.concatenate([problem.filter(row) for row in columns])
    size = 0.08 * np.linalg.norm(problem.filter(problem.measured)) / math.sqrt(len(J))

    def covariance(M: FloatArray) -> FloatArray:
        norms = np.linalg.norm(M, axis=0)
        return np.asarray(size**2 * np.linalg.inv((M / norms).T @ (M / norms)) / np.outer(norms, norms))

    by_j, by_w = covariance(J), covariance(W)
    std_j, std_w = np.sqrt(np.diag(by_j)), np.sqrt(np.diag(by_w))
    fv1, fv2 = 1, 6
    assert by_j[fv1, fv2] / (std_j[fv1] * std_j[fv2]) == pytest.approx(-0.972, abs=6e-4)
    assert by_w[fv1, fv2] / (std_w[fv1] * std_w[fv2]) == pytest.approx(-0.03, abs=6e-3)
    assert 2 * norm.cdf(2 * std_w[fv1] / std_j[fv1]) - 1 == pytest.approx(0.37, abs=0.01)
