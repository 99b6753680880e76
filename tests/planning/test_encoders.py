"""What encoders are predicted to add to a torque is what they add."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.diagnostics.intervals import weights_of
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import invert
from jointid.paper.twin import Twin, twin
from jointid.planning.encoders import add_information, encoder_information, subtract_driven_motion
from jointid.planning.predict import rebuild_declared_problem
from jointid.records.checks import find_encoder_step
from jointid.records.record import Channel

STEP = 2.5e-7  # m, of an encoder as coarse as many


@pytest.fixture(scope="module")
def disturbed(identified: Callable[..., Estimate]) -> tuple[Twin, Estimate]:
    """The twin with a force in its loop, the log being what the controller put out."""
    return twin("L19", seed=3), identified("L19", noise="disturbance", seed=3)


@pytest.fixture(scope="module")
def logged(identified: Callable[..., Estimate]) -> tuple[Twin, Estimate]:
    """The twin with noise on its log alone."""
    return twin("L30", noise="white", seed=3), identified("L30", noise="white", seed=3)


def test_the_law_makes_of_the_torque_what_the_encoder_would_tell(disturbed: tuple[Twin, Estimate]) -> None:
    """Why it adds nothing: turned round, the law gives the position's sensitivity back from the torque's.

    And why a load encoder tells nothing of the motor's side: its motion explains the load's but for the reversals.
    """
    axis, estimate = disturbed
    problem, x = rebuild_declared_problem(estimate, axis.record)
    law, seen = problem.experiment.law, problem.positions(x)
    motor, load = seen.motor_position, seen.load_position
    alone = subtract_driven_motion(problem, x, motor, load)
    for j, p in enumerate(problem.free_joint):
        nothing = np.zeros_like(problem.experiment.inputs)
        back = invert(law, seen.torque[:, j].copy(), nothing, np.zeros(law.order))
        assert np.linalg.norm(back - motor[:, j]) <= 1e-6 * np.linalg.norm(motor[:, j]), p.name
        if p.name.startswith("motor_") or p.name == "offset":
            assert np.linalg.norm(alone[:, j]) <= 0.05 * np.linalg.norm(load[:, j]), p.name


def test_a_motor_encoder_does_what_is_predicted_of_it(logged: tuple[Twin, Estimate]) -> None:
    """Least squares of torque and motor position, each by its own noise, one step from the truth."""
    axis, estimate = logged
    problem, _ = rebuild_declared_problem(estimate, axis.record)
    truth = problem.vector({**axis.truth, "initial_position": 0.0})
    error, J = problem.linearise(truth)
    variance = float(error @ error) / error.size
    spread = np.linalg.inv(J.T @ J) * variance
    added = encoder_information(problem, truth, "log", (STEP, None))
    predicted = np.sqrt(np.diag(add_information(spread, added)))
    seen = problem.positions(truth).motor_position
    seen = (seen - seen.mean(axis=0)) / np.sqrt(STEP**2 / 12)
    stacked = np.concatenate([J / np.sqrt(variance), seen])
    names = [p.name for p in problem.free]

    def estimated(seed: int) -> FloatArray:
        rng = np.random.default_rng(seed)
        noise = problem.filter(axis.noise * rng.standard_normal(len(seen))) / np.sqrt(variance)
        rounding = rng.uniform(-1, 1, len(seen)) * np.sqrt(3)
        return np.asarray(np.linalg.lstsq(stacked, np.concatenate([noise, rounding]), rcond=None)[0])

    scatter = np.sqrt(np.mean([estimated(seed) ** 2 for seed in range(40)], axis=0))
    for name in ("motor_inertia", "motor_viscous", "stiffness", "load_viscous", "offset"):
        at = names.index(name)
        assert scatter[at] == pytest.approx(predicted[at], rel=0.35), name


def test_information_adds_to_a_covariance_that_may_be_singular() -> None:
    rng = np.random.default_rng(0)
    A, B = rng.standard_normal((2, 4, 4))
    covariance, information = A @ A.T, B @ B.T
    direct = np.linalg.inv(np.linalg.inv(covariance) + information)
    assert add_information(covariance, information) == pytest.approx(direct)
    singular = np.ones((2, 2))  # two parameters of which only one direction is not known exactly
    assert add_information(singular, np.diag([3.0, 0.0])) == pytest.approx(singular / 4)


def test_the_step_of_an_encoder_is_read_off_its_positions() -> None:
    smooth = 0.1 * np.sin(np.arange(2000) / 300)
    for step in (5e-8, 1e-5):
        rounded = Channel(np.round(smooth / step) * step, "m", 1e-3)
        assert find_encoder_step(rounded) == pytest.approx(step, rel=1e-3)
    assert find_encoder_step(Channel(smooth, "m", 1e-3)) is None
    assert find_encoder_step(Channel(np.zeros(10), "m", 1e-3)) is None
    assert find_encoder_step(None) is None


def test_a_name_with_a_hyphen_is_one_parameter() -> None:
    assert weights_of("inertia head-pan - coulomb head-pan") == {"inertia head-pan": 1.0, "coulomb head-pan": -1.0}
