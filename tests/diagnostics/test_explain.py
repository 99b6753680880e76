"""The cause that is named where a record does not fit the declared drive: twenty mistakes on two axes."""

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import FaultsError, JointidError, MethodError, RecordError
from jointid.diagnostics import explain as searching
from jointid.diagnostics import identify as identifying
from jointid.diagnostics.analysis import rebuild_problem
from jointid.diagnostics.changes import _IS_ABOUT, CHANGES, _say_factor, _say_number
from jointid.diagnostics.explain import Case, Cause, explain_failure, find_causes, is_small, list_cases
from jointid.diagnostics.model_free import find_plain_cause, find_unexplained_share
from jointid.diagnostics.score import SolvedLoop
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.verdict import Reason, Subject
from jointid.estimation.spring_search import _mode_of
from jointid.models.controllers import Cascade, FirstOrder, Notch, with_numbers
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.paper.twin import twin
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.healthy import drive
from studies.setpoints import judge
from tests.estimates import faults_of, identify
from tests.mistakes import MISTAKES, MORE, SMOOTH, AxisName, axis, cut, tell, without_mistake, without_positions

BY_NAME = {mistake.name: mistake for mistake in MISTAKES}
SLOWER = ("torque turned round", "reference in degrees", "sample time ten times as long")


@pytest.mark.parametrize(
    "name", ["torque and reference swapped", *(pytest.param(name, marks=pytest.mark.slow) for name in SLOWER)]
)
def test_names_the_cause_of_a_record_that_nothing_can_be_identified_from(name: str) -> None:
    record, loop = BY_NAME[name].make(axis("rigid"), 1)
    with pytest.raises(JointidError) as raised:
        identify(record, loop)
    told = explain_failure(raised.value, record, loop)
    assert type(told) is type(raised.value)
    assert not str(told).startswith(str(raised.value))
    assert (str(raised.value) in str(told)) is isinstance(raised.value, FaultsError)


@pytest.mark.slow
def test_two_mistakes_that_no_number_makes_up_for_are_said_to_be_more_than_one() -> None:
    record, loop = BY_NAME["torque ten times as large"].make(axis("direct"), 1)
    gains = {"position_gain": 3 * loop.controller.position_gain}  # type: ignore[attr-defined]
    causes = find_causes(record, replace(loop, controller=with_numbers(loop.controller, gains)))
    assert causes.explanations == ()
    assert causes.nearest is not None and causes.nearest.left > 1.15 * causes.unexplained
    assert causes.message.code is Reason.NO_CAUSE_FOUND


def test_a_limit_that_cuts_much_of_the_torque_is_found_from_larger_inertias() -> None:
    law, joint = Cascade(position_gain=20.0, velocity_gain=440.0, integral_gain=33.0), RigidJoint("revolute")
    truth = {"inertia": 4.5, "viscous": 13.0, "coulomb": 18.0, "offset": 0.0}
    reference = trapezoids((1.0, 2.0, 3.0), 30.0, 1.0, 1e-3, duration=6.0)
    record = simulated_record(ClosedLoop(joint, replace(law, limit=75.0)), reference, truth, sample_time=1e-3)
    declared = Case(record, ClosedLoop(joint, law), ji.Filtering().resolve(1e-3, "rigid"))
    starts = [searching._list_rigid_starts(one) for one in list_cases(declared) if one.free == "limit"]
    assert searching._race(starts)[0].number == pytest.approx(75.0, rel=2e-3)


def test_sample_times_that_the_declared_period_allows_are_tried() -> None:
    record, loop = without_mistake(axis("rigid"))
    loop = replace(loop, controller=replace(loop.controller, period=axis("rigid").rate / 4))  # type: ignore[type-var]
    declared = Case(record, loop, ji.Filtering().resolve(axis("rigid").rate, "rigid"))
    tried = [one.factor for one in list_cases(declared) if one.change is not None and one.change.name == "sample_time"]
    assert tried == [0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0]
    kinds = {"velocity_filter": FirstOrder(1e-3)}, {"velocity_filter": ji.controller.MovingAverage(4)}
    for kind, slower in ((kinds[0], True), (kinds[1], False), ({"interpolation": "hold"}, False)):
        other = declared.under(replace(loop.controller, **kind))
        assert (searching._pose(other, other.loop).axis.law.period > declared.period) is slower
    notch = declared.under(replace(loop.controller, torque_filters=(ji.controller.Notch(2.0 / declared.period, 10.0),)))
    assert searching._pose(notch, notch.loop) is None


