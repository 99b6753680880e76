"""A robot, several records and inverse models in windows: the answer of the whole, where memory asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.identify import _flat, windows_of
from jointid.estimation.result.answer import Trust
from jointid.estimation.result.verdict import Status, Subject
from jointid.records.chunks import cut
from jointid.records.record import Channel, Record
from tests.estimation.robots import twin
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.test_log import LOOP, TRUTH, rigid
from tests.robots_plants import two

IDIM = ji.IDIM()


def arm_log(seconds: float = 40.0) -> tuple[Any, tuple[Record, ...]]:
    """Return an arm of two joints, with records of 0.1 s of noise on its torques."""
    arm, count = twin.arm(2), round(seconds / twin.SAMPLE_TIME)
    one = twin.records_of(arm, 1)
    random = np.random.default_rng(3)
    records = []
    for record, noise in zip(one, (0.5, 0.05), strict=True):
        assert record.torque is not None and record.motor_position is not None
        torque, position = (np.resize(c.values[:-1], count) for c in (record.torque, record.motor_position))
        records.append(
            Record(
                torque=Channel(torque + noise * random.standard_normal(count), "N m", twin.SAMPLE_TIME),
                motor_position=Channel(position, "rad", twin.SAMPLE_TIME),
            )
        )
    return arm, tuple(records)


def assert_same(parts: ji.Estimate, whole: ji.Estimate, apart: float = 0.5, ratio: float = 2.0) -> None:
    """Assert that both say the same within a fraction of their deviations, which are alike."""
    assert parts.fit.converged and parts.data.windows is not None
    known = dict(whole.params)
    for name, part in parts.params.items():
        one = known[name]
        if one.stderr:
            assert abs(part.value - one.value) <= apart * one.stderr, part.name
            assert 1 / ratio <= part.stderr / one.stderr <= ratio, part.name


def limit(monkeypatch: pytest.MonkeyPatch, record: object, model: object, share: float = 1.01) -> None:
    samples = sum(len(one.torque) for one in _flat(record) if one.torque is not None)
    alike = 1.0 if isinstance(model, ji.ClosedLoop | ji.RigidJoint) else 4.0 / len(getattr(model, "robot", model))
    monkeypatch.setattr("jointid.estimation.identify.LARGEST", samples / (alike * share))


def test_idim_of_a_joint_goes_in_windows_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    record = rigid(30.0)
    whole = ji.identify(record, LOOP.joint, IDIM)
    assert whole.data.windows is None
    limit(monkeypatch, record, LOOP.joint, 4.0)
    found = ji.identify(record, LOOP.joint, IDIM)
    assert_same(found, whole)
    assert found.motion_measured and found.data.windows is not None
    assert ji.identify(record, LOOP, ji.IDIM("iv")).data.windows is None  # which needs all rows at once


def test_windows_of_a_flexible_joint_are_weighed_as_its_whole_record_is() -> None:
    axis = ji.twin("L19")
    ways = (False, 3.0)
    whole, found = (ji.identify(axis.record, axis.loop.joint, IDIM, windows=way, checks=False) for way in ways)
    assert found.fit.converged
    assert_same(found, whole)


def test_a_friction_at_its_bound_in_the_first_window_is_free_in_all() -> None:
    """Without viscous friction half of the windows by themselves find it below 0."""
    for seed in range(4):
        record = rigid(30.0, seed, viscous=0.0)
        first = ji.identify(cut(record, 0, 5200), LOOP.joint, IDIM, checks=False)
        if not all(row.free for row in first.params.rows):
            break
    assert not all(row.free for row in first.params.rows)
    found = ji.identify(record, LOOP.joint, IDIM, windows=5.0)
    assert all(row.stderr for row in found.params.rows)
    assert found.answer.trust.code == Trust.NOT_CHECKED


def test_a_last_window_that_is_shorter_than_its_filters_is_passed_over() -> None:
    record = cut(rigid(30.0), 0, 20_030)
    found = ji.identify(record, LOOP.joint, IDIM, windows=4.0)
    assert found.data.windows is not None and found.data.windows.count == 5


def test_a_window_in_which_a_brake_holds_a_joint_is_passed_over() -> None:
    arm, (first, second) = arm_log(20.0)
    held = second.torque.values.copy()
    held[len(held) // 2 :] = 0.0
    records = (first, replace(second, torque=replace(second.torque, values=held)))
    found = ji.identify(records, arm, windows=2.0)
    assert found.data.windows is not None and found.data.windows.still >= 4
    assert any(one.said == "not checked: identified in windows" for one in found.checks.verdicts)


@pytest.mark.slow
def test_a_force_in_the_loop_widens_an_inverse_model_in_windows_as_in_the_whole() -> None:
    """A slow force, which the loop carries into the motion, as a random walk that is held to the middle."""
    reference = rigid(60.0).reference
    random, force = np.random.default_rng(7), np.zeros(len(reference))
    for k in range(1, force.size):
        force[k] = 0.995 * force[k - 1] + 0.3 * random.standard_normal()
    record = ji.simulated_record(LOOP, reference.values, TRUTH, sample_time=1e-3, disturbance=force)
    whole = ji.identify(record, LOOP.joint, IDIM)
    parts = ji.identify(record, LOOP.joint, IDIM, windows=10.0)
    assert_same(parts, whole)


def test_a_window_at_rest_says_nothing_of_an_inverse_model() -> None:
    record = rigid(40.0)
    random, still = np.random.default_rng(2), 20_000
    torque = np.concatenate([record.torque.values, 9.0 + random.standard_normal(still)])
    position = np.concatenate([record.motor_position.values, 1e-7 * random.standard_normal(still)])
    resting = Record(
        torque=replace(record.torque, values=torque), motor_position=replace(record.motor_position, values=position)
    )
    found = ji.identify(resting, LOOP.joint, IDIM, windows=5.0)
    assert found.data.windows is not None and found.data.windows.still >= 3
    for name, truth in TRUTH.items():
        row = found.params[name]
        assert abs(row.value - truth) < 4 * row.stderr, name


def test_several_records_go_in_windows_by_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    records = [rigid(20.0, 1), rigid(20.0, 2, noise=4.0, viscous=90.0)]
    records = [replace(record, name=f"run {k}") for k, record in enumerate(records)]
    shared, said = {"own": ((), ("viscous",))}, list[str]()
    whole = ji.identify(records, LOOP, several=shared)
    limit(monkeypatch, records, LOOP, share=5.0)
    found = ji.identify(records, LOOP, several=shared, progress=said.append)
    assert_same(found, whole)
    first, second = found.data.records
    assert (first.name, second.name) == ("run 0", "run 1")
    assert second.level / first.level == pytest.approx(2.0, rel=0.1)
    assert found.checks.agreement is not None and not found.checks.agreement.differs
    assert any("is identified in windows" in one for one in said)
    assert "windows" in str(found)
    assert len(ji.to_dict(found)["data"]["records"]) == 2
    with pytest.raises(MethodError, match="are the same record"):
        ji.identify([records[0], records[0]], LOOP)


@pytest.mark.slow
def test_records_that_differ_are_seen_in_windows() -> None:
    records = [rigid(40.0, 1), rigid(40.0, 2, viscous=100.0)]
    found = ji.identify(records, LOOP, windows=4.0, checks=False)
    assert found.checks.agreement["viscous"].differs
    assert not found.checks.agreement["inertia"].differs
    std = found.params["viscous"].stderr
    assert std is not None and std > 5.0, "what the records differ by is in the interval"


def test_idim_of_a_robot_goes_in_windows_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, log = arm_log()
    whole = ji.identify(log, arm, checks=False)
    limit(monkeypatch, log, arm)
    assert ji.identify(log, arm, windows=False, checks=False).data.windows is None
    found = ji.identify(log, arm, checks=False)
    assert_same(found, whole)
    assert "is stated" not in str(found) and not found.fit.simulations
    assert found.fit.axis_errors == pytest.approx(whole.fit.axis_errors, rel=0.05)
    assert "in windows" in str(found) and ji.to_dict(found)["robot"] is not None
    windows = found.data.windows
    assert windows is not None and ji.to_dict(found)["data"]["windows"]["count"] == windows.count
    for use in (lambda one, log: ji.diagnose(log, one), ji.Report.of):
        with pytest.raises(MethodError, match="in windows, whose torque it does not keep; identify a part"):
            use(found, log)


@pytest.mark.slow
def test_a_part_of_a_robot_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, log = arm_log()
    limit(monkeypatch, log, arm)
    found = ji.identify(log, arm)
    assert found.data.windows is not None
    assert [one for one in found.checks.verdicts if one.subject is Subject.REPEATABLE]
    assert found.checks.diagnosis is not None


@pytest.mark.slow
def test_two_logs_of_a_robot_go_in_windows() -> None:
    arm, log = arm_log()
    half = [[half_of(record, part) for record in log] for part in (0, 1)]
    whole = ji.identify(half, arm, checks=False)
    assert_same(ji.identify(half, arm, windows=5.0, checks=False), whole)


def half_of(record: Record, part: int) -> Record:
    changes = {
        name: replace(c, values=c.values[part * len(c) // 2 : (part + 1) * len(c) // 2]) for name, c in record.items()
    }
    return record.with_channels(changes)


@pytest.mark.parametrize("under_loop", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_nominal_robot_is_compared_in_all_of_a_record(under_loop: bool) -> None:
    """Its links are heavier by a fifth, and the first window is another motion than the rest."""
    plant = two()
    loop = plant.loop()
    log: Sequence[Record] = recorded(loop, plant.records(12.0, 1), 0.05, 1)[0]
    heavy = replace(plant.robot, links=tuple(replace(one, inertial=1.2 * one.inertial) for one in plant.robot.links))
    model = replace(loop, robot=heavy) if under_loop else heavy
    whole, parts = (ji.identify(log, model, windows=w, checks=False) for w in (None, 1.5))
    assert parts.require_robot().nominal_errors == pytest.approx(whole.require_robot().nominal_errors, rel=0.03)
    assert parts.require_robot().nominal == pytest.approx(whole.require_robot().nominal, abs=0.1)


def test_known_friction_of_a_robot_holds_in_windows() -> None:
    fixed, (arm, log) = {"joint1.viscous": 8.0}, arm_log(20.0)
    known = {"joint1.viscous": Parameter("viscous", "Fv", Quantity.VISCOUS).fix(8.0)}
    whole, parts = (ji.identify(log, arm, parameters=known, windows=w, checks=False) for w in (None, 5.0))
    assert_same(parts, whole, apart=0.6, ratio=2.5)
    for name, value in fixed.items():
        assert parts.params[name].value == value and parts.params[name].stderr is None


def test_didim_of_a_robot_goes_in_windows_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = two()
    loop = plant.loop()
    log: Sequence[Record] = recorded(loop, plant.records(10.0, 1), 0.05, 1)[0]
    whole = ji.identify(log, loop, checks=False)
    limit(monkeypatch, log, loop, share=2.0)
    assert windows_of(log, loop, None) is not None
    found = ji.identify(log, loop, checks=False)
    assert_same(found, whole)
    assert found.data.windows is not None and 0.05 < found.data.windows.settling < 1.0
    (solver,) = (one for one in found.checks.verdicts if one.subject is Subject.SOLVER)
    assert solver.status is Status.PASSED
