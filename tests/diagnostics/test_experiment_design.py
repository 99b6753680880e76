"""What sensors and motions are predicted to do is what they do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.diagnostics.experiment_design import (
    DETECTED,
    Advice,
    advise,
    design_stiffness_test,
    rebuild_declared_problem,
)
from jointid.diagnostics.intervals import weights_of
from jointid.diagnostics.other_experiments import (
    add_information,
    add_pulses,
    compute_encoder_information,
    double_acceleration,
    subtract_driven_motion,
)
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import invert
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.output.json import dumps, to_dict
from jointid.paper.twin import CONTROLLERS, SAMPLE_TIME, Twin, twin
from jointid.records.checks import find_encoder_step
from jointid.records.record import Channel, Record, Tap
from jointid.simulation.synthesis import simulated_record
from tests.estimates import amended, identify

STEP = 2.5e-7  # m, of an encoder as coarse as many


def ratio(advice: Advice, change: str, name: str) -> float:
    """Return the predicted deviation of a parameter under a change, over the reported one."""
    found = {one.name: one for one in (*advice.sensors, *advice.tests)}[change]
    return found.std[name] / advice.std[name]


@pytest.fixture(scope="module")
def disturbed(identified: Callable[..., Estimate]) -> tuple[Twin, Estimate]:
    """The twin with a force in its loop, the log being what the controller put out."""
    return twin("L19", seed=3), identified("L19", noise="disturbance", seed=3)


@pytest.fixture(scope="module")
def logged(identified: Callable[..., Estimate]) -> tuple[Twin, Estimate]:
    """The twin with noise on its log alone."""
    return twin("L30", noise="white", seed=3), identified("L30", noise="white", seed=3)


@pytest.fixture(scope="module")
def advice(disturbed: tuple[Twin, Estimate]) -> Advice:
    return advise(disturbed[1], disturbed[0].record)


@pytest.mark.slow
def test_a_motor_encoder_adds_nothing_to_an_exact_command(advice: Advice) -> None:
    assert advice.noise == "loop"
    for name in advice.std:
        assert ratio(advice, "motor encoder", name) == pytest.approx(1.0, abs=1e-9), name
        assert ratio(advice, "both", name) == pytest.approx(ratio(advice, "load encoder", name), rel=1e-9), name


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


@pytest.mark.slow
def test_friction_that_differs_by_direction(disturbed: tuple[Twin, Estimate]) -> None:
    axis, _ = disturbed
    loop = ClosedLoop(FlexibleJoint("prismatic", friction=AsymmetricFriction()), axis.loop.controller)
    advice = advise(identify(axis.record, loop), axis.record)
    for name in ("motor_viscous_forwards", "motor_viscous_backwards"):
        assert ratio(advice, "load encoder", name) < 0.5


def test_a_load_encoder_separates_the_viscous_frictions(advice: Advice) -> None:
    assert 15 <= 2 * advice.std["motor_viscous"] <= 45
    (load,) = (one for one in advice.sensors if one.name == "load encoder")
    assert 3 <= 2 * load.std["motor_viscous"] <= 6
    assert "5e-08 m" in load.description


@pytest.mark.slow
def test_a_load_encoder_does_what_is_predicted_of_it(advice: Advice) -> None:
    """IDIM by instruments reads both encoders; the deviation of 20 runs is itself known to 16 %."""
    axes = [twin("L19", seed=seed) for seed in range(20)]
    runs = [identify(axis.record, axis.loop, IDIM(estimator="iv")).values for axis in axes]
    (both,) = (one for one in advice.sensors if one.name == "both")
    for name in ("motor_inertia", "motor_viscous", "stiffness", "load_inertia", "load_viscous", "load_coulomb"):
        scatter = float(np.std([run[name] for run in runs]))
        assert 0.6 <= scatter / both.std[name] <= 1.6, name


def test_a_motor_encoder_beside_a_noisy_log_helps_enormously(logged: tuple[Twin, Estimate]) -> None:
    axis, estimate = logged
    measured = advise(estimate, axis.record, noise="log", encoder_step=STEP)
    assert 2 * measured.std["motor_viscous"] == pytest.approx(30, rel=0.3)
    assert 2 * measured.sensors[0].std["motor_viscous"] == pytest.approx(0.8, rel=0.2)
    assert ratio(measured, "both", "load_viscous") < ratio(measured, "motor encoder", "load_viscous")


def test_a_measured_torque_does_not_tell_that_its_residual_is_noise(logged: tuple[Twin, Estimate]) -> None:
    axis, estimate = logged
    advice = advise(estimate, replace(axis.record, tap=Tap.MEASURED), encoder_step=STEP)
    assert ratio(advice, "motor encoder", "motor_viscous") == pytest.approx(1.0)
    assert "noise of the log alone would give narrower intervals" in " ".join(str(advice).split())


def test_and_does_what_is_predicted_of_it(logged: tuple[Twin, Estimate]) -> None:
    """Least squares of torque and motor position, each by its own noise, one step from the truth."""
    axis, estimate = logged
    problem, _ = rebuild_declared_problem(estimate, axis.record)
    truth = problem.vector({**axis.truth, "initial_position": 0.0})
    error, J = problem.linearise(truth)
    variance = float(error @ error) / error.size
    spread = np.linalg.inv(J.T @ J) * variance
    added, _ = compute_encoder_information(problem, truth, "log", STEP, STEP)
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


def test_pulses_do_what_is_predicted_of_them(disturbed: tuple[Twin, Estimate], advice: Advice) -> None:
    axis, estimate = disturbed
    assert axis.record.reference is not None
    assert axis.record.injected is not None
    problem, _ = rebuild_declared_problem(estimate, axis.record)
    added = add_pulses(problem, 99.0, 0.02).experiment.after_limit - problem.experiment.after_limit
    white = np.random.default_rng(3).standard_normal(added.size)
    record = simulated_record(
        axis.loop, axis.record.reference.values, axis.truth, sample_time=SAMPLE_TIME, disturbance=axis.noise * white,
        injected=axis.record.injected.channel.values + added,
    )  # fmt: skip
    after = identify(record.without("motor_position", "load_position"), axis.loop)
    for name in ("motor_inertia", "motor_viscous", "stiffness", "damping", "load_inertia"):
        std = after[name].stderr
        assert std is not None
        assert std / advice.std[name] == pytest.approx(ratio(advice, "more pulses", name), rel=0.25), name


def test_the_faster_motion_has_twice_the_acceleration(disturbed: tuple[Twin, Estimate]) -> None:
    axis, estimate = disturbed
    problem, _ = rebuild_declared_problem(estimate, axis.record)
    fast = double_acceleration(problem, axis.record)
    before, after = (np.abs(np.diff(e.inputs[::50, 0], 2)).max() for e in (problem.experiment, fast.experiment))
    assert after / before == pytest.approx(2.0, rel=0.05)
    assert fast.experiment.samples == pytest.approx(problem.experiment.samples / np.sqrt(2), abs=1)


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


def test_the_advice_is_printed_and_written(advice: Advice) -> None:
    said = str(advice)
    assert "load encoder: steps of 5e-08 m; narrows" in said
    assert "motor encoder: steps of 5e-08 m; narrows no interval by more than a fifth" in said
    answer = json.loads(dumps(to_dict(advice)))
    assert answer["schema"] == "jointid.advice/1"
    assert [one["name"] for one in answer["sensors"]] == ["motor encoder", "load encoder", "both"]
    assert answer["sensors"][1]["std"]["motor_viscous"] < 0.3 * answer["parameters"]["motor_viscous"]["std"]


def test_what_cannot_be_advised_on(disturbed: tuple[Twin, Estimate], logged: tuple[Twin, Estimate]) -> None:
    axis, estimate = disturbed
    with pytest.raises(MethodError, match="holds another torque"):
        advise(estimate, logged[0].record)
    with pytest.raises(MethodError, match="this one is by IDIM"):
        advise(identify(axis.record, axis.loop.joint, IDIM()), axis.record)
    with pytest.raises(MethodError, match="is a positive number; received -1"):
        advise(estimate, axis.record, encoder_step=-1.0)
    joint_only = amended(estimate, params={"correlation": estimate.params.correlation[:-1, :-1]})
    with pytest.raises(MethodError, match='statistics = "sensitivities"'):
        advise(joint_only, axis.record)


def test_a_rigid_joint_has_no_load_to_put_an_encoder_on(disturbed: tuple[Twin, Estimate]) -> None:
    axis, _ = disturbed
    loop = ClosedLoop(RigidJoint("prismatic"), axis.loop.controller)
    rigid = advise(identify(axis.record, loop), axis.record)
    assert [one.name for one in rigid.sensors] == ["motor encoder"]


@pytest.mark.slow
def test_a_refused_stiffness_is_answered_with_what_would_show_it(stiff_axis: tuple[Record, Estimate]) -> None:
    record, estimate = stiff_axis
    answer = design_stiffness_test(estimate, record)
    assert answer.step == pytest.approx(1e-6, rel=1e-3)
    assert {one.share for one in answer.pulses} <= {0.1, 0.33}
    assert "would" in str(answer)
    stronger = design_stiffness_test(estimate, record, pulse=(3 * answer.height, answer.width))
    for weak, strong in zip(answer.pulses, stronger.pulses, strict=True):
        assert strong.deviation < weak.deviation
        assert (strong.mode or 0.0) >= (weak.mode or 0.0)
        assert (weak.mode is None) == (weak.deviation > DETECTED)
    for rung, seen in zip(answer.pulses, answer.encoder, strict=True):
        assert (seen.mode or 0.0) >= rung.softest
    assert json.loads(dumps(to_dict(answer)))["schema"] == "jointid.revealing/1"
    assert str(advise(estimate, record)) == str(answer)


@pytest.mark.slow
def test_what_was_kept_fixed_is_no_reason_not_to_answer(stiff_axis: tuple[Record, Estimate]) -> None:
    record, _ = stiff_axis
    loop = ClosedLoop(FlexibleJoint("prismatic"), CONTROLLERS["L19"])
    stiffness = next(p for p in loop.joint.parameters if p.name == "stiffness")
    estimate = identify(record, loop, parameters={"stiffness": stiffness.fix(1e9)})
    assert estimate.checks.bounds
    assert "would" in str(design_stiffness_test(estimate, record))


def test_a_name_with_a_hyphen_is_one_parameter() -> None:
    assert weights_of("inertia head-pan - coulomb head-pan") == {"inertia head-pan": 1.0, "coulomb head-pan": -1.0}