def test_no_time_constant_is_near_a_filter_of_another_kind_and_a_late_log_is_told_by_an_injected_signal() -> None:
    declared = Case(*without_mistake(axis("flexible")), ji.Filtering())
    assert not is_small(Cause("velocity_filter", "", 1e-6), declared)
    (late,) = (one for one in CHANGES if one.name == "reference_delay")
    each = (replace(declared, record=Mock(injected=one)) for one in (None, declared.torque))
    assert ["log" in cause.words for case in each for cause in late.say(2e-3, case)] == [True, False]


def test_a_search_takes_the_beginning_of_a_long_record_that_moves_both_ways() -> None:
    record, loop = without_mistake(axis("fast"))  # of 8 s, at 4 kHz
    moves = np.argmax(np.diff(record.reference.values) != 0.0) / 4e3
    assert searching._begin(Case(record, loop, ji.Filtering())).torque.duration == pytest.approx(moves + 5.0, abs=1e-3)
    one_way = record.with_channels({"reference": replace(record.reference, values=np.arange(32_000.0))})
    assert searching._begin(Case(one_way, loop, ji.Filtering())).record is one_way


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
    assert explain_failure(raised, record, loop) is raised
    monkeypatch.setattr(identifying, "explain_misfit", Mock(side_effect=failure))
    assert ji.identify(record, loop).checks[-1].name is Subject.LOOP


@pytest.mark.slow
def test_a_factor_that_putting_right_does_not_help_is_not_blamed() -> None:
    """A flexible joint that is taken for a rigid one, up to beyond its resonance: the drive is as declared."""
    healthy = twin("L19", noise="white")
    record = healthy.record.without("motor_position", "load_position")
    loop = replace(healthy.loop, joint=healthy.loop.joint.rigid)
    estimate = ji.identify(record, loop)
    [reason] = estimate.about(Subject.LOOP)
    [cause] = reason.values["causes"]
    assert (reason.code, cause["cause"]) == (Reason.CAUSE_FOUND, "flexible")
    assert cause["value"] == pytest.approx(31.4, rel=0.1)  # Hz, the twin's mode
    assert not estimate.answer.reliable


@pytest.mark.parametrize("mistake", ["torque constant said twice", "velocity_gain twice as large"])
def test_a_number_that_is_far_off_is_named_behind_a_law_that_explains_nearly_all(mistake: str) -> None:
    assert BY_NAME[mistake].right & {*tell(*BY_NAME[mistake].make(axis("rigid"), 1))[0]}


def test_a_fault_is_none_that_leaves_more_when_it_is_corrected() -> None:
    assert "load_dependent_friction" not in tell(*SMOOTH.make(axis("screw"), 1))[0]


def test_a_friction_that_is_smooth_at_rest_is_that_of_stribeck_and_does_not_wind_up() -> None:
    record, loop = SMOOTH.make(axis("rigid"), 1)
    laws = (replace(loop, joint=replace(loop.joint, friction=Friction(law))) for law in ("presliding", "stribeck"))
    wound, right = (identify(record, law) for law in laws)
    found = {one.name: one for one in SolvedLoop(*rebuild_problem(wound, record)).tests}["presliding"]
    assert found.p_value < 0.01 and '"stribeck"' in found.fault.remedy
    assert right.fit.filtered_error < 0.8 * wound.fit.filtered_error and right["stribeck_force"].value < 0.0


