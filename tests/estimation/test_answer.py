"""The answer in a line: its words to the letter, and which failed check speaks against which value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import Message
from jointid.estimation.result.answer import Found, Trust
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Params
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.checks import EncoderLag
from jointid.uncertainty.identifiability import Identifiability, Known, physical
from jointid.uncertainty.verdict import (
    AGAINST_EVERY_VALUE,
    Reason,
    Status,
    StiffnessBound,
    Subject,
    Verdict,
)
from tests.estimates import amended
from tests.estimation.test_estimate import CONTROLLER, ESTIMATE, parameter

RIGID = amended(
    ESTIMATE,
    params={
        "rows": (
            parameter("inertia", "ZZ", "kg", 94.9034, 0.46),
            parameter("viscous", "Fv", "N s/m", 207.534, 13.0),
            parameter("coulomb", "Fc", "N", 20.1, 0.3),
        )
    },
)


def judged(estimate: Estimate, **changes: float) -> Estimate:
    """Return an estimate whose loop has a fault that changes parameters by so much; none without changes."""
    words, clause = "velocity_gain is 25 ± 3 % smaller than declared (p < 1e-6)", "velocity_gain is 25 % smaller"
    reason = Message(Reason.LOOP_NOT_AS_DECLARED, words, {"changes": changes}, clause)
    if not changes:
        reason = Message(Reason.LOOP_AS_DECLARED, "as declared")
    verdict = Verdict(Subject.LOOP, Status.of(not changes), (reason,))
    return amended(estimate, checks={"verdicts": (verdict,)})


def flexible(stiffness: float | None, stderr: float | None = None, **more: float) -> Estimate:
    rows = (
        parameter("motor_inertia", "ZZ1", "kg m^2", 0.5, 0.001),
        parameter("stiffness", "K12", "N m/rad", stiffness, stderr, **more),
        parameter("load_inertia", "ZZ2", "kg m^2", 0.5, 0.001),
    )
    found = replace(ESTIMATE, params=Params(rows, ("motor_inertia",), np.zeros((0, 0))))
    joint = FlexibleJoint(kind="revolute")
    return amended(found, settings={"system": joint, "loop": ClosedLoop(joint, CONTROLLER)})


def test_an_estimate_that_nothing_speaks_against() -> None:
    answer = judged(RIGID).answer
    assert str(answer) == "Inertia 94.90 ± 0.92 kg. You can rely on it."
    assert (answer.found.code, answer.trust.code, answer.reliable) == (Found.VALUE, Trust.RELIABLE, True)
    assert answer.found.values["value"] == 94.9034
    assert answer.found.values["two_sigma"] == 0.92


def test_the_stiffness_comes_first_and_its_mode_in_hertz() -> None:
    answer = judged(flexible(17467.0, 1057.0)).answer
    assert str(answer).startswith("Stiffness 17500 ± 2100 N m/rad, mode 42.1 Hz. ")
    assert answer.found.values["mode_hz"] == pytest.approx(np.sqrt(17467.0 * 4) / (2 * np.pi))


def test_a_fault_that_moves_the_value_out_of_its_interval_is_named_at_once() -> None:
    answer = judged(flexible(17467.0, 1057.0), stiffness=-2200.0).answer
    assert str(answer).endswith("Do not rely on it yet: velocity_gain is 25 % smaller.")
    assert answer.trust.code is Trust.NOT_YET
    assert answer.trust.values["reasons"] == ["loop_not_as_declared"]


def test_a_fault_that_moves_other_parameters_leaves_the_value() -> None:
    answer = judged(RIGID, inertia=0.9, viscous=-27.0, coulomb=1.19).answer
    assert str(answer.trust) == "You can rely on it, but not on viscous and coulomb: velocity_gain is 25 % smaller"
    assert answer.trust.values["parameters"] == ["viscous", "coulomb"]
    within = "You can rely on it: what is wrong with loop or log moves it by less than its interval"
    assert str(judged(RIGID, inertia=0.9, viscous=-25.0).answer.trust) == within


@pytest.mark.parametrize("code", AGAINST_EVERY_VALUE)
def test_a_reason_against_every_value_is_in_the_answer(code: Reason) -> None:
    failed = Verdict(Subject.WHITENESS, Status.FAILED, (Message(code, "it is so"),))
    found = amended(RIGID, checks={"verdicts": (*judged(RIGID).checks.verdicts, failed)})
    assert (found.answer.trust.code, found.answer.trust.values["reasons"]) == (Trust.NOT_YET, [str(code)])


def test_a_cause_comes_before_its_effects() -> None:
    answer = amended(judged(RIGID, viscous=1.0), fit={"filtered_error": 0.4, "converged": False}).answer
    assert str(answer.trust) == ("Do not rely on it yet: velocity_gain is 25 % smaller; the search did not converge")
    assert answer.trust.values["reasons"] == ["loop_not_as_declared", "not_converged", "torque_unexplained"]
    assert str(amended(judged(RIGID), fit={"filtered_error": 0.4}).answer.trust).endswith(
        "40 % of the torque is not explained"
    )


def test_a_refused_stiffness_has_a_bound_and_no_value() -> None:
    bounds = (StiffnessBound(0.1, 4.1e5, 30.0), StiffnessBound(0.2, 3.1e5, 22.0), StiffnessBound(0.5, None, None))
    answer = amended(judged(flexible(None)), checks={"bounds": bounds}).answer
    least = "Stiffness not determined by this record: at least 310000 N m/rad, mode above 22 Hz"
    assert str(answer.found) == f"{least}, for a load of 10 to 20 % of the inertia"
    assert answer.found.values["lower_bound"] == 3.1e5
    assert str(answer.trust) == "Identify the joint as rigid, or record a motion that shows it"
    whole = physical(
        FlexibleJoint("prismatic").parameters,
        dict.fromkeys((p.name for p in FlexibleJoint("prismatic").parameters), "kg"),
    )
    total = next(Known(one, 95.24, 0.455, 0.005) for one in whole if one.quantity == "inertia")
    known = Identifiability((total,), ())
    told = amended(
        judged(flexible(None)), checks={"bounds": bounds[:2], "known": known}, fit={"converged": False}
    ).answer
    assert str(told).startswith(f"{least}. Identify the joint as rigid")
    assert str(told).endswith("; the whole inertia is 95.24 ± 0.91 kg.")
    assert (answer.found.code, answer.trust.code) == (Found.LOWER_BOUND, Trust.REFUSED)
    assert not answer.reliable
    assert str(judged(flexible(None)).answer.found) == "Stiffness not determined by this record"


def test_a_value_at_its_bound_and_one_that_is_wide_are_not_relied_on() -> None:
    answer = judged(flexible(1e-14, 1.0, at_bound=0.0)).answer
    assert str(answer).startswith("Stiffness 0 N m/rad, at its bound. Do not rely on it yet: at a bound it does not")
    assert "known to 60 % only" in str(judged(flexible(1000.0, 300.0)).answer.trust)


@pytest.mark.parametrize(
    ("method", "simulations", "measured"), [("idim", 0, True), ("drive_side", 9, True), ("idim", 3, False)]
)
@pytest.mark.parametrize("warning", ["", "a motion that a loop controls biases what is found along it"])
def test_a_motion_measured_under_control_is_in_the_answer_however_it_is_worded(
    method: str, simulations: int, measured: bool, warning: str
) -> None:
    fit, settings = {"simulations": simulations}, {"method": method, "loop": None}
    answer = amended(RIGID, checks={"warnings": (warning,)}, fit=fit, settings=settings).answer
    assert answer.trust.code is Trust.NOT_CHECKED
    assert answer.trust.values["reasons"] == ["motion_measured"] * measured


def test_a_parameter_at_its_bound_reads_it_and_the_verdict_says_so() -> None:
    """A friction that comes out negative is kept at 0 while the others are identified."""
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
    truth = {"inertia": 30.0, "viscous": -20.0, "coulomb": 15.0, "offset": 2.0}
    estimate = ji.identify(ji.simulated_record(loop, reference, truth, sample_time=1e-3), loop, checks=False)
    row = next(line for line in str(estimate).splitlines() if line.startswith("viscous"))
    assert row.split() == ["viscous", "b", "0", "N", "s/m", "-", "at", "its", "bound", "Fv"]
    (bounds,) = (v for v in estimate.checks.verdicts if v.subject is Subject.BOUNDS)
    assert bounds.status is Status.FAILED
    assert "Fv" not in str(bounds.said)
    assert "viscous" in bounds.said
    assert estimate.params["viscous"].at_bound == 0.0
    assert estimate.to_dict()["parameters"]["viscous"]["at_bound"] == 0.0


@pytest.mark.parametrize("std", [np.nan, np.inf])
def test_a_value_without_a_finite_interval_is_not_relied_on(std: float) -> None:
    answer = judged(flexible(1000.0, std)).answer
    assert (answer.trust.code, answer.trust.values["reasons"]) == (Trust.NOT_YET, ["no_interval"])


def test_a_value_of_zero_that_may_have_either_sign_is_not_relied_on() -> None:
    assert judged(flexible(0.0, 1.0)).answer.trust.values["reasons"] == ["wide_interval"]


def test_a_stiffness_behind_a_late_encoder_is_not_relied_on_but_an_inertia_is() -> None:
    lag = {"encoder_lag": EncoderLag("load_position", 0.0031, 0.97)}
    answer = amended(judged(flexible(1000.0, 10.0)), checks=lag).answer
    assert (answer.trust.code, answer.trust.values["reasons"]) == (Trust.NOT_YET, ["encoder_lag"])
    assert str(answer.trust) == "Do not rely on it yet: load_position seems 3.1 ms late, which hides the spring"
    assert amended(judged(RIGID), checks=lag).answer.reliable


def test_a_value_that_is_only_known_with_others_is_not_relied_on() -> None:
    found = judged(flexible(1000.0, 10.0))
    rows = tuple(replace(p, identifiable=False) if p.name == "stiffness" else p for p in found.params.rows)
    answer = amended(found, params={"rows": rows}).answer
    assert (answer.trust.code, answer.trust.values["reasons"]) == (Trust.NOT_YET, ["only_together"])


def test_an_error_that_is_no_number_is_not_relied_on() -> None:
    answer = amended(judged(RIGID), fit={"filtered_error": np.nan}).answer
    assert answer.trust.code is Trust.NOT_YET


def test_an_inertia_of_each_record_comes_before_what_they_share() -> None:
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
    truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    records = [ji.simulated_record(loop, reference, truth | {"inertia": m}, sample_time=1e-3) for m in (30.0, 45.0)]
    both = ji.identify(records, loop, several=ji.SeveralRecords(own=(("inertia",), ("inertia",))))
    assert str(both.answer).startswith("Inertia of record 1 30.0000")
    assert both[both.answer.found.values["parameter"]].value == pytest.approx(30.0)


def test_parameters_at_a_bound_make_up_for_a_fault_of_the_loop() -> None:
    """By how much the fault alone moves the stiffness says little where others give way: 28,210 came out for 20,000."""
    sound = judged(flexible(800000.0, 4000.0), damping=1.0).answer
    assert sound.reliable
    rows = flexible(800000.0, 4000.0)
    held = replace(rows.params.rows[2], stderr=None, free=False, at_bound=0.0)
    bound = amended(rows, params={"rows": (*rows.params.rows[:2], held)})
    answer = judged(bound, damping=1.0).answer
    assert not answer.reliable
    assert "velocity_gain is 25 % smaller; load inertia ends at a bound" in str(answer)
