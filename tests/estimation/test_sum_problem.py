"""The parameters of several records: what they share, what is added, what is their own, and the derivatives by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.identify_log import Start, pose
from jointid.estimation.identify_several import _whole
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem
from jointid.estimation.problems.several_records import several as together
from jointid.estimation.windowed import loop_model
from jointid.models.joints import ClosedLoop
from jointid.paper.twin import Twin, twin
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record

FRICTION = ("motor_viscous", "motor_coulomb", "load_viscous", "load_coulomb")
ADDED = [{}, {"load_inertia": 10.0}]


@pytest.fixture(scope="module")
def axis() -> Twin:
    return twin(noise="none")


def driven(axis: Twin, loop: ClosedLoop, values: dict[str, float]) -> Record:
    reference, injected = axis.record.reference, axis.record.injected
    return simulated_record(loop, reference.values, values, sample_time=1e-3, injected=injected.channel.values)


def two(
    axis: Twin, free: Sequence[str] = (), loop: ClosedLoop | None = None
) -> tuple[list[Record], list[ClosedLoopProblem]]:
    heavier = axis.truth | {"load_inertia": axis.truth["load_inertia"] + 10.0}
    state = (replace(INITIAL_STATE[0], start=0.0), INITIAL_STATE[1].fix(0.0))
    loops, problems = (axis.loop, loop or axis.loop), []
    records = [driven(axis, one, values) for one, values in zip(loops, (axis.truth, heavier), strict=True)]
    for record, one in zip(records, loops, strict=True):
        problem = torque_problem(record, one, Filtering(), one.joint.parameters, state)
        problems.append(problem.freeing(*free))
    return records, problems


def layout_of(
    problems: Sequence[ClosedLoopProblem],
    own: Sequence[Sequence[str]] = ((), (), ()),
    added: Sequence[dict[str, float]] = ({}, {}, {}),
) -> RecordLayout:
    count = len(problems)
    return RecordLayout(tuple(one.loop for one in problems), tuple(added[:count]), tuple(own[:count]))


def several(problems: Sequence[ClosedLoopProblem], *settings: Sequence[object]) -> RecordsProblem:
    return together(problems, layout_of(problems, *settings))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("free", "own", "there", "absent"),
    [
        ((), ((), (), ("load_coulomb",)), {"load_coulomb", "load_coulomb@3"}, "load_coulomb@1"),
        ((), ((), ()), {"load_inertia", "initial_position@1", "initial_position@2"}, "load_inertia@2"),
        ((), ((), FRICTION), {f"{name}@{k}" for name in FRICTION for k in (1, 2)}, "load_coulomb"),  # no one shares
        (("position_gain", "velocity_gain"), ((), ()), {"velocity_gain", "position_gain@1", "position_gain@2"}, "gain"),
    ],
)
def test_what_records_share_and_what_is_their_own(
    axis: Twin, free: Sequence[str], own: Sequence[Sequence[str]], there: set[str], absent: str
) -> None:
    """Of three records two still share; numbers of two controllers are shared where they are the same."""
    other = ClosedLoop(axis.loop.joint, replace(axis.loop.controller, position_gain=120.0))  # type: ignore[type-var]
    _, problems = two(axis, free, other)
    names = {p.name for p in several([problems[0], *problems][-len(own) :], own, [{}, *ADDED][-len(own) :]).free}
    assert there <= names
    assert absent not in names


def test_derivatives_against_central_differences(axis: Twin) -> None:
    """Shared, added, own and the drive's gain, through weights; at the truth of both nothing is left."""
    other = ClosedLoop(axis.loop.joint, replace(axis.loop.controller, position_gain=120.0))  # type: ignore[type-var]
    records, problems = two(axis, ("drive_gain", "position_gain"), other)
    fit = ji.identify(records[0], axis.loop, ji.DIDIM(frequency=30.0), checks=False)
    starts = [
        Start([record], fit, loop_model(problem, whole=True), problem.vector(axis.truth | {"drive_gain": 1.0}))
        for record, problem in zip(records, problems, strict=True)
    ]
    pieces = [partial(_whole, record) for record in records]
    problem, _, _ = pose(starts, pieces, ["1", "2"], layout_of(problems, [(), FRICTION], ADDED))
    problem = replace(problem, kept=True, sigma=np.array([[2.0], [0.7]]))

    def rows(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen = zip(problem.pass_over(x).seen, problem.sigma[:, 0], strict=True)
        each = [(one.error[0] / sigma, one.J[0] / sigma) for one, sigma in seen]
        return np.concatenate([error for error, _ in each]), np.concatenate([J for _, J in each])

    names = [p.name for p in problem.free]
    values = axis.truth | {"drive_gain": 1.0, "position_gain@1": 160.18, "position_gain@2": 120.0}
    truth = np.array([values.get(name, values.get(name.partition("@")[0], 0.0)) for name in names])
    truth[names.index("position_gain@1")] = axis.loop.controller.position_gain  # type: ignore[attr-defined]
    assert np.linalg.norm(rows(truth)[0]) <= 1e-9 * problems[0].size
    x = 1.01 * truth
    residual, J = rows(x)
    for i, name in enumerate(names):
        step = 1e-6 * (abs(x[i]) or 1e-3)
        ahead, behind = x.copy(), x.copy()
        ahead[i] += step
        behind[i] -= step
        found = (rows(ahead)[0] - rows(behind)[0]) / (2 * step)
        limit = 1e-3 if name == "damping" else 1e-4
        assert np.linalg.norm(J[:, i] - found) <= limit * np.linalg.norm(found), name
    assert residual.size == sum(one.kept.size for one in problems)


def test_the_start_is_the_mean_of_several_without_what_was_added(axis: Twin) -> None:
    _, problems = two(axis)
    criterion = several(problems, [(), FRICTION], ADDED)
    found = [p.vector(axis.truth | {"initial_position": 0.0}) for p in problems]
    found[1][0] += 2.0  # of the motor's inertia
    found[1][5] += 10.0  # of the load's
    x = dict(zip([p.name for p in criterion.free], criterion.join(found), strict=True))
    assert x["load_inertia"] == pytest.approx(axis.truth["load_inertia"])
    assert x["motor_inertia"] == pytest.approx(axis.truth["motor_inertia"] + 1.0)
    assert x["load_coulomb@2"] == axis.truth["load_coulomb"]


def test_the_gain_of_a_drive_needs_something_known(axis: Twin) -> None:
    _, problems = two(axis, ("drive_gain",))
    for added in (({}, {}), [{"load_inertia": 10.0}] * 2):
        with pytest.raises(MethodError, match="gain cannot be distinguished from the scale"):
            several(problems, ((), ()), added)
    assert any(p.name == "drive_gain" for p in several(problems, ((), ()), ADDED).free)
    known = [
        replace(q, parameters=tuple(p.fix(34.8) if p.name == "load_inertia" else p for p in q.parameters))
        for q in problems
    ]
    assert several(known).free