def test_a_gross_fault_that_has_a_cause_is_not_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    record, loop = BY_NAME["delay forgotten"].make(axis("rigid"), 1)
    monkeypatch.setattr("jointid.diagnostics.search.test_laws", lambda _: [])
    found = faults_of(identify(record, loop), record, explain=lambda _: True).findings
    assert [(one.test.name, one.value) for one in found] == [("delay", None)]


def test_a_law_is_the_answer_where_a_record_is_too_short_for_free_responses() -> None:
    said = judge(0, "average", 2.5)
    assert said is not None and said.named[:1] == ("averaged_reference",)


@pytest.mark.parametrize("name", ["rigid", "direct", "screw"])
@pytest.mark.parametrize("mistake", MORE, ids=[one.name for one in MORE])
def test_what_the_samples_show_is_said_without_a_search(name: AxisName, mistake: Any, monkeypatch: Any) -> None:
    """A record that is too short, and a signal that was injected and is not declared."""
    monkeypatch.setattr(searching, "list_cases", Mock(side_effect=AssertionError("causes were put right in turn")))
    assert set(tell(*mistake.make(axis(name), 1))[0]) == mistake.right


@pytest.mark.parametrize("name", ["rigid", "flexible", "direct", "screw", "fast", "lift"])
def test_nothing_is_plain_of_a_healthy_record(name: AxisName) -> None:
    assert find_plain_cause(without_mistake(axis(name))[0]) is None


def test_a_record_that_moves_one_way_only_tells_nothing_however_long_it_is() -> None:
    """Coulomb friction and offset are one number then: a factor of 7,500 was named."""
    record, loop = without_mistake(axis("rigid"))
    message = find_causes(cut(without_positions(record), 2.0), loop).message
    assert (message.code, message.values["needed"]) == (Reason.RECORD_TOO_SHORT, 2.0)


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


def test_a_gain_in_1_per_min_is_told_by_its_unit() -> None:
    record, loop = without_mistake(axis("rigid"))
    gain = loop.controller.position_gain  # type: ignore[attr-defined]
    wrong = replace(loop, controller=with_numbers(loop.controller, {"position_gain": 60 * gain}))
    first = find_causes(without_positions(record), wrong).explanations[0]
    assert (first.name, first.value) == ("position_gain", pytest.approx(gain, rel=0.05))
    assert "1/min" in first.words and "degrees" not in first.words


@pytest.mark.slow
@pytest.mark.parametrize("times", [180 / np.pi, np.pi / 180])
def test_gain_in_degrees_is_told_beside_an_unknown_delay(times: float) -> None:
    """The search begins at the factors of units, and the delay is as free as in the identification."""
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


def run_spring(seconds: float, **undeclared: Any) -> ji.Record:
    """The record of the flexible axis above, with noise, under a law with more than is declared."""
    truth = {
        "motor_inertia": 1.5, "motor_viscous": 12.0, "motor_coulomb": 14.0, "stiffness": 4e4, "damping": 20.0,
        "load_inertia": 3.0, "load_viscous": 6.0, "load_coulomb": 9.0, "offset": 1.0,
    }  # fmt: skip
    loop = replace(SPRING, controller=replace(LAW, **undeclared))
    reference = trapezoids((2.0, 3.0), 25.0, 0.8, 1e-3, duration=seconds)
    noise = np.random.default_rng(1).normal(0.0, 0.6, len(reference))
    return simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise).without("motor_position")


def test_another_gear_is_said_with_its_ratio_and_an_integral_gain_with_its_time() -> None:
    record = ji.Record(torque=ji.Channel(np.zeros(2), "N m", 1e-3))
    turns, slides = ji.Transmission(load="revolute", ratio=5.0), ji.Transmission(load="prismatic", lead=0.1)
    each = (None, "reference_scale", "10:1"), (turns, "law_gain", "50:1"), (slides, "law_gain", "10 mm")
    for gear, first, size in each:
        joint = FlexibleJoint("revolute" if gear is None else gear.load, transmission=gear)
        case = Case(record, ClosedLoop(joint, LAW), ji.Filtering())
        said = {one.name: one.words for one in _say_factor(False, 10.0, case)}
        assert next(iter(said)) == first and said["reference_scale"].endswith(size)
    assert "(Tn 30.0 ms)" in next(iter(_say_number("integral_gain", _IS_ABOUT, 1e3 / 30, case))).words


