"""The formulas and numbers of docs/how-it-works.md hold for the code; (T..) are the equations of that page."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import norm

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.models.controllers import POSITION, SampledLaw
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.paper.twin import CONTROLLERS, TABLE_2, twin
from jointid.records.record import Channel, Timing
from jointid.records.signals.filtering import Filtering, apply_window, differentiate_twice, window_torque
from jointid.simulation.closed_loop import Initial
from jointid.simulation.synthesis import simulated_record
from jointid.uncertainty.covariance import Influence, bandwidth, white

T = 1e-3
RIGID = {"inertia": 105.0, "viscous": 202.0, "coulomb": 20.4, "offset": -3.16}
P = TABLE_2
RHO_PER_W2 = P["load_inertia"] / P["stiffness"]


def feedback(law: SampledLaw, w: float) -> complex:
    """C of (T12) without the delay."""
    z = np.exp(1j * w * T)
    back = law.C[0, 0] @ np.linalg.solve(z * np.eye(law.order) - law.A[0], law.B[0, :, POSITION])
    return complex(-(back + law.D[0, 0, POSITION]))


def held(w: float) -> complex:
    return complex((1 - np.exp(-1j * w * T)) / (1j * w * T))


class Sinusoid:
    """A joint that always moves forwards, with one frequency on top: amplitudes of everything, in steady state."""

    def __init__(self, joint: Joint, truth: dict[str, float], hertz: float, loop_name: str) -> None:
        self.w = 2 * math.pi * hertz
        time = np.arange(4000) * T
        loop = ClosedLoop(joint, CONTROLLERS[loop_name])
        reference = 0.05 * time + 0.02 / self.w * np.sin(self.w * time)
        made = simulated_record(loop, reference, truth, sample_time=T, initial=Initial(0.0, 0.07))
        initial = (INITIAL_STATE[0].fix(0.0), INITIAL_STATE[1].fix(0.07))
        problem = torque_problem(made, loop, Filtering(), joint.parameters, initial)
        x = problem.vector(truth)
        _, jacobian = problem.sensitivities(x)
        run = problem.simulate(x)
        late = time >= 2.0
        assert np.min(run.motor_velocity[late]) > 0.0

        def amplitude(values: FloatArray) -> complex:
            at = time[late]
            basis = np.column_stack([np.cos(self.w * at), -np.sin(self.w * at), np.ones_like(at), at])
            found = np.linalg.lstsq(basis, values[late])[0]
            return complex(found[0], found[1])

        law = loop.controller.law(T)
        self.s = 1j * self.w
        self.late = np.exp(-self.s * law.delay)
        self.feedback = feedback(law, self.w)
        self.J = np.array([amplitude(column) for column in jacobian.T])
        self.torque = amplitude(run.torque) * held(self.w) * self.late
        self.velocity = self.s * amplitude(run.motor_position)
        self.load_velocity = 0j if run.load_position is None else self.s * amplitude(run.load_position)

    def sensitivity(self, plant: complex) -> complex:
        """S of (T11)."""
        return complex(1 / (1 + self.feedback * plant * held(self.w) * self.late))

    def predicted(self, plant: complex, W: list[complex]) -> FloatArray:
        """(T12): the logged torque's part of T W."""
        return np.asarray(self.feedback * plant * self.sensitivity(plant) * np.array(W))


@pytest.mark.parametrize(("hertz", "away"), [(5.0, 0.080), (20.0, 1.66)])
def test_the_jacobian_of_a_rigid_joint_is_t_w(hertz: float, away: float) -> None:
    motion = Sinusoid(RigidJoint("prismatic"), RIGID, hertz, "L19")
    plant = 1 / (RIGID["inertia"] * motion.s**2 + RIGID["viscous"] * motion.s)
    expected = motion.predicted(plant, [motion.s * motion.velocity, motion.velocity])
    assert np.allclose(motion.J[:2], expected, rtol=1e-5, atol=0.0)
    assert abs(motion.sensitivity(plant)) == pytest.approx(away, rel=0.01)


@pytest.mark.parametrize(("hertz", "loop"), [(5.0, "L19"), (10.0, "L19"), (20.0, "L19"), (28.0, "L19"), (10.0, "L30")])
def test_the_jacobian_of_a_flexible_joint_is_t_of_both_rows(hertz: float, loop: str) -> None:
    motion = Sinusoid(FlexibleJoint("prismatic"), dict(P), hertz, loop)
    s, v1, v12 = motion.s, motion.velocity, motion.load_velocity
    q2 = (v12 - v1) / s
    z12 = P["damping"] * s + P["stiffness"]
    z11 = P["motor_inertia"] * s**2 + (P["motor_viscous"] + P["damping"]) * s + P["stiffness"]
    z22 = P["load_inertia"] * s**2 + (P["load_viscous"] + P["damping"]) * s + P["stiffness"]
    H = z12 / z22
    assert v12 / v1 == pytest.approx(H, rel=1e-5)
    both = [s * v1, v1, 0j, (H - 1) * q2, (H - 1) * s * q2, H * s * v12, H * v12]
    expected = motion.predicted(1 / (z11 - z12**2 / z22), both)
    moving = [0, 1, 3, 5, 6]
    assert np.allclose(motion.J[moving], expected[moving], rtol=1e-4, atol=0.0)
    assert motion.J[4] == pytest.approx(expected[4], rel=1e-3)


