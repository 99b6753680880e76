"""The flexible joint of the paper, on its digital twin."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.common.messages import ignore_progress
from jointid.diagnostics.analysis import intervals
from jointid.estimation import spring_search
from jointid.estimation.descent import History
from jointid.estimation.methods import Task
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.problems.simulated import torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.spring_search import divide_coulomb_friction, rough_rigid_joint
from jointid.paper.twin import Twin, twin
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record
from studies import healthy
from tests.estimates import identify


def deviations(estimate: Estimate, truth: dict[str, float]) -> dict[str, float]:
    """Return the errors in standard deviations."""
    return {
        name: (value - truth[name]) / float(estimate[name].stderr or np.nan) for name, value in estimate.values.items()
    }


@pytest.mark.parametrize("loop", ["L19", "L30"])
def test_idim_recovers_the_noise_free_twin(loop: str) -> None:
    """Both rows of (2), torque held, and for L30 a period of delay; much better than the 1 % and 3 % asked for."""
    axis = twin(loop, noise="none")  # type: ignore[arg-type]
    estimate = identify(axis.record, axis.loop, IDIM())
    assert estimate.data.channels == ("torque", "motor_position", "load_position", "injected")
    for name, value in estimate.values.items():
        assert abs(value / axis.truth[name] - 1) <= (0.01 if name == "damping" else 1e-3), name


def torque_only(axis: Twin) -> Record:
    return axis.record.without("motor_position", "load_position")


@pytest.mark.parametrize("loop", ["L19", pytest.param("L30", marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise", ["disturbance", "white"])
def test_didim_finds_stiffness_inertias_and_the_sums_of_friction_from_torque_alone(loop: str, noise: str) -> None:
    axis = twin(loop, noise=noise)  # type: ignore[arg-type]
    estimate = identify(torque_only(axis), axis.loop)
    assert estimate.settings.method == "didim"
    assert estimate.data.channels == ("torque", "reference", "injected")
    assert estimate.fit.filtered_error == pytest.approx(0.08, abs=0.002)
    assert all(abs(d) <= 3.0 for d in deviations(estimate, axis.truth).values())
    for name in ("motor_inertia", "load_inertia", "stiffness"):
        assert abs(estimate.values[name] / axis.truth[name] - 1) <= 0.01, name
    for friction in ("viscous", "coulomb"):
        total = sum(axis.truth[f"{side}_{friction}"] for side in ("motor", "load"))
        found = sum(estimate.values[f"{side}_{friction}"] for side in ("motor", "load"))
        assert abs(found / total - 1) <= 0.02
    passed = {check.name: check.passed for check in estimate.checks}
    pairs = [check.values.get("parameters") for check in estimate.checks if check.name == "identifiability"]
    assert ["motor_viscous", "load_viscous"] in pairs
    assert passed["stiffness"] and not estimate.bounds
    assert passed["whiteness"] is (noise == "white")
    assert estimate.fit.converged


@pytest.mark.parametrize("loop", ["L19", pytest.param("L30", marks=pytest.mark.slow)])
@pytest.mark.parametrize("frequency", [None, *(pytest.param(f, marks=pytest.mark.slow) for f in (15.0, 30.0, 60.0))])
def test_didim_recovers_the_noise_free_twin_from_any_start(loop: str, frequency: float | None) -> None:
    axis = twin(loop, noise="none")  # type: ignore[arg-type]
    estimate = identify(torque_only(axis), axis.loop, DIDIM(frequency=frequency))
    assert estimate.values == pytest.approx(axis.truth, rel=1e-4)
    assert not estimate["initial_velocity"].free
    assert estimate.fit.simulations <= 700


def test_an_axis_that_moves_at_the_first_sample_is_found_moving() -> None:
    axis = twin(noise="none")
    late = cut(torque_only(axis), 300, 24_000)  # from mid-ramp on
    estimate = identify(late, axis.loop, DIDIM(frequency=30.0))
    assert float(estimate["initial_velocity"].value or 0.0) > 0.02
    assert abs(estimate.values["stiffness"] / axis.truth["stiffness"] - 1) <= 1e-3  # 0.01 with the load's first swing


def test_bounds_hold() -> None:
    axis = twin(noise="white")
    parameters = {p.name: p for p in axis.loop.joint.parameters}
    low = {"stiffness": replace(parameters["stiffness"], upper=7.5e5)}
    estimate = identify(torque_only(axis), axis.loop, DIDIM(frequency=30.0), parameters=low)
    assert estimate.values["stiffness"] <= 7.5e5


def test_a_friction_of_zero_is_not_known_to_a_millionth() -> None:
    """At a bound the derivative must be taken inside it: beyond, there is nothing to simulate."""
    axis = twin(noise="none")
    truth = {**axis.truth, "motor_coulomb": 0.0}
    reference = axis.record.reference
    noise = 3.0 * np.random.default_rng(0).standard_normal(len(reference))
    made = simulated_record(axis.loop, reference.values, truth, sample_time=1e-3, torque_noise=noise)
    estimate = identify(made, axis.loop, DIDIM(frequency=30.0))
    found = estimate["motor_coulomb"]
    assert float(found.value or 0.0) <= 3 * float(found.stderr or 0.0) + 1e-9
    assert float(found.stderr or 0.0) > 1e-3
    # The descent ends a billionth of a newton above 0, which is no millionth of itself.
    assert not next(verdict for verdict in estimate.checks if verdict.name == "bounds").passed


def test_coulomb_friction_that_was_found_on_the_wrong_side_is_divided_anew() -> None:
    axis = twin(noise="none")
    problem = torque_problem(torque_only(axis), axis.loop, Filtering(), axis.loop.joint.parameters)
    whole = axis.truth["motor_coulomb"] + axis.truth["load_coulomb"]
    state = {"initial_position": 0.0, "initial_velocity": 0.0, "initial_torque": 0.0}
    history = History(ignore_progress)
    for wrong in (0.15, 0.9):
        sides = {"motor_coulomb": wrong * whole, "load_coulomb": (1 - wrong) * whole}
        found = divide_coulomb_friction(problem, problem.vector(state | axis.truth | sides), history)
        assert found is not None
        values = problem.values(found)
        assert values["motor_coulomb"] == pytest.approx(axis.truth["motor_coulomb"], abs=0.05 * whole)
        assert values["motor_coulomb"] + values["load_coulomb"] == pytest.approx(whole, rel=0.05)
        assert values["stiffness"] == pytest.approx(axis.truth["stiffness"], rel=0.05)
    assert divide_coulomb_friction(problem, problem.vector(state | axis.truth), history) is None
    assert spring_search._agree((1.0, 0.0), (1.0, 0.0), 1.0)  # ends without a mode, whose stiffness is at its bound 0


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "longest"), [(5047, 12.0), (2055, 5.0), (2017, 5.0)])
def test_two_starts_in_the_same_wrong_valley_of_friction_are_led_out_of_it(seed: int, longest: float) -> None:
    """Valleys of the Coulomb friction's division, far from the truth or next to it, and one at a bound of friction.

    Without the steps that lead out of them 62 % are on the motor, where 72 % are; the residual is 9 % larger; and the
    stiffness ends at 80 %, with the motor's viscous friction at 0.
    """
    drive = healthy.drive(seed, longest)
    estimate = identify(drive.record, drive.loop)
    assert estimate["stiffness"].value is not None
    assert all(abs(one) <= 3 for one in deviations(estimate, drive.truth).values())
    assert estimate.values["motor_coulomb"] == pytest.approx(drive.truth["motor_coulomb"], rel=0.02)


@pytest.mark.slow
def test_profiles_agree_with_the_table_where_the_criterion_is_a_parabola() -> None:
    axis = twin(noise="white")
    record = torque_only(axis)
    estimate = identify(record, axis.loop)
    sides = ("motor_viscous", "load_viscous")
    stiffness, compliance, total = intervals(estimate, record, ["stiffness", "compliance", " + ".join(sides)])
    for profile, value, std in (
        (stiffness, estimate.values["stiffness"], estimate["stiffness"].stderr),
        (total, sum(estimate.values[name] for name in sides), estimate.covariance_of(sides).std_of(np.ones(2))),
    ):
        assert profile.interval == pytest.approx((value - 2 * std, value + 2 * std), abs=0.2 * std)
    assert [1 / (end or 1.0) for end in reversed(compliance.interval)] == pytest.approx(stiffness.interval, rel=1e-3)


def test_a_torque_of_the_wrong_sign_is_refused_by_its_work() -> None:
    axis = twin(noise="white")
    record = torque_only(axis)
    wrong = replace(record, torque=replace(record.torque, values=-record.torque.values))
    with pytest.raises(MethodError, match=r"-52\.\d J of work"):
        identify(wrong, axis.loop)


@pytest.mark.slow
def test_a_joint_that_is_too_light_for_its_loop_is_no_start() -> None:
    drive, history = healthy.drive(7, 10.0), History(ignore_progress)  # a sweep across its mode
    joint = drive.loop.joint
    task = Task(drive.record, joint, drive.loop, joint.parameters, Filtering(), ignore_progress)
    with pytest.raises(MethodError):
        rough_rigid_joint(task, history)
    assert history.counted.evaluations < 200  # 118 to 156, as the processor rounds; 327 without a least inertia
