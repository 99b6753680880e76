"""The answer in a line: its words to the letter, and which failed check speaks against which value."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import Message
from jointid.common.text import encodable
from jointid.common.transmission import Transmission
from jointid.estimation.result.answer import Found, Trust, consequence
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Params
from jointid.estimation.result.summary import bounds_table, field_symbol, parameters_table
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.checks import EncoderLag
from jointid.uncertainty.identifiability import Identifiability, Known, physical
from jointid.uncertainty.verdict import (
    AGAINST_EVERY_VALUE,
    MOTION_MEASURED,
    Reason,
    Status,
    StiffnessBound,
    Subject,
    Verdict,
)
from tests.estimates import amended
from tests.estimation.test_estimate import CONTROLLER, ESTIMATE, parameter
from tests.text import unwrapped

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
    found = replace(ESTIMATE, params=Params(rows, ("motor_inertia",), np.zeros((0, 0)), ""))
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


def test_a_fault_without_known_effect_speaks_against_everything() -> None:
    reason = Message(Reason.LOOP_NOT_AS_DECLARED, "torque and reference are swapped")
    wrong = amended(RIGID, checks={"verdicts": (Verdict(Subject.LOOP, Status.FAILED, (reason,)),)})
    assert str(wrong.answer.trust) == "Do not rely on it yet: torque and reference are swapped"


@pytest.mark.parametrize("code", AGAINST_EVERY_VALUE)
def test_a_reason_against_every_value_is_in_the_answer_and_beside_its_check(code: Reason) -> None:
    failed = Verdict(Subject.WHITENESS, Status.FAILED, (Message(code, "it is so"),))
    found = amended(RIGID, checks={"verdicts": (*judged(RIGID).checks.verdicts, failed)})
    assert str(found.answer.trust) == "Do not rely on it yet: it is so"
    assert consequence(found, failed) == f"Do not use the inertia: {AGAINST_EVERY_VALUE[code]}."


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
    known = Identifiability((), (total,), (), 1.0, ())
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


def test_what_was_not_checked_says_so() -> None:
    assert RIGID.answer.trust.code is Trust.NOT_CHECKED
    assert "not checked" in str(amended(judged(RIGID), checks={"verdicts": (_white(),)}).answer.trust)


def test_a_motion_measured_under_control_is_in_the_answer() -> None:
    answer = amended(RIGID, checks={"warnings": (MOTION_MEASURED,)}).answer
    assert "what disturbs it biases these values; identify by DIDIM" in str(answer.trust)
    assert answer.trust.values["reasons"] == ["motion_measured"]
    assert "another record" not in str(answer.trust)


def coloured(estimate: Estimate, asked: str) -> None:
    """The line on the checks of an estimate whose residual is coloured, and that of a verdict with three reasons."""
    reasons = tuple(Message(Reason.RESIDUAL_COLOURED, f"reason {k}") for k in (1, 2, 3))
    verdicts = (*judged(estimate).checks.verdicts, Verdict(Subject.WHITENESS, Status.FAILED, reasons))
    text = unwrapped(str(amended(estimate, checks={"verdicts": verdicts})))
    assert "reason 1 (and 2 more in the report)" in text
    assert "You can rely on it. parameter" in text
    assert f"whiteness noted reason 1 (and 2 more in the report); the {asked} may be used" in text
    assert "1 of 2 passed, 1 noted method" in text
    assert "whiteness noted reason 1, reason 2, reason 3; the " in unwrapped(
        amended(estimate, checks={"verdicts": verdicts}).summary(details=True)
    )


def test_the_number_of_checks_that_passed_does_not_contradict_the_answer() -> None:
    coloured(RIGID, "inertia")
    coloured(flexible(1000.0, 10.0), "stiffness")
    text = unwrapped(str(judged(RIGID, inertia=30.0)))
    assert "Do not rely on it yet" in text
    assert "loop no velocity_gain is 25 % smaller" in text, "it speaks against the answer, so it is not only noted"
    assert "0 of 1 passed method" in text


def test_the_field_s_letters_stand_in_the_table_and_remarks_are_explained_below_it() -> None:
    rows = (*flexible(1000.0, 10.0).params.rows, parameter("damping", "F12", "N m s/rad", 1.0, 0.1))
    estimate = replace(flexible(1000.0, 10.0), params=Params(rows, ("motor_inertia",), np.zeros((0, 0)), ""))
    text = str(judged(estimate, damping=1.0))
    assert "loop: how much the value changes once the fault of loop or log is corrected" in unwrapped(text)
    assert "loop:" not in str(judged(estimate)).partition("method")[0]
    values = {"changes": {"damping": 1.0}, "condition": "it is so"}
    undecided = Verdict(Subject.LOOP, Status.UNKNOWN, (Message(Reason.LAW_UNDECIDED, "it may be", values),))
    text = str(amended(estimate, checks={"verdicts": (undecided,)}))
    assert "loop: how much the value changes if the drive runs the other law" in text.splitlines()
    first = parameter("initial_torque", "u(0)", "N m", 1.0, 0.1)
    begun = replace(estimate, params=Params((*rows, first), ("motor_inertia",), np.zeros((0, 0)), ""))
    assert "initial torque" in begun.summary(details=True)
    assert "u(0)" not in str(begun)
    cells = [(row[0], row[1], row[-1]) for row in parameters_table(estimate).rows]
    assert cells == [
        ("motor inertia", "J_M", "ZZ1"),
        ("stiffness", "c", "K12"),
        ("load inertia", "J_L", "ZZ2"),
        ("damping", "d", "F12"),
    ]


@pytest.mark.parametrize(
    ("name", "unit", "letter"),
    [
        ("inertia", "kg", "m"), ("motor_inertia", "kg m^2", "J_M"), ("load_viscous@2", "N s/m", "b_L"),
        ("coulomb", "N m", "T_C"), ("motor_coulomb_backwards", "N", "F_CM-"), ("elbow.rotor_inertia", "kg m^2", "J_M"),
        ("elbow.link_coulomb", "N m", "T_CL"), ("offset", "N", ""), ("initial_velocity", "m/s", ""),
        ("Izz1", "kg m^2", ""),
    ],
)  # fmt: skip
def test_the_letter_of_a_parameter_in_the_field(name: str, unit: str, letter: str) -> None:
    assert field_symbol(parameter(name, "x", unit, 1.0, 0.1)) == letter


def test_an_estimate_can_be_printed_where_there_is_no_plus_minus_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", out)
    print(judged(RIGID))
    out.flush()
    assert out.buffer.getvalue().startswith(b"Inertia 94.90 +- 0.92 kg.")  # type: ignore[attr-defined]


def test_bounds_are_written_in_one_way() -> None:
    bounds = (StiffnessBound(0.1, 152982.0, 30.0), StiffnessBound(0.2, 1.2e6, 22.0), StiffnessBound(0.5, None, None))
    table = bounds_table(amended(flexible(None), checks={"bounds": bounds}))
    assert table is not None
    assert [row[1] for row in table.rows] == ["1.53e+05", "1.20e+06", "not bounded"]
    table = bounds_table(amended(flexible(None), checks={"bounds": bounds[:1]}))
    assert table is not None
    assert table.rows[0][1] == "153000"


def _white() -> Verdict:
    return Verdict(Subject.WHITENESS, Status.PASSED, (Message(Reason.RESIDUAL_WHITE, "white"),))


def test_the_table_marks_what_a_fault_changes_and_what_is_only_known_with_another() -> None:
    pair = Message("inseparable", "", {"parameters": ["viscous", "coulomb"]})  # type: ignore[arg-type]
    known = Identifiability((), (), (), 1.0, (pair,))
    marked = amended(judged(RIGID, inertia=0.1, coulomb=1.19), checks={"known": known})
    text = marked.to_document().text(100)
    lines = {line.split()[0]: line for line in text.splitlines() if line}
    assert lines["parameter"].split()[-2:] == ["remark", "symbol"]
    assert lines["coulomb"].endswith("loop: +1.19, only with Fv  Fc")
    assert lines["viscous"].split()[-4:] == ["only", "with", "Fc", "Fv"]
    assert "loop" not in lines["inertia"]  # moved by less than half of its standard error
    assert "velocity_gain is 25 % smaller" in text
    assert "p < 1e-6" not in text
    assert "p < 1e-6" in unwrapped(judged(RIGID, coulomb=1.19).summary(details=True))


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


def test_no_line_is_longer_than_80_characters() -> None:
    pair = Message("inseparable", "", {"parameters": ["viscous", "coulomb"]})  # type: ignore[arg-type]
    long = amended(
        judged(RIGID, coulomb=1.19),
        checks={"known": Identifiability((), (), (), 1.0, (pair,)), "warnings": ("word " * 60,)},
        settings={"system": RigidJoint("prismatic", transmission=Transmission(load="prismatic", lead=0.01))},
    )
    for details in (False, True):
        assert max(map(len, long.summary(details=details).splitlines())) <= 80
    assert "motor side" in str(long)


def test_an_estimate_is_represented_by_its_answer() -> None:
    assert repr(judged(RIGID)) == "<Estimate of a rigid joint by didim: Inertia 94.90 ± 0.92 kg. You can rely on it.>"


def test_a_name_that_there_is_not_is_answered_by_the_nearest() -> None:
    with pytest.raises(KeyError, match="did you mean inertia") as caught:
        RIGID.params["inerta"]
    assert str(caught.value).startswith('"inerta" is no parameter of this estimate; it has inertia, viscous, coulomb')
    assert isinstance(caught.value, ji.MethodError)


@pytest.mark.parametrize(("encoding", "shown"), [("utf-8", "94.90 ± 0.92"), ("ascii", "94.90 +- 0.92")])
def test_a_terminal_without_the_sign_gets_plus_and_minus(encoding: str, shown: str) -> None:
    assert encodable("94.90 ± 0.92", encoding) == shown


@pytest.mark.parametrize("std", [np.nan, np.inf])
def test_a_value_without_a_finite_interval_is_not_relied_on(std: float) -> None:
    answer = judged(flexible(1000.0, std)).answer
    assert (answer.trust.code, answer.trust.values["reasons"]) == (Trust.NOT_YET, ["no_interval"])


def test_a_value_of_zero_that_may_have_either_sign_is_not_relied_on() -> None:
    assert judged(flexible(0.0, 1.0)).answer.trust.values["reasons"] == ["wide_interval"]


def test_a_stiffness_behind_a_late_encoder_is_not_relied_on_but_an_inertia_is() -> None:
    lag = {"encoder_lag": EncoderLag("load_position", "motor_position", 0.0031, 0.97)}
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


def test_a_value_that_was_declared_is_not_said_to_be_found() -> None:
    rows = tuple(replace(p, free=False, stderr=None) for p in RIGID.params.rows)
    answer = judged(amended(RIGID, params={"rows": rows})).answer
    assert str(answer) == "Inertia 94.903 kg (fixed). It was declared, not identified."
    assert not answer.reliable


def test_a_rigid_joint_is_not_advised_to_be_identified_as_rigid() -> None:
    refused = replace(RIGID.params["inertia"], value=None, stderr=None)
    answer = judged(amended(RIGID, params={"rows": (refused,)})).answer
    assert str(answer.trust) == "Record a motion that shows it"


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


def correlated(share: float, **stiffness: object) -> Estimate:
    """A flexible joint whose errors of motor inertia and stiffness have this correlation."""
    estimate = flexible(1000.0, 10.0, **stiffness)
    names = tuple(row.name for row in estimate.params.rows)
    correlation = np.array([[1.0, share, 0.3], [share, 1.0, 0.2], [0.3, 0.2, 1.0]])
    return replace(estimate, params=Params(estimate.params.rows, names, correlation, ""))


def test_the_value_of_a_data_sheet_that_sharpens_the_stiffness_is_said_with_its_effect() -> None:
    estimate = correlated(0.97)
    known = np.linalg.inv(estimate.params.covariance)[1:, 1:]  # what the record tells of the others, inertia given
    times = 10.0 / np.sqrt(np.linalg.inv(known)[0, 0])
    said = f"give the motor inertia from its data sheet, and the stiffness is {times:.2g} times as sharp"
    assert said in unwrapped(str(estimate))


@pytest.mark.parametrize("estimate", [correlated(0.6), correlated(0.97, lack_of_fit=20.0)])
def test_a_data_sheet_that_helps_little_is_not_asked_for(estimate: Estimate) -> None:
    """By a quarter only; or by nothing, where it is what the model lacks that makes the interval wide."""
    assert "and the stiffness is" not in unwrapped(str(estimate))


def test_a_data_sheet_of_an_axis_is_asked_for_by_its_name() -> None:
    names = {"motor_inertia": "elbow.rotor_inertia", "stiffness": "elbow.stiffness", "load_inertia": "Izz2"}
    estimate = correlated(0.97)
    rows = tuple(replace(row, name=names[row.name], axis="elbow") for row in estimate.params.rows)
    params = replace(estimate.params, rows=rows, names=tuple(names.values()))
    assert "give the rotor inertia of elbow from its data sheet, and the stiffness is" in unwrapped(
        str(replace(estimate, params=params))
    )
