"""The criterion of several records: what they share, what is added, what is their own, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem
from jointid.estimation.problems.several_records import several as together
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
    assert reference is not None
    assert injected is not None
    return simulated_record(loop, reference.values, values, sample_time=1e-3, injected=injected.channel.values)


def problem_of(
    axis: Twin, values: dict[str, float], free: Sequence[str] = (), loop: ClosedLoop | None = None
) -> ClosedLoopProblem:
    state = (replace(INITIAL_STATE[0], start=0.0), INITIAL_STATE[1].fix(0.0))
    loop = loop or axis.loop
    return torque_problem(driven(axis, loop, values), loop, Filtering(), loop.joint.parameters, state).freeing(*free)


def two(
    axis: Twin, free: Sequence[str] = (), loop: ClosedLoop | None = None
) -> tuple[list[ClosedLoopProblem], dict[str, float]]:
    heavier = axis.truth | {"load_inertia": axis.truth["load_inertia"] + 10.0}
    return [problem_of(axis, axis.truth, free), problem_of(axis, heavier, free, loop)], heavier


def several(
    problems: Sequence[ClosedLoopProblem],
    own: Sequence[Sequence[str]] = ((), (), ()),
    added: Sequence[dict[str, float]] = ({}, {}, {}),
) -> RecordsProblem:
    count, loops = len(problems), tuple(one.loop for one in problems)
    return together(problems, RecordLayout(loops, tuple(added[:count]), tuple(own[:count])))


def at(criterion: RecordsProblem, values: dict[str, float]) -> np.ndarray:
    """The free parameters of that value, those of a record under their plain name too."""
    plain = [p.name.partition("@")[0] for p in criterion.free]
    return np.array([values.get(p.name, values.get(name, 0.0)) for p, name in zip(criterion.free, plain, strict=True)])


def test_the_truth_of_both_leaves_nothing(axis: Twin) -> None:
    problems, _ = two(axis)
    criterion = several(problems, added=ADDED)
    names = [p.name for p in criterion.free]
    assert names == [p.name for p in axis.loop.joint.parameters] + ["initial_position@1", "initial_position@2"]
    x = at(criterion, axis.truth)
    size = np.linalg.norm(problems[0].filter(problems[0].measured))
    assert np.linalg.norm(criterion.residual(x)) <= 1e-9 * size
    assert np.linalg.norm(several(problems).residual(x)) > 0.01 * size  # without the 10 kg that were added
    assert criterion.of_member(x, 1)[5] == x[5] + 10.0


@pytest.mark.parametrize(
    ("free", "own", "there", "absent"),
    [
        ((), ((), (), ("load_coulomb",)), {"load_coulomb", "load_coulomb@3"}, "load_coulomb@1"),
        (("position_gain", "velocity_gain"), ((), ()), {"velocity_gain", "position_gain@1", "position_gain@2"}, "gain"),
    ],
)
def test_what_records_share_and_what_is_their_own(
    axis: Twin, free: Sequence[str], own: Sequence[Sequence[str]], there: set[str], absent: str
) -> None:
    """Of three records two still share; numbers of two controllers are shared where they are the same."""
    other = ClosedLoop(axis.loop.joint, replace(axis.loop.controller, position_gain=120.0))  # type: ignore[type-var]
    problems, _ = two(axis, free, other)
    names = {p.name for p in several([problems[0], *problems][-len(own) :], own, [{}, *ADDED][-len(own) :]).free}
    assert there <= names
    assert absent not in names


def test_an_own_parameter_moves_its_record_alone(axis: Twin) -> None:
    problems, _ = two(axis)
    criterion = several(problems, [(), FRICTION], ADDED)
    names = [p.name for p in criterion.free]
    assert {f"{name}@{k}" for name in FRICTION for k in (1, 2)} <= set(names)  # nobody is left to share with
    x = at(criterion, axis.truth)
    x[names.index("load_coulomb@2")] += 5.0
    first, second = np.split(criterion.residual(x), [problems[0].residual(at(criterion, axis.truth)[:10]).size])
    assert np.linalg.norm(first) <= 1e-9 * np.linalg.norm(second)


def test_derivatives_against_central_differences(axis: Twin) -> None:
    """Shared, added, own and the drive's gain, through weights; away from the truth."""
    other = ClosedLoop(axis.loop.joint, replace(axis.loop.controller, position_gain=120.0))  # type: ignore[type-var]
    problems, _ = two(axis, ("drive_gain", "position_gain"), other)
    criterion = several(problems, [(), FRICTION], ADDED).weighing([2.0, 0.7])
    values = {name: 1.01 * value for name, value in axis.truth.items()}
    x = at(criterion, values | {"drive_gain": 1.02, "position_gain@1": 160.18, "position_gain@2": 121.0})
    names = [p.name for p in criterion.free]
    assert {"drive_gain", "position_gain@1", "position_gain@2", "load_coulomb@2", "initial_position@2"} <= set(names)
    residual, J = criterion.linearise(x)
    assert residual == pytest.approx(criterion.residual(x), rel=1e-9, abs=1e-9)
    for i, name in enumerate(names):
        step = 1e-6 * (abs(x[i]) or 1e-3)
        ahead, behind = x.copy(), x.copy()
        ahead[i] += step
        behind[i] -= step
        found = (criterion.residual(ahead) - criterion.residual(behind)) / (2 * step)
        limit = 1e-3 if name == "damping" else 1e-4
        assert np.linalg.norm(J[:, i] - found) <= limit * np.linalg.norm(found), name


def test_the_vector_of_several_starts_is_their_mean_without_what_was_added(axis: Twin) -> None:
    problems, heavier = two(axis)
    criterion = several(problems, [(), FRICTION], ADDED)
    found = [p.vector(v | {"initial_position": 0.0}) for p, v in zip(problems, (axis.truth, heavier), strict=True)]
    found[1][0] += 2.0  # of the motor's inertia
    x = dict(zip([p.name for p in criterion.free], criterion.join(found), strict=True))
    assert x["load_inertia"] == pytest.approx(axis.truth["load_inertia"])
    assert x["motor_inertia"] == pytest.approx(axis.truth["motor_inertia"] + 1.0)
    assert x["load_coulomb@2"] == axis.truth["load_coulomb"]


def test_the_gain_of_a_drive_needs_something_known(axis: Twin) -> None:
    problems, _ = two(axis, ("drive_gain",))
    with pytest.raises(MethodError, match="gain cannot be distinguished from the scale"):
        several(problems)
    with pytest.raises(MethodError, match="gain cannot be distinguished from the scale"):
        several(problems, added=[{"load_inertia": 10.0}] * 2)
    assert any(p.name == "drive_gain" for p in several(problems, added=ADDED).free)
    known = [
        replace(q, parameters=tuple(p.fix(34.8) if p.name == "load_inertia" else p for p in q.parameters))
        for q in problems
    ]
    assert several(known).free
