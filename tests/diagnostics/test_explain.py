"""The cause that is named where a record does not fit the declared drive: twenty mistakes on two axes."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import FaultsError, MethodError, RecordError
from jointid.diagnostics import explain as searching
from jointid.diagnostics import identify as identifying
from jointid.diagnostics.analysis import rebuild_problem
from jointid.diagnostics.changes import _IS_ABOUT, CHANGES, _say_factor, _say_number
from jointid.diagnostics.explain import Case, Cause, explain_failure, find_causes, is_small, list_cases
from jointid.diagnostics.model_free import find_plain_cause, find_unexplained_share
from jointid.diagnostics.score import SolvedLoop
from jointid.diagnostics.suspects import FAULTS
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.verdict import Reason, Subject
from jointid.estimation.spring_search import _mode_of
from jointid.models.controllers import Cascade, FirstOrder, Notch, with_numbers
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.paper.twin import twin
from jointid.records.record import Tap
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.healthy import drive
from studies.setpoints import judge
from tests import mistakes
from tests.edits import Edit, changes, declares, has, late_by, log, slower
from tests.estimates import faults_of, identify
from tests.mistakes import MISTAKES, MORE, SMOOTH, AxisName, axis, tell, without_mistake, without_positions

SLOW = pytest.mark.slow
BY_NAME = {mistake.name: mistake for mistake in MISTAKES}


@pytest.mark.slow
def test_two_mistakes_that_no_number_makes_up_for_are_said_to_be_more_than_one() -> None:
    record, loop = BY_NAME["torque ten times as large"].make(axis("direct"), 1)
    gains = {"position_gain": 3 * loop.controller.position_gain}  # type: ignore[attr-defined]
    causes = find_causes(record, replace(loop, controller=with_numbers(loop.controller, gains)))
    assert causes.explanations == ()
    assert causes.nearest is not None and causes.nearest.left > 1.15 * causes.unexplained
    assert causes.message.code is Reason.NO_CAUSE_FOUND


def test_sample_times_that_the_declared_period_allows_are_tried() -> None:
    record, loop = without_mistake(axis("rigid"))
    loop = replace(loop, controller=replace(loop.controller, period=axis("rigid").rate / 4))  # type: ignore[type-var]
    declared = Case(record, loop, ji.Filtering().resolve(axis("rigid").rate, "rigid"))
    tried = [one.factor for one in list_cases(declared) if one.change is not None and one.change.name == "sample_time"]
    assert tried == [0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0]
    kinds = {"velocity_filter": FirstOrder(1e-3)}, {"velocity_filter": ji.controller.MovingAverage(4)}
    for kind, fewer in ((kinds[0], True), (kinds[1], False), ({"interpolation": "hold"}, False)):
        other = declared.under(replace(loop.controller, **kind))
        assert (searching._pose(other, other.loop).axis.law.period > declared.period) is fewer
    notch = declared.under(replace(loop.controller, torque_filters=(ji.controller.Notch(2.0 / declared.period, 10.0),)))
    assert searching._pose(notch, notch.loop) is None


def test_no_time_constant_is_near_a_filter_of_another_kind_and_a_late_log_is_told_by_an_injected_signal() -> None:
    declared = Case(*without_mistake(axis("flexible")), ji.Filtering())
    assert not is_small(Cause("velocity_filter", "", 1e-6), declared)
    (late,) = (one for one in CHANGES if one.name == "reference_delay")
    each = (replace(declared, record=Mock(injected=one)) for one in (None, declared.torque))
    assert ["log" in cause.words for case in each for cause in late.say(2e-3, case)] == [True, False]


def test_a_search_takes_the_beginning_of_a_long_record_that_moves_both_ways() -> None:
    record, _ = without_mistake(axis("fast"))  # of 8 s, at 4 kHz
    moves = np.argmax(np.diff(record.reference.values) != 0.0) / 4e3
    assert searching.begin_records([record], 5.0)[0].duration == pytest.approx(moves + 5.0, abs=1e-3)
    one_way = record.with_channels({"reference": replace(record.reference, values=np.arange(32_000.0))})
    assert all(searching.begin_records(each, to) is each for each, to in (([one_way], 5.0), ([record], 9.0)))


def test_share_that_is_no_response_to_the_reference_needs_no_drive() -> None:
    record, loop = without_mistake(axis("direct"))
    right = identify(record, loop)
    for gain, out in ((0.1, ()), (1.0, ()), (1.0, ((2.0, 2.5), (4.0, 4.2)))):
        other = replace(loop, controller=with_numbers(loop.controller, {"gain": gain}))
        problem = torque_problem(replace(record, left_out=out), other, right.settings.filtering, loop.joint.parameters)
        share = find_unexplained_share(problem, record.reference.values)
        assert share == pytest.approx(right.fit.filtered_error, rel=0.15)
        assert find_unexplained_share(problem, record.reference.values[::-1].copy()) > 0.5


@pytest.mark.parametrize("failure", [MethodError("the search failed"), np.linalg.LinAlgError("no convergence")])
def test_a_search_that_fails_hides_no_error_and_ends_no_identification(failure: Exception, monkeypatch: Any) -> None:
    record, loop = without_mistake(axis("rigid"))
    monkeypatch.setattr(searching, "find_causes", Mock(side_effect=failure))
    raised = RecordError("it is wrong.")
    assert explain_failure(raised, record, loop, print) is raised
    monkeypatch.setattr(identifying, "explain_misfit", Mock(side_effect=failure))
    assert ji.identify(record, loop).checks[-1].name is Subject.LOOP


@pytest.mark.slow
def test_a_factor_that_putting_right_does_not_help_is_not_blamed() -> None:
    healthy = twin("L19", noise="white")
    record = healthy.record.without("motor_position", "load_position")
    loop = replace(healthy.loop, joint=healthy.loop.joint.rigid)
    estimate = ji.identify(record, loop)
    [reason] = estimate.about(Subject.LOOP)
    [cause] = reason.values["causes"]
    assert (reason.code, cause["cause"]) == (Reason.CAUSE_FOUND, "flexible")
    assert cause["value"] == pytest.approx(31.4, rel=0.1)  # Hz, the twin's mode
    assert not estimate.answer.reliable


@pytest.mark.slow
def test_a_friction_that_is_smooth_at_rest_is_that_of_stribeck_and_does_not_wind_up() -> None:
    record, loop = SMOOTH.make(axis("rigid"), 1)
    laws = (replace(loop, joint=replace(loop.joint, friction=Friction(law))) for law in ("presliding", "stribeck"))
    wound, right = (identify(record, law) for law in laws)
    found = {one.name: one for one in SolvedLoop(*rebuild_problem(wound, record)).tests}["presliding"]
    assert found.p_value < 0.01 and '"stribeck"' in found.fault.remedy
    assert right.fit.filtered_error < 0.8 * wound.fit.filtered_error and right["stribeck_force"].value < 0.0


@pytest.mark.slow
def test_a_gross_fault_that_has_a_cause_is_not_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.diagnostics.search.test_laws", lambda _: [])
    for mistake, corrected in (("delay forgotten", True), ("torque constant said twice", False)):  # a time is
        record, loop = BY_NAME[mistake].make(axis("rigid"), 1)
        estimate = identify(record, loop)
        *_, last = faults_of(estimate, record, explain=lambda found: found[-1].value is None).findings
        assert (last.value is not None) is corrected
        assert len(faults_of(estimate, record, explain=lambda _: True).findings) == 1  # its cause ends the search


@pytest.mark.slow
def test_a_law_is_the_answer_where_a_record_is_too_short_for_free_responses() -> None:
    said = judge(0, "average", 2.5)
    assert said is not None and said.named[:1] == ("averaged_reference",)


@pytest.mark.parametrize("name", ["rigid", *(pytest.param(one, marks=SLOW) for one in ("direct", "screw"))])
@pytest.mark.parametrize("mistake", MORE, ids=[one.name for one in MORE])
def test_what_the_samples_show_is_said_without_a_search(name: AxisName, mistake: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(searching, "list_cases", Mock(side_effect=AssertionError("causes were put right in turn")))
    assert set(tell(*mistake.make(axis(name), 1))[0]) == mistake.right


@pytest.mark.parametrize("name", ["rigid", "flexible", "direct", "screw", "fast", "lift"])
def test_nothing_is_plain_of_a_healthy_record(name: AxisName) -> None:
    assert find_plain_cause(without_mistake(axis(name))[0]) is None


def test_a_record_too_short_is_not_relied_on_however_well_it_fits() -> None:
    """The frictions of a flexible axis came out wrong at 0.3 s."""
    law = Cascade(position_gain=40.0, velocity_gain=2000.0)
    loop = ClosedLoop(RigidJoint("prismatic"), law)
    values = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    for seconds, reliable in ((0.7, False), (3.0, True)):
        reference = trapezoids((0.1,), 2.0, 0.02, 1e-3, rest=0.02, duration=seconds)
        noise = 0.1 * np.random.default_rng(1).standard_normal(reference.size)
        record = simulated_record(loop, reference, values, sample_time=1e-3, torque_noise=noise)
        assert ji.identify(record, loop).answer.reliable is reliable


@pytest.mark.slow
@pytest.mark.parametrize("times", [180 / np.pi, np.pi / 180])
def test_gain_in_degrees_is_told_beside_an_unknown_delay(times: float) -> None:
    law = ji.controller.PD(position_gain=60.0, derivative_gain=4.0, period=1e-3)
    reference = trapezoids((0.5, 1.0), 10.0, 1.0, 4e-3, duration=4.0)
    pulses = ji.excitation.pulses(reference.size, 4e-3, height=3.0, width=0.05, every=0.3, seed=0)
    loop = ClosedLoop(RigidJoint("revolute"), replace(law, delay=4e-3))
    truth = {"inertia": 0.1, "viscous": 0.2, "coulomb": 0.4, "offset": 0.0}
    noise = 0.03 * np.random.default_rng(0).standard_normal(reference.size)
    record = simulated_record(loop, reference, truth, sample_time=4e-3, injected=pulses, torque_noise=noise)
    wrong = replace(loop, controller=replace(law, derivative_gain=times * law.derivative_gain))
    first = find_causes(record.without("motor_position"), wrong, free=("delay",)).explanations[0]
    assert (first.name, first.value) == ("derivative_gain", pytest.approx(law.derivative_gain, rel=0.05))
    assert first.left < 0.03


LAW = Cascade(position_gain=20.0, velocity_gain=434.0, integral_gain=33.0, velocity_filter=FirstOrder(0.4e-3))
SPRING = ClosedLoop(FlexibleJoint("revolute"), LAW)


def run_spring(seconds: float, loop: ClosedLoop = SPRING, **undeclared: Any) -> ji.Record:
    """The record of the flexible axis above, with noise, under a law with more than is declared."""
    truth = {
        "motor_inertia": 1.5, "motor_viscous": 12.0, "motor_coulomb": 14.0, "stiffness": 4e4, "damping": 20.0,
        "load_inertia": 3.0, "load_viscous": 6.0, "load_coulomb": 9.0, "offset": 1.0,
    }  # fmt: skip
    loop = replace(loop, controller=replace(loop.controller, **undeclared))  # type: ignore[type-var]
    reference = trapezoids((2.0, 3.0), 25.0, 0.8, 1e-3, duration=seconds)
    noise = np.random.default_rng(1).normal(0.0, 0.6, len(reference))
    return simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise)


def test_another_gear_is_said_with_its_ratio_and_an_integral_gain_with_its_time() -> None:
    record = ji.Record(torque=ji.Channel(np.zeros(2), "N m", 1e-3))
    turns, slides = ji.Transmission(load="revolute", ratio=5.0, sign=-1), ji.Transmission(load="prismatic", lead=0.1)
    for gear, factor, first, size in (
        *((None, times, "law_gain", f"{times:.1f}:1") for times in (3**0.5, 2.0, 8**0.5)),  # of currents, or twice
        *((None, times, "reference_scale", ":1") for times in (4.0, 10.0, 50.0)),
        (None, 0.5, "law_gain", "about 2.0 times too large"),
        (turns, 10.0, "law_gain", "50:1"),
        (slides, 10.0, "law_gain", "10 mm"),
    ):
        joint = FlexibleJoint("revolute" if gear is None else gear.load, transmission=gear)
        case = Case(record, ClosedLoop(joint, LAW), ji.Filtering())
        said = {one.name: one.words for one in _say_factor(False, factor, case)}
        assert next(iter(said)) == first and said["reference_scale"].endswith(size)
    assert "(Tn 30.0 ms)" in next(iter(_say_number("integral_gain", _IS_ABOUT, 1e3 / 30, case))).words


GEAR = ji.Transmission(load="revolute", ratio=50.0)
OWN = ClosedLoop(FlexibleJoint("revolute", transmission=GEAR), replace(LAW, ratio=50.0, gain=0.62, velocity_gain=0.283))


def _no_gear(one: Any) -> None:
    log("torque", lambda x: x / 50.0)(one)
    one.model, one.declared = FlexibleJoint("revolute"), replace(one.declared, ratio=1.0)


FIRST: dict[str, tuple[str, tuple[Edit, ...]]] = {  # of 24 mistakes, and of what is none or no record shows
    "none": ("", ()),
    "setpoint for actual current": ("", (has(torque_filters=(FirstOrder(5e-5),)),)),
    "torque constant": ("", (log("torque", lambda x: 1.41 * x), declares(gain=1.41 * 0.62))),
    "torque filter": ("torque_filter", (has(torque_filters=(FirstOrder(1.5e-3),)),)),
    "notch": ("notch", (has(torque_filters=(Notch(60.0, 84.0, 0.15),)),)),
    "dead time": ("delay", (has(delay=1e-3),)),
    "log late": ("log_delay", (has(delay=1e-3), declares(delay=1e-3), log("torque", late_by(1)))),
    "reference late": ("log_delay", (log("reference", late_by(2)),)),
    "limit": ("limit", (has(limit=2.4),)),
    "period": ("period", (has(period=1.25e-4),)),
    "velocity filter": ("velocity_filter", (has(velocity_filter=FirstOrder(3e-3)),)),
    "feed-forward": ("velocity_feedforward", (has(velocity_feedforward=1.0),)),
    "Tn in s": ("integral_gain", (declares(integral_gain=1 / 30),)),
    "Kp twice": ("law_gain", (declares(velocity_gain=0.566),)),
    "Kp in N m": ("law_gain", (has(period=1.25e-4), declares(period=1.25e-4, velocity_gain=0.283 / 0.62))),
    "Kv twice": ("position_gain", (declares(position_gain=40.0),)),
    "Kv in 1/min": ("position_gain", (declares(position_gain=1200.0),)),
    "sign": ("torque_sign", (log("torque", np.negative),)),
    "gear forgotten": ("reference_scale", (_no_gear,)),
    "ratio 5": ("law_gain", (mistakes.other_ratio,)),
    "side": ("gear_side", (log("reference", lambda x: x / 50.0),)),
    "degrees for rad": ("reference_scale", (log("reference", np.degrees),)),
    "mm for m": ("reference_scale", (log("reference", lambda x: 1e3 * x),)),
    "sample time": ("sample_time", (slower(0.5),)),
    "wrong column": ("", (log("torque", lambda x: np.roll(x[::-1], 777)),)),
    "encoder": ("reference_is_position", (changes(mistakes.give_position_as_reference),)),
}


@pytest.mark.parametrize("name", ["none", *(pytest.param(one, marks=SLOW) for one in FIRST if one != "none")])
def test_the_first_cause_is_the_mistake(name: str) -> None:
    first, edits = FIRST[name]
    one = SimpleNamespace(law=OWN.controller, declared=OWN.controller, model=OWN.joint, edits=[])
    for edit in edits:
        edit(one)
    record = run_spring(8.0, replace(OWN, controller=one.law))
    for change in one.edits:
        record = change(record)
    record, loop = without_positions(record), ClosedLoop(one.model, one.declared)
    named, said = tell(record, loop)
    assert named[:1] == ((first,) if first else ()), said
    if name == "log late":  # as an actual torque is, by the delay
        assert 'tap = "measured"' in FAULTS["log_delay"].remedy and not tell(replace(record, tap=Tap.MEASURED), loop)[0]
    assert ("You can rely" in said) is (first == "" and name != "wrong column")
    assert "1/min" in said or name != "Kv in 1/min"


def test_cases_start_again_at_the_joint_of_the_best_case() -> None:
    case = Case(without_positions(run_spring(2.5)), SPRING, ji.Filtering().resolve(1e-3, "flexible")).at(
        "delay", (1e-3, 2e-3)
    )
    assert searching._pose(case, SPRING, low=True).filtering.cutoff == pytest.approx(5.0)  # as rigid first
    problem: Any = searching._pose(case, SPRING)
    fit, best = (searching.Fit(case, problem, by * np.ones(len(problem.free))) for by in (1e-3, 2e-3))
    assert {one.problem.values(one.x)["stiffness"] for one in searching._list_flexible_starts(fit, best)} == {2e-3}
    assert _mode_of(dict.fromkeys(("motor_inertia", "load_inertia", "stiffness"), 1.0) | {"damping": 2.0}, 1e-3) == 1e3


@SLOW
def test_no_step_leads_to_a_mode_that_the_log_cannot_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, linearise = list[float](), ClosedLoopProblem.linearise
    note = lambda p, x: tried.append(p.values(x).get("stiffness", 0.0)) or linearise(p, x)  # type: ignore[func-returns-value]  # noqa: E731
    monkeypatch.setattr(ClosedLoopProblem, "linearise", note)
    assert identify(without_positions(run_spring(2.5, velocity_feedforward=1.0)), SPRING)["stiffness"].value is None
    assert 1e5 < max(tried) < 1e9


@pytest.mark.slow
def test_a_gain_that_is_little_off_is_named_only_where_no_test_gives_it() -> None:
    wrong = replace(SPRING, controller=with_numbers(LAW, {"velocity_gain": 434.0 / 1.25}))
    record = without_positions(run_spring(2.5))
    found = ji.identify(record, wrong, checks=False)
    refused = replace(found, rows=tuple(replace(row, value=None) for row in found.rows))
    causes = [find_causes(record, wrong, one).explanations for one in (found, refused)]
    assert not causes[0] and causes[1][0].value == pytest.approx(1.25, rel=0.05)


def test_the_cause_of_a_misfit_without_a_fault_is_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    record, loop = without_mistake(axis("rigid"))
    [one] = ji.identify(record, loop).diagnosis.axes
    asked, vague = Mock(return_value=()), replace(one, faults=replace(one.faults, findings=(), explained=0.0))
    assert "would explain" not in str(vague.faults.reasons[0])
    monkeypatch.setattr(identifying, "explain_misfit", asked)
    monkeypatch.setattr(identifying, "diagnose_joint", lambda *_, **__: Mock(axes=(vague,)))
    ji.identify(record, loop)
    assert asked.call_args.args[2] is None


def test_the_error_of_a_failure_with_a_cause_keeps_its_type(monkeypatch: pytest.MonkeyPatch) -> None:
    cause = Cause("torque_sign", "the torque has the wrong sign", left=0.01)
    monkeypatch.setattr(searching, "find_causes", lambda *_, **__: searching.Causes(0.9, (cause,)))
    record, loop = without_mistake(axis("rigid"))
    for error in (MethodError("it failed."), FaultsError(["it is wrong.", "it is late."])):
        told = explain_failure(error, record, loop, print)
        assert (type(told), told.code) == (type(error), "torque_sign") and cause.words in str(told)
        assert ("it is late" in str(told)) is isinstance(error, FaultsError)


@pytest.mark.slow
def test_a_refused_spring_is_no_reason_to_look_for_a_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = drive(323, 12.0)
    monkeypatch.setattr(searching, "find_causes", lambda *_, **__: pytest.fail("it was asked"))
    found = ji.identify(plant.record, plant.loop)
    assert found["stiffness"].value is None and found.checks[-1].passed