def test_the_apparent_mass_and_drag_below_resonance() -> None:
    motion = Sinusoid(FlexibleJoint("prismatic"), dict(P), 5.0, "L19")
    impedance = motion.torque / motion.velocity
    rho = motion.w**2 * RHO_PER_W2
    mass = P["motor_inertia"] + P["load_inertia"] / (1 - rho)
    drag = P["motor_viscous"] + P["load_viscous"] / (1 - rho) ** 2 + P["damping"] * (rho / (1 - rho)) ** 2
    assert impedance.imag / motion.w == pytest.approx(mass, rel=3e-4)
    assert impedance.real == pytest.approx(drag, rel=1e-4)


def test_the_frequencies_are_the_pole_and_the_zero_of_the_apparent_mass() -> None:
    hertz = FlexibleJoint.frequencies(P)
    shown = {"free_free": 29.51, "motor_locked": 24.13, "load_locked": 16.99}
    assert all(hertz[name] == pytest.approx(value, abs=0.005) for name, value in shown.items())
    assert (2 * math.pi * hertz["motor_locked"]) ** 2 * RHO_PER_W2 == pytest.approx(1.0)
    rho = (2 * math.pi * hertz["free_free"]) ** 2 * RHO_PER_W2
    assert P["motor_inertia"] + P["load_inertia"] / (1 - rho) == pytest.approx(0.0, abs=1e-9)


def test_noise_of_an_inverted_law() -> None:
    law = CONTROLLERS["L19"].law(T)
    direct = law.D[0, 0, POSITION]
    inverse = law.A[0] - np.outer(law.B[0, :, POSITION], law.C[0, 0]) / direct
    assert np.max(np.abs(np.linalg.eigvals(inverse))) == pytest.approx(0.870, abs=5e-4)


@pytest.mark.parametrize("hertz", [10.0, 60.0])
def test_the_chord_bound(hertz: float) -> None:
    """(T9) on the motion itself, both masses sliding under a held torque."""
    M1, M2, K = P["motor_inertia"], P["load_inertia"], 10 * P["stiffness"]
    f1, f2, F = P["motor_viscous"], P["load_viscous"], 10 * P["damping"]
    A = np.zeros((4, 4))  # motor velocity, stretch, load velocity, 1
    A[0] = [-(f1 + F) / M1, K / M1, F / M1, 100.0 / M1]
    A[1] = [-1.0, 0.0, 1.0, 0.0]
    A[2] = [F / M2, -K / M2, -(f2 + F) / M2, -P["load_coulomb"] / M2]
    h, t = 1 / hertz / 20, np.linspace(0.0, 1.0, 51)
    for state in np.random.default_rng(0).normal(size=(20, 3)):
        x = np.array([expm(A * h * at) @ [state[0], 1e-4 * state[1], state[2], 1.0] for at in t])
        rates = x @ A.T
        energy = M1 * rates[:, 0] ** 2 + M2 * rates[:, 2] ** 2 + K * rates[:, 1] ** 2
        assert np.all(np.diff(energy) <= 0.0)
        shared = math.sqrt(K) + F * (M1**-0.5 + M2**-0.5)
        for v, b in ((x[:, 0], (f1 / M1**0.5 + shared) / M1), (x[:, 2], (f2 / M2**0.5 + shared) / M2)):
            bend = np.max(np.abs(v - (v[0] * (1 - t) + v[-1] * t)))
            assert bend <= h**2 / 8 * b * math.sqrt(energy[0])


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


def test_the_covariance_is_the_inverse_model_s_where_all_three_are_one() -> None:
    rng = np.random.default_rng(1)
    W = rng.normal(size=(20000, 3)) @ np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 2.0]])
    residual = rng.normal(size=len(W))
    assert np.allclose(Influence(W, residual).by_time().std, white(W, residual).std, rtol=0.05)
    assert bandwidth(4000) == 10


def test_the_inverse_model_s_deviations_are_not_those_of_the_torque() -> None:
    axis = twin("L19", noise="none")
    fixed = tuple(p.fix(0.0) for p in INITIAL_STATE)
    problem = torque_problem(axis.record, axis.loop, Filtering(cutoff=60.0), axis.loop.joint.parameters, fixed)
    truth = axis.truth
    x = problem.vector(truth)
    _, raw = problem.sensitivities(x)
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
