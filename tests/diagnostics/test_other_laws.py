"""The law that a drive may run instead of the declared one: an integral that takes in the present sample."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.changes import AVERAGED, MEASURED_VELOCITY, PERIOD, PRESENT_SAMPLE, list_feedback_laws
from jointid.diagnostics.search import LawTest, choose_law
from jointid.diagnostics.suspects import DELAY, REFERENCE_DELAY, AxisFaults, FaultTest
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import PD, PID, POSITION, REFERENCE, Cascade, FirstOrder, respond, with_present_sample
from jointid.models.controllers.sampled import INPUTS
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from tests.estimates import faults_of, identify
from tests.mistakes import Axis, axis, run

T = 1e-3


@pytest.mark.parametrize("declared", [
    Cascade(position_gain=20.0, velocity_gain=3.0, integral_gain=50.0),
    PID(position_gain=20.0, derivative_gain=0.5, integral_gain=300.0),
])  # fmt: skip
def test_the_other_law_is_backward_eulers(declared: Cascade | PID) -> None:
    rng = np.random.default_rng(0)
    inputs = np.zeros((200, INPUTS))
    inputs[1:, REFERENCE], inputs[1:, POSITION] = rng.standard_normal((2, 199))
    reference, position = inputs[:, REFERENCE], inputs[:, POSITION]
    error, velocity = reference - position, np.diff(position, prepend=0.0) / T
    if isinstance(declared, Cascade):
        slip = declared.position_gain * error - velocity
        expected = declared.velocity_gain * (slip + declared.integral_gain * T * np.cumsum(slip))
    else:
        rate = np.diff(error, prepend=0.0) / T
        expected = declared.position_gain * error + declared.derivative_gain * rate
        expected += declared.integral_gain * T * np.cumsum(error)
    law = with_present_sample(declared, T).law(T)
    shown = respond(law, inputs, np.zeros(law.A.shape[-1]))[:, law.output]
    assert shown == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_only_a_law_with_an_integral_has_another_one() -> None:
    assert not list(list_feedback_laws(PD(position_gain=1.0, derivative_gain=1.0, velocity_filter=FirstOrder(1e-3)), T))
    filtered = FirstOrder(1e-3)
    assert not list(list_feedback_laws(Cascade(position_gain=1.0, velocity_gain=1.0, velocity_filter=filtered), T))
    [other, *_] = list_feedback_laws(Cascade(position_gain=1.0, velocity_gain=1.0, integral_gain=50.0), T)
    assert other.remedy == "velocity_gain 5.0 % larger and the integral time 1.00 ms longer"
    [other, *_] = list_feedback_laws(PID(position_gain=1.0, derivative_gain=1.0, integral_gain=50.0), T)
    assert other.remedy == "position_gain 5.0 % larger"


@pytest.mark.slow
def test_a_velocity_that_is_no_difference_is_named_before_a_faster_drive() -> None:
    made = _quiet()
    declared = replace(made.controller, velocity_filter=(1.0,))
    earlier = replace(declared, velocity_filter=(1.5, -0.5))
    record, loop = run(made, earlier), ClosedLoop(made.joint, declared)
    [first] = faults_of(identify(record, loop), record, most=1).findings
    assert first.test.fault is MEASURED_VELOCITY


def _quiet() -> Axis:
    """The rigid axis of the mistakes, with little friction that no model has."""
    return replace(axis("rigid"), ripple=0.1, noise=0.5, log_noise=0.3)


def _checked(*, present: bool) -> tuple[Estimate, Record, AxisFaults]:
    made = _quiet()
    record = run(made, with_present_sample(made.controller, made.rate) if present else made.controller)
    estimate = identify(record, ClosedLoop(made.joint, made.controller))
    return estimate, record, faults_of(estimate, record)


@pytest.mark.slow
def test_an_integral_that_takes_in_the_present_sample_is_named() -> None:
    estimate, record, check = _checked(present=True)
    found = check.findings[0]
    assert found.test.fault is PRESENT_SAMPLE
    assert found.test.size == pytest.approx(1.0, abs=3 * found.test.std)
    made = _quiet()
    assert estimate["inertia"].value + found.changes["inertia"].by == pytest.approx(made.values["inertia"], rel=0.01)
    checks = ji.identify(record, ClosedLoop(made.joint, made.controller)).checks
    assert next(one for one in checks if one.name == "loop").values["suspect"] == PRESENT_SAMPLE.name


def test_a_law_that_is_as_declared_is_not_blamed() -> None:
    _, _, check = _checked(present=False)
    assert PRESENT_SAMPLE not in [one.test.fault for one in check.findings]
    assert not any(one.law for one in check.suspected)


@pytest.mark.parametrize(("gains", "chosen"), [((-2.0, -1.0), None), ((-2.0, 1.0), 1), ((1.0, 1.001), 0)])
def test_no_law_of_the_reference_is_chosen_that_leaves_more_than_the_declared_one(
    gains: tuple[float, float], chosen: int | None
) -> None:
    laws = [
        LawTest(None, None, None, FaultTest(fault, (), 0.0, 1.0, 0.1, 1e-9), gain)  # type: ignore[arg-type]
        for fault, gain in zip((REFERENCE_DELAY, AVERAGED), gains, strict=True)
    ]
    assert choose_law(laws) is (None if chosen is None else laws[chosen])


def test_a_fault_that_is_impossible_and_explains_more_hides_no_law() -> None:
    early = FaultTest(DELAY, (), 0.0, -1e-3, 1e-5, 1e-9)
    law = LawTest(None, None, None, FaultTest(PERIOD, (), 0.0, 1.0, 0.1, 1e-9), 1.0)  # type: ignore[arg-type]
    each = ((law, -1e-3), (law, 1e-3), (replace(law, gain=-1.0), -1e-3))  # the last leaves more than the declared law
    left = np.ones(2)
    found = [one.explains(SimpleNamespace(tests=[replace(early, size=size)], residual=left)) for one, size in each]  # type: ignore[arg-type]
    assert found == [True, False, False]
