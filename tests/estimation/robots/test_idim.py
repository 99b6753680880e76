"""IDIM of a robot: recovery, weights, intervals, and an estimate held beside the nominal model."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.diagnostics.validation import Prediction, validate
from jointid.estimation.methods.idim import IDIM, simulate_columns
from jointid.estimation.parameters import robot_parameters
from jointid.estimation.problems.inverse_model import inverse_of_robot
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.bodies import consistent_robot
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import Numbers
from jointid.simulation.synthesis import simulate
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.robots.twin import VISCOUS, arm, axis_errors, by_idim, identified, records_of
from tests.estimation.test_log import LOOP, rigid
from tests.robots_plants import two

ARM = arm()


def truth(part: Any, robot: Robot = ARM) -> np.ndarray:
    values = part.parameters_of(robot)
    assert values is not None
    return values


def known(estimate: Estimate) -> set[str]:
    """Return the names of the parameters that are known to a tenth."""
    rows = estimate.rows
    return {row.name for row in rows if row.value and row.stderr and row.stderr < 0.1 * abs(row.value)}


def test_without_noise_all_parameters_come_back() -> None:
    estimate = identified(ARM, records_of(ARM, 1))
    found = estimate.robot
    assert np.abs(found.values - truth(found)).max() < 2e-2  # of numbers up to 10: reversals are filtered
    assert np.all(axis_errors(estimate) < 2e-3)
    assert [estimate[f"joint{k}.viscous"].value for k in range(1, 7)] == pytest.approx(VISCOUS, rel=5e-3)
    assert [estimate[f"joint{k}.viscous"].axis for k in range(1, 7)] == list(ARM.names)
    assert estimate.fit.predicted.shape == estimate.fit.measured.shape == estimate.residual.shape
    assert estimate.fit.relative_error < 0.05  # with the samples at rest and about reversals


@pytest.mark.slow
def test_intervals_hold_the_truth_and_weights_help_the_wrist() -> None:
    records = records_of(ARM, 2, noise=1.0)
    found = by_idim(ARM, records)
    assert np.mean(np.abs(found.values - truth(found)) < 2 * found.covariance.std) > 0.85
    plain = by_idim(ARM, records, IDIM("ols"))
    last = [i for i, name in enumerate(found.names) if name.endswith("6")]
    assert np.mean(found.covariance.std[last] / plain.covariance.std[last]) < 0.6


def test_friction_by_direction_and_towards_standstill_comes_back() -> None:
    """Of a motor whose friction is another backwards, and of one whose friction rises: what is declared is found."""
    loop = two().loop()
    first, second = loop.robot.joints
    declared = replace(
        loop.robot,
        joints=(
            replace(first, viscous_backwards=1.4 * first.viscous, coulomb_backwards=0.7 * first.coulomb),
            replace(second, stribeck_force=0.6 * second.coulomb, stribeck_speed=0.15),
        ),
    )
    records, _ = recorded(RobotLoop(declared, loop.controllers), two().records(10.0), 0.01)
    estimate = identified(declared, records)
    found = estimate.robot
    other = {f"joint{name}" for name in ("1.viscous_forwards", "1.viscous_backwards", "1.coulomb", "2.stribeck_force")}
    frictions = {name for name in found.names if ".visc" in name or ".coul" in name or ".strib" in name}
    assert frictions == other | {"joint2.viscous", "joint2.coulomb"}
    off = (found.values - truth(found, declared)) / estimate.covariance_of(found.names).std
    assert np.max(np.abs(off)) < 4.0 and np.mean(np.abs(off) < 2.0) > 0.8
    assert other <= known(estimate)
    assert max(axis_errors(estimate)) < 0.02
    # Neither is in a model that does not declare it, and it leaves more of the torque.
    plain = identified(loop.robot, records)
    assert np.all(axis_errors(plain) > 1.5 * axis_errors(estimate))
    bodies = consistent_robot(estimate).robot.joints
    assert bodies[0].viscous_backwards == pytest.approx(1.4 * first.viscous, rel=0.05)
    assert bodies[1].stribeck_force == pytest.approx(0.6 * second.coulomb, rel=0.1)


def test_a_rise_of_friction_that_the_record_does_not_reach_is_not_known() -> None:
    """Its column is next to nothing, and what multiplies it would be anything; a value of it is kept."""
    loop = two().loop()
    records, _ = recorded(loop, two().records(4.0), 0.01)
    first, second = loop.robot.joints
    declared = replace(loop.robot, joints=(first, replace(second, stribeck_force=1.0, stribeck_speed=0.002)))
    assert "joint2.stribeck_force" not in known(identified(declared, records))
    rise = Parameter("stribeck_force", "Fs", Quantity.FORCE).fix(0.5)
    found = identified(declared, records, parameters={"joint2.stribeck_force": rise})
    assert found["joint2.stribeck_force"].value == 0.5 and not found["joint2.stribeck_force"].free


@pytest.mark.slow
def test_intervals_hold_where_there_is_little_noise() -> None:
    """Samples about reversals are left out: with them hardly any interval of a Coulomb friction would hold."""
    off = []
    for seed in range(10, 14):
        found = by_idim(ARM, records_of(ARM, seed, noise=0.01))
        off.append((found.values - truth(found)) / found.covariance.std)
    inside = np.abs(off) < 2
    assert 0.91 < np.mean(inside) < 0.998  # they are widened for a force in the loop, which is not in this record
    for number in ("viscous", "coulomb"):
        assert np.mean(inside[:, [name.endswith(number) for name in found.names]]) > 0.85


def test_an_estimate_is_held_beside_the_nominal_model() -> None:
    nominal = replace(ARM, links=tuple(replace(one, inertial=1.2 * one.inertial) for one in ARM.links))
    estimate = identified(nominal, records_of(ARM, 2, noise=0.5))
    held_out = validate(estimate, records_of(ARM, 9, noise=0.5))
    one, two = records_of(ARM, 9)[:2]
    for asked in ((one,), (one, two)):
        with pytest.raises(MethodError):
            validate(estimate, asked[0] if len(asked) == 1 else asked)
    assert held_out.filtered_error < held_out.nominal_error and held_out.answer.code is Prediction.PREDICTED
    for axis in held_out.axes[:3]:
        assert axis.nominal_error is not None and axis.filtered_error < axis.nominal_error


@pytest.mark.parametrize("estimator", ["ols", pytest.param("weighted", marks=pytest.mark.slow)])
def test_a_parameter_that_is_known_is_kept_and_helps_the_others(estimator: Literal["ols", "weighted"]) -> None:
    records = records_of(ARM, 2, noise=0.5)
    free = by_idim(ARM, records, IDIM(estimator))
    viscous = Parameter("viscous", "Fv", Quantity.VISCOUS).fix(VISCOUS[3])
    estimate = identified(ARM, records, IDIM(estimator), parameters={"joint4.viscous": viscous})
    kept, spread = estimate.require_robot(), estimate.covariance_of([*estimate.parameters]).std
    at, beside = free.names.index("joint4.viscous"), free.names.index("joint4.coulomb")
    assert kept.values[at] == VISCOUS[3] != free.values[at]
    assert spread[at] == 0
    assert spread[beside] < 0.8 * free.covariance.std[beside]
    assert consistent_robot(estimate).robot.joints[3].viscous == pytest.approx(VISCOUS[3], rel=1e-3)


def noisy(seed: int) -> tuple[RobotLoop, tuple[Record, ...]]:
    """Return two joints under their controllers, and what their drives log of positions with much noise."""
    twin = two()
    loop, random = twin.loop(), np.random.default_rng(seed)
    made = []
    for record in recorded(loop, twin.records(8.0, seed=seed), 0.03, seed)[0]:
        seen = record.motor_position.values
        seen = seen + random.normal(0.0, 2e-4, seen.size)
        made.append(replace(record, motor_position=replace(record.motor_position, values=seen)))
    return loop, tuple(made)


def test_instruments_begin_in_motion_where_the_loop_does() -> None:
    loop = replace(two().loop(), in_motion=True)
    driven = [cut(one, 2000, 6000) for one in two().records(6.0)]
    records = simulate(loop, driven).records(driven)
    parameters = robot_parameters(loop.robot, whole=False)
    inverse = inverse_of_robot(loop.robot, parameters)
    motion = inverse.measure(records, Filtering())
    measured = inverse.rows([motion]).W
    made = simulate_columns(inverse, loop, [records], [motion])(parameters.group(Numbers.of(loop.robot)))
    assert np.linalg.norm(made - measured) < 1e-3 * np.linalg.norm(measured)


@pytest.mark.slow
def test_instruments_from_the_loop_are_free_of_the_positions_noise() -> None:
    """Positions that are noisy bias least squares, all one way, within their interval; instruments they do not."""
    found: dict[str, list[np.ndarray]] = {"weighted": [], "iv": []}
    for seed in range(1, 5):
        loop, records = noisy(seed)
        for name, errors in found.items():
            estimate = identified(loop, records, IDIM(name))  # type: ignore[arg-type]
            assert estimate.fit.converged
            assert [one.passed for one in estimate.checks if one.name == "instruments"] == [False] * (name == "iv")
            part = estimate.require_robot()
            truths = truth(part, loop.robot)
            errors.append(part.values - truths)
            assert np.mean(np.abs(errors[-1]) < 2 * estimate.covariance_of(part.names).std) > 0.85
    there = np.abs(truths) > 0.0
    bias = {name: np.abs(np.mean(errors, axis=0)[there] / truths[there]).max() for name, errors in found.items()}
    assert bias["weighted"] > 0.05
    assert bias["iv"] < 0.02


def test_coupled_motors() -> None:
    plain = arm(3)
    robot = replace(plain, joints=(*plain.joints[:2], replace(plain.joints[2], coupling={"joint2": -0.3})))
    records = records_of(robot, 4)
    coupled, separate = (axis_errors(identified(one, records)).max() for one in (robot, plain))
    assert coupled < 2e-4 and separate > 10 * coupled


def test_the_inverse_model_of_a_long_record_is_made_part_by_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a joint, of one with two masses, and of a robot: what is left out are the borders of the parts."""
    axis, record, small = ji.twin("L19"), rigid(30.0), arm(2)
    cases: list[tuple[Any, Any]] = [(record, LOOP.joint), (axis.record, axis.loop.joint)]
    cases.append((records_of(small, 1, noise=0.5), small))
    whole = [ji.identify(one, model, IDIM(), checks=False) for one, model in cases]
    monkeypatch.setattr("jointid.estimation.problems.inverse_model.BLOCK", 10_000)
    for (one, model), before in zip(cases, whole, strict=True):
        found = ji.identify(one, model, IDIM(), checks=False)
        assert found.fit.rows < before.fit.rows
        for name, part in found.parameters.items():
            assert abs((part.value or 0.0) - (before[name].value or 0.0)) <= 0.5 * (part.stderr or 0.0), name
            assert part.stderr == pytest.approx(before[name].stderr, rel=0.5), name
    with pytest.raises(MethodError):
        ji.identify(record, LOOP.joint, IDIM(), windows=5.0)