LAG, NOTCH = ("torque_filter", 1.5e-3, FirstOrder(1.5e-3)), ("notch", 60.0, Notch(60.0, 84.0, 0.15))


@pytest.mark.parametrize(("name", "value", "one"), [LAG, NOTCH])
def test_a_notch_in_the_band_is_told_from_a_lag(name: str, value: float, one: Any) -> None:
    causes = find_causes(run_spring(4.0, torque_filters=(one,)), SPRING).explanations
    assert [(one.name, one.value) for one in causes] == [(name, pytest.approx(value, rel=0.03))]


def test_cases_start_again_at_the_joint_of_the_best_case() -> None:
    case = Case(run_spring(2.5), SPRING, ji.Filtering().resolve(1e-3, "flexible")).at("delay", (1e-3, 2e-3))
    assert searching._pose(case, SPRING, low=True).filtering.cutoff == pytest.approx(5.0)  # as rigid first
    problem: Any = searching._pose(case, SPRING)
    fit, best = (searching.Fit(case, problem, by * np.ones(len(problem.free))) for by in (1e-3, 2e-3))
    assert {one.problem.values(one.x)["stiffness"] for one in searching._list_flexible_starts(fit, best)} == {2e-3}
    assert _mode_of(dict.fromkeys(("motor_inertia", "load_inertia", "stiffness"), 1.0) | {"damping": 2.0}, 1e-3) == 1e3


def test_no_step_leads_to_a_mode_that_the_log_cannot_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a bound the search for a feed-forward that is not declared makes the spring stiffer and stiffer."""
    tried, linearise = list[float](), ClosedLoopProblem.linearise
    note = lambda p, x: tried.append(p.values(x).get("stiffness", 0.0)) or linearise(p, x)  # type: ignore[func-returns-value]  # noqa: E731
    monkeypatch.setattr(ClosedLoopProblem, "linearise", note)
    assert identify(run_spring(2.5, velocity_feedforward=1.0), SPRING)["stiffness"].value is None
    assert 1e5 < max(tried) < 1e9


@pytest.mark.slow
def test_a_gain_that_hides_the_spring_is_named() -> None:
    """The spring is refused, the residual is small, and five evaluations of the right cause leave more."""
    wrong = replace(SPRING, controller=replace(LAW, period=1.25e-4, velocity_gain=1.6 * LAW.velocity_gain))
    found = ji.identify(run_spring(5.0, period=1.25e-4), wrong)
    assert found["stiffness"].value is None and found.fit.filtered_error < 0.02
    (message,) = (one for one in found.checks if one.code is Reason.CAUSE_FOUND)
    causes: Any = message.values["causes"]
    assert "law_gain" in [one["cause"] for one in causes] and causes[0]["value"] == pytest.approx(1 / 1.6, rel=0.05)


@pytest.mark.slow
def test_a_gain_that_is_little_off_is_named_only_where_no_test_gives_it() -> None:
    record, wrong = run_spring(2.5), replace(SPRING, controller=with_numbers(LAW, {"velocity_gain": 434.0 / 1.25}))
    found = ji.identify(record, wrong, checks=False)
    refused = replace(found, rows=tuple(replace(row, value=None) for row in found.rows))
    causes = [find_causes(record, wrong, one).explanations for one in (found, refused)]
    assert not causes[0] and causes[1][0].value == pytest.approx(1.25, rel=0.05)


@pytest.mark.slow
def test_a_refused_spring_is_no_reason_to_look_for_a_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    """A healthy drive that moves one way only."""
    plant = drive(323, 12.0)
    monkeypatch.setattr(searching, "find_causes", lambda *_, **__: pytest.fail("it was asked"))
    found = ji.identify(plant.record, plant.loop)
    assert found["stiffness"].value is None and found.checks[-1].passed is None
