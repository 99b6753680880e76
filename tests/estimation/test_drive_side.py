"""Drive-side identification where the truth is known: recovery, lags, intervals, and the instruments' verdict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import ignore_progress
from jointid.estimation.methods.endogeneity import (
    InstrumentedProblem,
    Judgement,
    contrast,
    judge_endogeneity,
    known_motions,
    solve_with_instruments,
)
from jointid.estimation.problems.prescribed import DriveSideProblem, motion_problem
from jointid.paper.twin import CONTROLLERS, TABLE_2, twin
from jointid.records.record import Channel, Injection, Record, Tap, Timing
from jointid.simulation.loop_input import prepare
from jointid.solvers.bounded_least_squares import LevenbergMarquardt
from jointid.solvers.solve import Solution, solve
from jointid.uncertainty.covariance import band_deviations, sandwich, with_measured_motion

JOINT = ji.FlexibleJoint("prismatic")
PHYSICAL = ("motor_inertia", "stiffness", "load_inertia")
FILTERING = ji.Filtering(cutoff=60.0)


def problem_of(record: Record, **settings: float | None) -> DriveSideProblem:
    around = ji.DriveSideFit(**settings).surroundings(1e-3)
    return motion_problem(record, ji.DriveSide(JOINT), FILTERING, JOINT.parameters, around)


@pytest.mark.slow
def test_a_record_without_noise_gives_the_truth_from_no_start() -> None:
    made = twin("L19", noise="none")
    estimate = ji.identify(made.record.without("reference", "injected"), ji.DriveSide(JOINT), filtering=FILTERING)
    for p in JOINT.parameters:
        assert estimate[p.name].value == pytest.approx(made.truth[p.name], rel=2e-3), p.name
    for name in PHYSICAL:
        assert estimate[name].value == pytest.approx(made.truth[name], rel=5e-4), name
    assert estimate["log_delay"].value == pytest.approx(0.0, abs=1e-6)
    assert estimate.fit.converged
    assert estimate.fit.simulations < 150


@pytest.mark.slow
def test_a_delay_before_the_torque_is_found_without_the_controller() -> None:
    record = twin("L30", noise="none").record  # a command that acts one period later
    assert ji.identify(record, ji.DriveSide(JOINT), ji.DriveSideFit(frequency=24.0), filtering=FILTERING)[
        "log_delay"
    ].value == pytest.approx(-1e-3, abs=2e-6)


def test_an_inertia_whose_interval_holds_0_is_said_to_be_unknown() -> None:
    """A rigid joint that is light, slow and noisy; with little noise its inertia is told."""
    joint = ji.RigidJoint("prismatic")
    loop = ji.ClosedLoop(joint, ji.controller.Cascade(position_gain=50.0, velocity_gain=1000.0))
    truth = {"inertia": 2.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=0.2, travel=0.4, sample_time=1e-3)
    random = np.random.default_rng(3).standard_normal(reference.size)
    for noise, told in ((0.1, True), (40.0, False)):
        record = ji.simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise * random)
        settings = ji.DriveSideFit(log_delay=0.0)
        found = ji.identify(record.without("reference"), ji.DriveSide(joint), settings)
        assert found["inertia"].value is not None
        assert found["inertia"].identifiable is told
        assert found["viscous"].identifiable
        assert ("inertia is not identifiable from this record: its interval holds 0" in found.checks.warnings) != told


def test_a_load_that_sticks_is_identified() -> None:
    truth = TABLE_2 | {"load_coulomb": 45.0}
    loop = ji.ClosedLoop(JOINT, CONTROLLERS["L19"])
    reference = ji.excitation.trapezoids(
        speeds=(0.042, 0.083, 0.125), acceleration=0.83, travel=0.2, sample_time=1e-3, rest=0.3
    )
    known = ji.excitation.pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=1)
    run = ji.simulate(loop, prepare(loop, _driven(reference, known)), truth)
    assert run.load_velocity is not None
    assert np.mean(run.load_velocity == 0) > 0.05
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3, injected=known)
    record = record.without("load_position", "reference", "injected")
    filtering = ji.Filtering(cutoff=60.0, position_cutoff=300.0)
    estimate = ji.identify(record, ji.DriveSide(JOINT), ji.DriveSideFit(frequency=24.0), filtering=filtering)
    for name, value in truth.items():
        assert estimate[name].value == pytest.approx(value, rel=2e-3), name


def _driven(reference: np.ndarray, known: np.ndarray) -> Record:
    return Record(
        reference=Channel(reference, "m", 1e-3),
        injected=Injection(Channel(known, "N", 1e-3, Timing.HELD)),
    )


@pytest.mark.parametrize("tap", [Tap.COMMAND, Tap.MEASURED])
def test_the_slopes_of_the_residual_are_those_of_differences(tap: Tap) -> None:
    record = replace(twin("L19", noise="none").record.without("injected"), tap=tap)
    problem = problem_of(record, current_lag=None)
    around = {"log_delay": 3.3e-4, "current_lag": 4e-4, "initial_load_position": 1e-5, "initial_load_velocity": 1e-3}
    x = problem.vector(TABLE_2 | around)
    _, J = problem.linearise(x)
    for i, p in enumerate(problem.free):
        step = np.zeros(x.size)
        step[i] = 1e-5 * abs(x[i]) or 1e-7
        slope = (problem.residual(x + step) - problem.residual(x - step)) / (2 * step[i])
        assert np.linalg.norm(slope - J[:, i]) <= 2e-4 * np.linalg.norm(slope), p.name


@pytest.mark.parametrize("tap", [Tap.COMMAND, pytest.param(Tap.MEASURED, marks=pytest.mark.slow)])
def test_a_lag_of_the_current_is_told_from_a_delay(tap: Tap) -> None:
    from scipy.signal import lfilter

    record = twin("L19", noise="none").record.without("injected", "reference", "load_position")
    assert record.torque is not None
    kept, torque = np.exp(-1e-3 / 2e-3), record.torque.values
    # A measured torque is seen behind the lag; a command is what would have had to be put out before it.
    b, a = ([1 - kept], [1, -kept]) if tap is Tap.MEASURED else ([1, -kept], [1 - kept])
    lagged = replace(record, torque=replace(record.torque, values=lfilter(b, a, torque)), tap=tap)
    settings = ji.DriveSideFit(current_lag=None, frequency=24.0)
    estimate = ji.identify(lagged, ji.DriveSide(JOINT), settings, filtering=FILTERING)
    assert estimate["current_lag"].value == pytest.approx(2e-3, rel=0.05)
    for name in PHYSICAL:
        assert estimate[name].value == pytest.approx(TABLE_2[name], rel=3e-3), name
    blind = ji.identify(lagged, ji.DriveSide(JOINT), ji.DriveSideFit(frequency=24.0), filtering=FILTERING)
    assert blind.fit.filtered_error > 3 * estimate.fit.filtered_error


def test_white_noise_on_the_log_leaves_the_truth_in_the_intervals() -> None:
    inside = []
    for seed in range(1, 5):
        made = twin("L19", noise="white", seed=seed)
        problem = problem_of(made.record, log_delay=0.0)
        solution = solve(problem, LevenbergMarquardt(1e-8), problem.vector(TABLE_2))
        std = sandwich(solution.jacobian, solution.jacobian, solution.residual).std
        std = np.maximum(std, band_deviations(solution.jacobian, solution.jacobian, solution.residual))
        own = slice(0, len(JOINT.parameters))
        inside += list((np.abs(solution.x - problem.vector(TABLE_2)) < 2 * std)[own])
    assert np.mean(inside) > 0.85


def test_bands_see_a_gain_that_falls_with_frequency() -> None:
    rng = np.random.default_rng(0)
    J = rng.standard_normal((4000, 1))
    spectrum = np.fft.rfft(J[:, 0])
    error = np.fft.irfft(spectrum * np.linspace(0.05, -0.05, spectrum.size), 4000)
    error -= J[:, 0] * (J[:, 0] @ error) / (J[:, 0] @ J[:, 0])
    by_rows = sandwich(J, J, error).std[0]
    assert band_deviations(J, J, error)[0] > 5 * by_rows


def test_deviations_along_a_measured_motion_hold_the_bias_of_a_force_that_moves_it() -> None:
    """An inertia of 2 that a reference moves slowly, and a force, as d / 2, at all frequencies."""
    rng, before, after = np.random.default_rng(0), [], []
    slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(4000)) * (np.arange(2001) < 100), 4000)
    for _ in range(50):
        d = 0.03 * rng.standard_normal(4000)
        J = (slow + d / 2)[:, np.newaxis]
        x = float(J[:, 0] @ (2 * slow)) / float(J[:, 0] @ J[:, 0])
        error = 2 * slow - J[:, 0] * x
        plain = sandwich(J, J, error)
        wide = with_measured_motion(plain, J, J, error)
        before.append(abs(x - 2) / plain.std[0])
        after.append(abs(x - 2) / wide.std[0])
    assert np.mean(np.array(before) < 2) < 0.3
    assert np.mean(np.array(after) < 2) > 0.9


def test_noise_on_the_log_widens_deviations_along_a_measured_motion_by_a_third() -> None:
    rng, factors = np.random.default_rng(0), []
    for _ in range(50):
        J, error = rng.standard_normal((2000, 2)), rng.standard_normal(2000)
        error -= J @ np.linalg.lstsq(J, error, rcond=None)[0]
        plain = sandwich(J, J, error)
        factors.append(with_measured_motion(plain, J, J, error).std / plain.std)
    assert np.mean(factors) == pytest.approx(1.35, abs=0.05)


@pytest.mark.slow
def test_white_noise_on_the_log_is_no_endogeneity() -> None:
    probabilities = []
    for seed in range(1, 6):
        record = twin("L19", noise="white", seed=seed).record
        problem = problem_of(record, log_delay=0.0)
        solution = solve(problem, LevenbergMarquardt(1e-8), problem.vector(TABLE_2))
        verdict = judge_endogeneity(record, problem, solution, "tested", ignore_progress)
        assert verdict.x is None
        assert not verdict.warnings
        assert verdict.probability is not None
        probabilities.append(verdict.probability)
    assert min(probabilities) > 0.01
    assert max(probabilities) > 0.2


def test_a_disturbance_in_the_loop_is_noticed() -> None:
    record = twin("L30", seed=1).record
    problem = problem_of(record, log_delay=-1e-3)
    solution = solve(problem, LevenbergMarquardt(1e-8), problem.vector(TABLE_2))
    verdict = judge_endogeneity(record, problem, solution, "tested", ignore_progress)
    assert verdict.x is not None
    assert "Durbin-Wu-Hausman" in verdict.warnings[0]
    at = [p.name for p in problem.free].index("stiffness")
    truth = TABLE_2["stiffness"]
    assert abs(verdict.x[at] / truth - 1) < abs(solution.x[at] / truth - 1)


@pytest.mark.slow
def test_a_disturbance_in_the_loop_is_noticed_and_mended() -> None:
    plain, mended = [], []
    for seed in range(1, 6):
        record = twin("L30", seed=seed).record
        problem = problem_of(record, log_delay=-1e-3)
        solution = solve(problem, LevenbergMarquardt(1e-8), problem.vector(TABLE_2))
        verdict = judge_endogeneity(record, problem, solution, "tested", ignore_progress)
        assert verdict.x is not None
        assert "Durbin-Wu-Hausman" in verdict.warnings[0]
        truth = problem.vector(TABLE_2)
        chosen = [i for i, p in enumerate(problem.free) if p.name in PHYSICAL]
        plain.append(solution.x[chosen] / truth[chosen] - 1)
        mended.append(verdict.x[chosen] / truth[chosen] - 1)
    assert np.all(np.abs(np.mean(plain, axis=0)) > 0.008)
    assert np.all(np.abs(np.mean(mended, axis=0)) < 0.003)


@pytest.mark.slow
def test_pulses_keep_a_coloured_disturbance_from_biasing_the_answer() -> None:
    found = []
    for seed in range(8):
        problem, solution, verdict = answered(coloured(True, seed))
        found.append(solution.x if verdict.x is None else verdict.x)
        assert not any("weak" in warning for warning in verdict.warnings)
    truth, chosen = problem.vector(TABLE_2), [3, 5]
    assert [problem.free[i].name for i in chosen] == ["stiffness", "load_inertia"]
    assert np.all(np.abs(np.mean(found, axis=0)[chosen] / truth[chosen] - 1) < 0.01)


@pytest.mark.slow
def test_without_pulses_every_answer_says_that_it_is_biased_or_cannot_be_tested() -> None:
    plain = []
    for seed in range(6):
        problem, solution, verdict = answered(coloured(False, seed))
        plain.append(solution.x)
        assert any("Durbin-Wu-Hausman" in w or "instruments are" in w for w in verdict.warnings)
    truth, chosen = problem.vector(TABLE_2), [3, 5]
    assert np.all(np.mean(plain, axis=0)[chosen] / truth[chosen] - 1 < -0.05)


def answered(record: Record) -> tuple[DriveSideProblem, Solution, Judgement]:
    problem = problem_of(record, log_delay=-1e-3)
    solution = solve(problem, LevenbergMarquardt(1e-8), problem.vector(TABLE_2))
    return problem, solution, judge_endogeneity(record, problem, solution, "tested", ignore_progress)


def coloured(pulses: bool, seed: int) -> Record:
    """A run of loop L30 with a disturbance of 15 to 25 Hz that makes 8 % of the filtered torque."""
    from scipy.signal import butter, sosfiltfilt

    loop = ji.ClosedLoop(JOINT, CONTROLLERS["L30"])
    reference = ji.excitation.trapezoids(
        speeds=(0.042, 0.083, 0.125), acceleration=0.83, travel=0.2, sample_time=1e-3, duration=24.0
    )
    known = ji.excitation.pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=0) if pulses else None
    white = np.random.default_rng(seed).standard_normal(reference.size)
    band = sosfiltfilt(butter(2, [15, 25], btype="band", fs=1000, output="sos"), white)
    seen = FILTERING.resolve(1e-3)

    def run(size: float) -> Record:
        return ji.simulated_record(
            loop, reference, TABLE_2, sample_time=1e-3, injected=known, disturbance=size * band, encoder_step=5e-8
        )

    def torque(size: float) -> np.ndarray:
        made = run(size).torque
        assert made is not None
        return seen.decimate(made.values, 1e-3)

    clean, size = torque(0.0), 1.0
    for _ in range(2):
        size *= 0.08 * float(np.linalg.norm(clean) / np.linalg.norm(torque(size) - clean))
    return run(size)


def test_a_known_motion_is_blind_to_the_half_it_is_used_in() -> None:
    record = twin("L30").record
    problem = problem_of(record, log_delay=-1e-3)
    before = known_motions(record, problem)
    half = problem.motion.position.size // 2
    shaken = problem.motion.position.copy()
    shaken[half + 2000 :] += 1e-4 * np.random.default_rng(0).standard_normal(shaken.size - half - 2000)
    after = known_motions(record, replace(problem, motion=replace(problem.motion, position=shaken)))
    assert np.allclose(before[0], after[0], rtol=0, atol=1e-8)
    assert not np.allclose(before[1], after[1], rtol=0, atol=1e-6)


def test_a_rigid_joint_needs_no_load() -> None:
    joint, truth = ji.RigidJoint("prismatic"), {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    loop = ji.ClosedLoop(joint, CONTROLLERS["L19"])
    reference = ji.excitation.trapezoids(speeds=(0.05, 0.12), acceleration=0.83, travel=0.2, sample_time=1e-3, rest=0.4)
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
    estimate = ji.identify(record.without("reference"), ji.DriveSide(joint))
    for name, value in truth.items():
        assert estimate[name].value == pytest.approx(value, rel=2e-3), name
    assert any("rests in" in warning for warning in estimate.checks.warnings)


@pytest.mark.slow
def test_a_wrong_contrast_is_seen() -> None:
    """The statistic is that of the estimates it is given, not of the probability that was hoped for."""
    record = twin("L19", noise="white").record
    problem = problem_of(record, log_delay=0.0)
    solution = solve(problem, LevenbergMarquardt(1e-8), problem.vector(TABLE_2))
    found = solve_with_instruments(InstrumentedProblem.of(record, problem), solution.x)
    assert contrast(problem, solution, found)[0] > 0.01
    moved = replace(solution, x=solution.x * 1.01)
    assert contrast(problem, moved, found)[0] < 1e-6


def test_an_answer_goes_to_json_and_back(tmp_path: Path) -> None:
    from jointid.output import json as answers

    record = twin("L19", noise="none").record.without("reference", "injected")
    estimate = ji.identify(record, ji.DriveSide(JOINT), ji.DriveSideFit(frequency=24.0), filtering=FILTERING)
    answers.write(answers.to_dict(estimate), tmp_path / "found.json")
    back = answers.load_estimate(tmp_path / "found.json", ji.DriveSide(JOINT)).identified
    assert back.method == "drive_side"
    assert back.values == pytest.approx(estimate.identified.values)
    assert ji.validate(back, record).filtered_error == pytest.approx(estimate.fit.filtered_error, rel=1e-6)


@pytest.mark.slow
def test_instruments_that_leave_every_inertia_at_its_bound_are_too_weak(data_dir: Path) -> None:
    """A slow motion among others: the instruments' solution has no inertia and no stiffness inside their bounds."""
    record = ji.read(data_dir / "kr300" / "rec_A.mat", drive=ji.Drive("kuka", axis=5), kind="revolute")
    estimate = ji.identify(record, ji.DriveSide(ji.FlexibleJoint("revolute")))
    assert any("too weak to converge within the bounds" in text for text in estimate.checks.warnings)
    assert any(text.startswith("other axes moved too") for text in estimate.checks.warnings)
