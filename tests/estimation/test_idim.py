"""The estimators of IDIM: what each is for, on the twin and on regressions made for it."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.problems.regression import Rows, solve_rows
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.paper.twin import twin
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from jointid.uncertainty.model_tests import durbin_wu_hausman
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER
from tests.estimation.motions import low_passed

SEEDS = range(1, 11)


def rejected(estimate: Estimate) -> bool:
    """Test whether the instruments speak against least squares."""
    return any(check.name == "instruments" and check.passed is False for check in estimate.checks)


def bias(estimates: list[Estimate], truth: dict[str, float], name: str) -> tuple[float, float]:
    """Return the mean relative error of an estimate, and the same in its own standard deviations."""
    found = np.array([estimate.values[name] / truth[name] - 1 for estimate in estimates])
    return float(found.mean()), float(found.mean() / (found.std(ddof=1) / np.sqrt(found.size)))


@pytest.mark.slow
def test_instruments_remove_the_bias_of_a_disturbance_in_the_loop() -> None:
    axes = [twin("L30", seed=seed) for seed in SEEDS]
    plain = [identify(axis.record, axis.loop, IDIM()) for axis in axes]
    instrumented = [identify(axis.record, axis.loop, IDIM("iv")) for axis in axes]
    truth = axes[0].truth
    off, significance = bias(plain, truth, "motor_inertia")
    assert off == pytest.approx(0.010, abs=0.002)
    assert abs(significance) > 6
    for name in truth:
        assert abs(bias(instrumented, truth, name)[1]) <= 3.5, name  # 3.5 of t with 9 degrees of freedom: 0.7 %
    assert abs(bias(instrumented, truth, "motor_inertia")[0]) < 0.002
    assert all(map(rejected, instrumented))
    assert all(estimate.fit.converged and estimate.fit.simulations <= 6 for estimate in instrumented)
    inside = [
        abs(estimate.values[p.name] - truth[p.name]) <= 2 * float(p.stderr or 0.0)
        for estimate in instrumented
        for p in estimate.rows
    ]
    assert np.mean(inside) >= 0.85


@pytest.mark.slow
def test_instruments_on_a_rigid_axis() -> None:
    loop = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
    truth = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
    motion = trapezoids((0.042, 0.083, 0.125), 0.83, 0.1, 1e-3, duration=8.0)
    plain, instrumented = [], []
    for seed in SEEDS:
        force = 60.0 * np.random.default_rng(seed).standard_normal(motion.size)
        made = simulated_record(loop, motion, truth, sample_time=1e-3, disturbance=force)
        plain.append(identify(made, loop, IDIM()))
        instrumented.append(identify(made, loop, IDIM("iv")))
    assert abs(bias(plain, truth, "inertia")[1]) > 6
    assert all(abs(bias(instrumented, truth, name)[1]) <= 3.5 for name in truth)
    assert all(map(rejected, instrumented))
    assert instrumented[0].data.channels == ("torque", "reference", "motor_position")


@pytest.mark.slow
def test_noise_on_the_log_alone_raises_no_alarm() -> None:
    axes = (twin("L30", noise="white", seed=seed) for seed in range(1, 41))
    alarms = [rejected(identify(axis.record, axis.loop, IDIM("iv"))) for axis in axes]
    assert np.mean(alarms) <= 0.1


@pytest.mark.parametrize(("share", "lowest", "highest"), [(0.0, 0.0, 0.08), (0.6, 0.95, 1.0)])
def test_the_test_of_endogeneity_keeps_its_level_and_has_power(share: float, lowest: float, highest: float) -> None:
    """Errors and columns are correlated from row to row, as the low-pass makes them; `share` also with each other."""
    random, rejected = np.random.default_rng(5), 0
    for _ in range(200):
        Z = np.column_stack([low_passed(random, 800), np.ones(800)])
        error = low_passed(random, 800)
        W = Z + np.column_stack([share * error + (1 - share) * low_passed(random, 800), np.zeros(800)])
        rejected += durbin_wu_hausman(W, W @ [2.0, 1.0] + error, Z) < 0.05
    assert lowest <= rejected / 200 <= highest
    assert durbin_wu_hausman(W, W @ [2.0, 1.0] + error, 3.0 * W) == 1.0, "the columns themselves say nothing"


def test_the_solution_by_instruments_solves_its_equation() -> None:
    random = np.random.default_rng(7)
    Z = random.normal(size=(2000, 2))
    error = random.normal(size=2000)
    W = Z + 0.5 * error[:, np.newaxis]
    rows = Rows(W @ [3.0, -1.0] + error, W, ("a", "b"), 1)
    found, plain = solve_rows(rows, "iv", {}, lambda _: Z), solve_rows(rows, "ols", {})
    assert np.abs(Z.T @ found.residual).max() <= 1e-8
    assert np.all(np.abs(found.values - [3.0, -1.0]) <= 3 * found.covariance.std)
    assert np.all(np.abs(plain.values - [3.0, -1.0]) > 5 * plain.covariance.std)


def two_equations() -> Rows:
    """Return two driven equations, one of which is a hundred times as noisy as the other."""
    random = np.random.default_rng(8)
    W, noise = random.normal(size=(4000, 2)), random.normal(size=4000)
    noise[:2000] *= 100.0
    return Rows(W @ [3.0, -1.0] + noise, W, ("a", "b"), 2, 2)


def test_weights_are_settled_and_help() -> None:
    plain, balanced = (solve_rows(two_equations(), each, {}) for each in ("ols", "weighted"))  # type: ignore[arg-type]
    assert np.all(balanced.covariance.std < 0.1 * plain.covariance.std)
    assert np.all(np.abs(balanced.values - [3.0, -1.0]) < 3.0 * balanced.covariance.std)
    assert balanced.converged
    assert not solve_rows(two_equations(), "weighted", {}, turns=1).converged


def at_rest(dwell: float) -> tuple[Record, dict[str, float]]:
    """A turning axis that rests at the ends of its strokes, its encoder coarse."""
    reference = trapezoids([0.3, 0.8, 1.5], 8.0, 1.0, 1e-3, dwell, 12.0)
    values = {"inertia": 2e-3, "viscous": 4e-3, "coulomb": 0.029, "offset": 0.004}
    law = Cascade(position_gain=40.0, velocity_gain=0.3, integral_gain=20.0)
    noise = 2e-3 * np.random.default_rng(1).standard_normal(reference.size)
    loop = ClosedLoop(RigidJoint("revolute"), law)
    step = 2 * np.pi / 2**17
    record = simulated_record(loop, reference, values, sample_time=1e-3, torque_noise=noise, encoder_step=step)
    return record, values


def test_rows_at_rest_are_left_out() -> None:
    record, values = at_rest(0.6)
    found = identify(record, RigidJoint("revolute"), IDIM())
    for name, value in values.items():
        line = found[name]
        assert abs(line.value - value) < 3 * line.stderr, name
    assert found["coulomb"].stderr is not None and found["coulomb"].stderr < 0.015 * values["coulomb"]


def test_records_without_a_controller_share_all_and_are_not_the_same() -> None:
    record, joint = at_rest(0.6)[0], RigidJoint("revolute")
    halves = [cut(record, *span) for span in ((0, 2000), (2000, 4000))]
    for wrong in ({"several": {"own": ((), ("coulomb",))}}, {"windows": 3.0}, None):
        with pytest.raises(MethodError):
            identify([record, record] if wrong is None else halves, joint, IDIM(), **(wrong or {}))


@pytest.mark.parametrize("stated", [True, False])  # the timing of the torque, whose column is beside that of the zeros
def test_the_difference_of_two_encoders_zeros_is_found(stated: bool) -> None:
    axis, off = twin(noise="none"), 2e-4
    load, torque = axis.record.load_position, replace(axis.record.torque, stated=stated)
    moved = axis.record.with_channels({"load_position": replace(load, values=load.values + off), "torque": torque})
    plain = identify(axis.record, axis.loop.joint, IDIM())
    found = identify(moved, axis.loop.joint, IDIM())
    assert [row.name for row in found.rows].count("encoder_offset") == 1
    assert found["stiffness"].value == pytest.approx(plain["stiffness"].value, rel=1e-3)
    assert found["encoder_offset"].value == pytest.approx(-off * (found["stiffness"].value or 0.0), rel=0.02)
