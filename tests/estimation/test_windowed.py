"""A robot, several records and inverse models in windows: the answer of the whole, where memory asks for it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.identify import _flat, windows_of
from jointid.estimation.result.verdict import Status, Subject
from jointid.records.chunks import cut
from jointid.records.record import Channel, Record
from tests.estimation.robots import twin
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.test_log import LOOP, rigid
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


def test_the_inverse_model_of_a_long_record_is_made_part_by_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a joint, of one with two masses, and of a robot: what is left out are the borders of the parts."""
    record, axis, (arm, log) = rigid(30.0), ji.twin("L19"), arm_log()
    cases: list[tuple[Any, Any]] = [(record, LOOP.joint), (axis.record, axis.loop.joint), (log, arm)]
    whole = [ji.identify(one, model, IDIM, checks=False) for one, model in cases]
    monkeypatch.setattr("jointid.estimation.problems.inverse_model.LARGEST", 10_000)
    for (one, model), before in zip(cases, whole, strict=True):
        found = ji.identify(one, model, IDIM, checks=False)
        assert found.fit.rows < before.fit.rows
        for name, part in found.params.items():
            assert abs((part.value or 0.0) - (before.params[name].value or 0.0)) <= 0.5 * (part.stderr or 0.0), name
            assert part.stderr == pytest.approx(before.params[name].stderr, rel=0.5), name
    with pytest.raises(MethodError):
        ji.identify(record, LOOP.joint, IDIM, windows=5.0)


def test_a_last_window_that_is_shorter_than_its_filters_is_passed_over() -> None:
    found = ji.identify(cut(rigid(30.0), 0, 20_030), LOOP, windows=4.0, checks=False)
    assert found.data.windows is not None and found.data.windows.count == 5


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
    with pytest.raises(MethodError):
        ji.identify([records[0], records[0]], LOOP)


@pytest.mark.slow
def test_records_that_differ_are_seen_in_windows() -> None:
    records = [rigid(40.0, 1), rigid(40.0, 2, viscous=100.0)]
    found = ji.identify(records, LOOP, windows=4.0, checks=False)
    assert found.checks.agreement["viscous"].differs
    assert not found.checks.agreement["inertia"].differs
    std = found.params["viscous"].stderr
    assert std is not None and std > 5.0, "what the records differ by is in the interval"


@pytest.mark.slow
def test_a_part_of_a_robot_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, log = arm_log()
    limit(monkeypatch, log, arm)
    found = ji.identify(log, arm)
    assert [one for one in found.checks.verdicts if one.subject is Subject.REPEATABLE]
    assert found.checks.diagnosis is not None


@pytest.mark.slow
def test_the_nominal_robot_is_compared_in_all_of_a_record() -> None:
    """Its links are heavier by a fifth, and the first window is another motion than the rest."""
    plant = two()
    loop = plant.loop()
    log: Sequence[Record] = recorded(loop, plant.records(12.0, 1), 0.05, 1)[0]
    heavy = replace(plant.robot, links=tuple(replace(one, inertial=1.2 * one.inertial) for one in plant.robot.links))
    whole, parts = (ji.identify(log, replace(loop, robot=heavy), windows=w, checks=False) for w in (None, 1.5))
    assert parts.require_robot().nominal_errors == pytest.approx(whole.require_robot().nominal_errors, rel=0.03)
    assert parts.require_robot().nominal == pytest.approx(whole.require_robot().nominal, abs=0.1)


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