@pytest.mark.slow
@pytest.mark.parametrize(("digit", "noise"), [(1e-5, 0.0), (0.0, 1e-4)])
def test_the_default_cutoff_is_as_good_as_the_best_by_hand(digit: float, noise: float) -> None:
    """Of encoders that round, and of noisy ones, where 4 % of the rate, as of good positions, would be far too high."""
    random, logs, fresh = np.random.default_rng(3), [], records_of(ARM, 9)
    for record in records_of(ARM, 1, noise=0.3):
        seen = record.motor_position.values + noise * random.standard_normal(len(record.motor_position))
        seen = np.round(seen / digit) * digit if digit else seen
        logs.append(replace(record, motor_position=replace(record.motor_position, values=seen)))

    def errors(cutoff: float | None) -> tuple[float, float]:
        """Return the largest error of a friction or rotor, and of a joint's fresh torque, as shares."""
        found = by_idim(ARM, logs, filtering=Filtering(cutoff=cutoff))
        own = [name.endswith(("viscous", "coulomb", "rotor_inertia")) for name in found.names]
        off = np.abs(found.values[own] / truth(found)[own] - 1)
        return float(off.max()), max(axis.filtered_error for axis in validate(found.estimate, fresh).axes)

    default, *by_hand = (errors(hertz) for hertz in (None, 6.0, 20.0))
    assert np.all(np.array(default) < np.min(by_hand, axis=0) + 2e-3) and max(default) < 0.01
    assert (by_hand[-1][0] > 3 * default[0]) == bool(noise)
