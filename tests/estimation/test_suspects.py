"""What is wrong with a record, on the twin with one thing wrong at a time; seeds are fixed once and never retuned."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.diagnostics.score import SolvedLoop, rank_tests, score
from jointid.diagnostics.search import search_faults
from jointid.diagnostics.suspects import FaultSignature, FaultTest, number_fault
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.uncertainty.position_dependent_error import cells
from studies.healthy import drive
from tests.estimates import faults_of, identify
from tests.estimation.conftest import CONTROLLER
from tests.faults import FAULTS, problem, setting, solved
from tests.rigid_axis import LOOP, TRUTH, recorded

SIZES = {
    "position_gain": 0.03 * 160.18, "velocity_gain": -0.04 * 243.45, "delay": 0.4e-3, "offset": -3.16, "log_gain": 0.03,
}  # fmt: skip


SLOWER = ("log_gain", "velocity_gain", "delay", "offset", "limit")


@pytest.mark.parametrize("fault", ["position_gain", *(pytest.param(name, marks=pytest.mark.slow) for name in SLOWER)])
def test_one_fault_is_named_and_measured(fault: str) -> None:
    where = setting("L19", brief=fault != "limit")  # which a long record measures to a thousandth
    made = problem(where, FAULTS[fault], "disturbance", 1)
    check = search_faults(SolvedLoop(made, solved(made, where)), most=1)
    first = check.findings[0]
    assert first.test.name == fault
    assert not check.as_declared and not check.suspected  # what is tested before the last correction is no suspect
    assert (first.left is None) is (fault == "limit")  # which is no number that is fitted
    if fault in SIZES:
        assert first.test.size == pytest.approx(SIZES[fault], abs=3 * first.test.std)
    if fault == "limit":
        assert first.value == pytest.approx(0.7 * where.peak, rel=1e-3)


@pytest.mark.slow
def test_a_clean_record_is_as_declared() -> None:
    where = setting("L19", brief=True)
    made = problem(where, None, "disturbance", 1)
    check = search_faults(SolvedLoop(made, solved(made, where)))
    assert check.as_declared
    alike = next(s for s in check.tests if s.name == "velocity_gain")
    assert [one.name for one in alike.alike] == ["gain"]  # in a cascade without integral part only their product acts
    # All families of tests share the level of a record.
    axis = drive(70013, 8.0, "white force")
    check = faults_of(identify(axis.record, axis.loop), axis.record)
    assert check.as_declared and 0.01 < check.tests[0].p_value < 0.02


def test_a_stribeck_friction_looks_like_its_column() -> None:
    where = setting("L19", brief=True)
    clean = problem(where, None, None)
    x = clean.vector(where.truth)
    columns = [a for a in SolvedLoop(clean, x).signatures if a.fault.name == "stribeck"]
    nearest = min(columns, key=lambda a: abs((a.shape or 0.0) - 5e-3))
    faulty = problem(where, FAULTS["stribeck"], None)
    shown = clean.filter(faulty.measured - clean.measured)
    scale = float(nearest.column @ shown) / float(nearest.column @ nearest.column)
    assert scale == pytest.approx(0.3 * (where.truth["motor_coulomb"] + where.truth["load_coulomb"]), rel=0.1)
    assert np.linalg.norm(shown - scale * nearest.column) < 0.25 * np.linalg.norm(shown)


def test_what_is_free_is_not_suspected() -> None:
    where = setting("L19", brief=True)
    made = problem(where, FAULTS["delay"], "white", 1).freeing("delay")
    check = search_faults(SolvedLoop(made, solved(made, where)))
    assert check.as_declared
    assert "delay" not in {s.name for s in check.tests}


@pytest.mark.slow
def test_a_slow_motion_leaves_no_fault_too_sure() -> None:
    """Nine parameters and a fault share nine frequencies: of what they leave there, a fault came out 40 % too sure."""
    rng = np.random.default_rng(0)
    turns = 2 * np.pi * np.outer(np.arange(400) / 400, np.arange(1, 10))
    lines, found = np.column_stack([np.sin(turns), np.cos(turns)]), []
    for _ in range(100):
        columns, noise = lines @ rng.standard_normal((lines.shape[1], 12)), rng.standard_normal(400)
        own = columns[:, :9]
        left = noise - own @ np.linalg.lstsq(own, noise, rcond=None)[0]
        faults = [FaultSignature(number_fault(n), column) for n, column in zip("abc", columns[:, 9:].T, strict=True)]
        motion = cells(*lines[:, [0, 9]].T)
        tests = score(left, own, faults, {one.fault: 0.0 for one in faults}, motion)
        found += [one.statistic for one in tests]
    assert np.std(found) < 1.2


def test_an_answer_is_checked_with_its_record() -> None:
    record = recorded(noise=0.5)
    estimate = identify(record, LOOP)
    assert faults_of(estimate, record).as_declared
    with pytest.raises(MethodError):
        faults_of(estimate, recorded(noise=0.5, seed=2))


def test_a_check_that_crashes_loses_no_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.diagnostics.diagnosis.search_faults", Mock(side_effect=RuntimeError))
    estimate = ji.identify(recorded(noise=0.5), LOOP)
    loop = next(one for one in estimate.checks if one.name == "loop")
    assert (loop.passed, loop.code) == (None, "check_failed") and "RuntimeError" in loop.words
    assert estimate.answer.trust.code == "not_checked"
    assert abs(estimate["inertia"].value - TRUTH["inertia"]) < 3 * (estimate["inertia"].stderr or 0.0)


def test_what_is_significant_stands_first_however_strong_the_others_are() -> None:
    """A search among many periods finds the stronger shape, and by chance."""

    def test(name: str, strength: float, p_value: float) -> FaultTest:
        return FaultTest(number_fault(name), (), 0.0, strength, 1.0, p_value)

    tests = [test("cogging", 4.0, 0.8), test("limit", 2.0, 0.3), test("delay", 2.8, 0.02), test("offset", -3.0, 0.01)]
    assert [one.name for one in rank_tests(tests, 0.05)] == ["offset", "delay", "limit", "cogging"]
    assert rank_tests([test("cogging", 4.0, 0.018), test("stribeck", 3.6, 0.0017)], 0.05)[0].name == "stribeck"
    assert rank_tests([test("cogging", 9.0, 1e-9), test("stribeck", 3.6, 0.0017)], 0.05)[0].name == "cogging"


@pytest.mark.slow
def test_the_real_axis_is_told_what_it_has(emps: Record, emps_pulses: Record) -> None:
    """Both records say the same: less friction towards standstill, and a torque that acts 0.15 to 0.25 ms late."""
    loop = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
    for record in (emps, emps_pulses):
        check = faults_of(identify(record, loop), record, most=2)
        friction, late = (f.test for f in check.findings)
        assert (friction.name, late.name) == ("presliding", "delay")
        assert friction.size == pytest.approx(7.7, abs=0.3)
        assert friction.std < 1.2
        assert 0.13e-3 < late.size < 0.25e-3
        assert 2 * late.std < 0.13e-3


@pytest.mark.slow
def test_a_wave_of_any_phase_is_tested_as_two_numbers() -> None:
    """Of white residuals the best phase of a wave is significant at 5 % as often as that, not three times."""
    rng, rows, found = np.random.default_rng(3), 200, []
    waves = np.column_stack([turn(0.4 * np.arange(rows)) for turn in (np.cos, np.sin)])
    own = rng.standard_normal((rows, 2))
    fault = replace(number_fault("position_gain"), one_sided=True, tried=1)
    for residual in rng.standard_normal((300, rows)):
        parts = np.linalg.lstsq(np.column_stack([waves, own]), residual, rcond=None)[0][:2]
        column = waves @ parts / np.linalg.norm(parts)
        signature = FaultSignature(fault, column)
        (test,) = score(residual, own, [signature], {fault: 0.0}, cells(waves[:, 0], waves[:, 1]))
        found.append(test.p_value)
    assert 0.02 < np.mean(np.array(found) < 0.05) < 0.1


def test_a_deviation_is_widened_for_a_residual_that_repeats_although_the_test_is_not_significant() -> None:
    rng, rows = np.random.default_rng(4), 4000
    way = 0.02 * np.arange(rows)
    repeats = np.sin(7 * np.sin(way)) + 0.3 * rng.standard_normal(rows)
    column, fault = np.cos(way) ** 3, number_fault("delay")
    column -= repeats * (column @ repeats) / (repeats @ repeats)  # nothing of the residual is of the fault

    def test(widened: float) -> FaultTest:
        return score(
            repeats, np.cos(way)[:, np.newaxis], [FaultSignature(fault, column)], {fault: 0.0},
            cells(np.sin(way), np.cos(way)), widened=widened,
        )[0]  # fmt: skip

    assert test(0.05).p_value > 0.05
    assert test(1.0).std > 1.2 * test(0.05).std
