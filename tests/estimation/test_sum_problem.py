"""The parameters of several records: what they share, what is added, what is their own, and the derivatives by them."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.parameters import INITIAL_STATE
from jointid.estimation.pieces import GAIN, Layout, share_parameters
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.paper.twin import Twin, twin
from jointid.records.signals.filtering import Filtering

FRICTION = ("motor_viscous", "motor_coulomb", "load_viscous", "load_coulomb")


@pytest.fixture(scope="module")
def axis() -> Twin:
    return twin(noise="none")


def two(axis: Twin, *free: str) -> list[ClosedLoopProblem]:
    """Return the problems of two records, the second of 10 kg more under another gain."""
    heavier = axis.truth | {"load_inertia": axis.truth["load_inertia"] + 10.0}
    state = (replace(INITIAL_STATE[0], start=0.0), INITIAL_STATE[1].fix(0.0))
    slower = replace(axis.loop, controller=replace(axis.loop.controller, position_gain=120.0))  # type: ignore[type-var]
    assert axis.record.reference is not None and axis.record.injected is not None
    reference, added = (one.values[:5000] for one in (axis.record.reference, axis.record.injected.channel))
    problems = []
    for loop, values in ((axis.loop, axis.truth), (slower, heavier)):
        record = ji.simulated_record(loop, reference, values, sample_time=1e-3, injected=added)
        problem = torque_problem(record, loop, Filtering(), loop.joint.parameters, state)
        problems.append(problem.freeing(*free))
    return problems


def test_derivatives_against_central_differences(axis: Twin) -> None:
    """Shared, own, one that is known but for what is added, and the drive's gain, through weights."""
    problems = two(axis, "position_gain")
    layout = Layout(tuple(one.loop for one in problems), (0.0, 10.0), ((), FRICTION), (GAIN,))
    known = {p.name: p.fix(axis.truth[p.name]) for p in axis.loop.joint.parameters if p.name == "load_inertia"}
    problem = replace(share_parameters(problems, layout, known), sigma=np.array([2.0, 0.7]))
    names = [p.name for p in problem.free]
    values = axis.truth | {"drive_gain": 1.0, "position_gain@2": 120.0}
    values["position_gain@1"] = axis.loop.controller.position_gain  # type: ignore[attr-defined]
    truth = np.array([values.get(name, values.get(name.partition("@")[0], 0.0)) for name in names])
    assert np.linalg.norm(problem.linearise(truth)[0]) <= 1e-9 * problems[0].size
    x = 1.01 * truth
    assert problem.join(problem.split(x), problem.gain(x)) == pytest.approx(x)
    J = problem.linearise(x)[1]
    for i, name in enumerate(names):
        step = np.zeros(x.size)
        step[i] = 1e-6 * (abs(x[i]) or 1e-3)
        found = (problem.linearise(x + step)[0] - problem.linearise(x - step)[0]) / (2 * step[i])
        limit = 1e-3 if name == "damping" else 1e-4
        assert np.linalg.norm(J[:, i] - found) <= limit * np.linalg.norm(found), name
