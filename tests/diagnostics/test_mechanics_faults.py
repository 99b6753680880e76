"""A flexible joint whose mechanics are not the model's: said, and its stiffness is not relied on."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.check_loop import check_loop
from jointid.diagnostics.mechanics_faults import (
    BACKLASH,
    CHANGING_FRICTION,
    CUBIC_SPRING,
    LOAD_DEPENDENT_FRICTION,
    MECHANICS,
    _through_the_spring,
    _with_force,
    vary_mechanics,
)
from jointid.estimation.identify import identify
from jointid.estimation.result.answer import Trust
from jointid.simulation.closed_loop import simulate as simulate_exactly
from jointid.simulation.loop_input import prepare
from jointid.uncertainty.verdict import Reason
from studies.healthy import drive
from studies.mechanics import simulate, spoiled
from tests.faults import problem, setting


@pytest.mark.parametrize("seed", [3001, 3005])  # P-PI and PID
def test_the_study_s_small_steps_are_the_exact_simulation(seed: int) -> None:
    axis = drive(seed, 3.0)
    experiment = prepare(axis.loop, axis.record)
    out, _, _ = simulate(axis, dict(axis.truth), experiment.after_limit)
    exact = simulate_exactly(axis.loop, experiment, axis.truth)
    assert np.std(out + experiment.shown - exact.torque) < 1e-3 * np.std(out)


def test_forces_on_motor_and_load_act_as_one_on_the_motor() -> None:
    """A spring that is a little stiffer is a pair of forces, whose effect is also known exactly."""
    where = setting("L19")
    made = problem(where, None, None)
    x = made.vector(where.truth)
    run, stiffness = made.simulate(x), where.truth["stiffness"]
    assert run.load_position is not None
    small = 1e-4 * stiffness * (run.motor_position - run.load_position)
    force = _through_the_spring(small, where.truth, where.truth["load_viscous"], made.sample_time) - small
    shown = made.filtered(_with_force(made, x, force) - made.torque(x))
    names = [p.name for p in made.free]
    exact = -1e-4 * stiffness * made.linearised(x)[1][:, names.index("stiffness")]
    assert np.linalg.norm(shown - exact) < 0.2 * np.linalg.norm(exact)  # a load that rests, and forces that are held


@pytest.mark.parametrize(
    ("fault", "seed", "name"),
    [
        ("cubic spring", 3005, CUBIC_SPRING),
        ("load-dependent friction", 3003, LOAD_DEPENDENT_FRICTION),
        pytest.param("changing friction", 3003, CHANGING_FRICTION, marks=pytest.mark.slow),
        pytest.param("backlash", 3010, BACKLASH, marks=pytest.mark.slow),
    ],
)
def test_what_is_wrong_is_named_first(fault: str, seed: int, name: str) -> None:
    made = spoiled(seed, fault)
    assert made is not None
    check = check_loop(identify(made.record, made.axis.loop), made.record)
    assert check.findings[0].test.name == name
    assert {CUBIC_SPRING, BACKLASH} - {one.test.name for one in check.findings}  # two words for one thing
    asked = {CUBIC_SPRING: "three-piece", BACKLASH: "backlash"}.get(name)
    assert asked is None or f'; to identify it, set joint.spring = "{asked}"' in str(check.sentences[0])


@pytest.mark.slow
def test_a_spring_that_is_not_linear_has_no_stiffness_to_rely_on() -> None:
    made = spoiled(3005, "cubic spring")
    assert made is not None
    found = ji.identify(made.record, made.axis.loop)
    assert found.answer.trust.code == Trust.NOT_YET
    assert found.answer.trust.values["reasons"] == [Reason.SPRING_NOT_LINEAR]
    said = re.search(
        r"the spring is not linear: (\d+) % or more stiffer at the largest torque than near", found.sentence
    )
    assert said is not None
    assert 5 <= int(said[1]) <= 100 * made.size  # at least so much, and not more than it is


@pytest.mark.slow
def test_a_stiffness_beside_a_friction_that_grows_with_the_load_is_not_relied_on() -> None:
    made = spoiled(3003, "load-dependent friction")
    assert made is not None
    found = ji.identify(made.record, made.axis.loop)
    assert Reason.FRICTION_NOT_AS_MODELLED in found.answer.trust.values["reasons"]
    assert 'set joint.friction = "load-dependent"' in str(check_loop(found, made.record).sentences)


def test_a_rigid_joint_has_no_spring() -> None:
    axis = ji.twin(noise="white")
    rigid = ji.ClosedLoop(ji.RigidJoint(kind=axis.loop.joint.kind), axis.loop.controller)
    record = axis.record.without("motor_position", "load_position")
    estimate = identify(record, rigid, ji.DIDIM())
    assert not {one.name for one in check_loop(estimate, record).tests} & set(MECHANICS)


def test_they_are_the_same_of_a_friction_with_a_number_for_each_direction() -> None:
    where = setting("L19")
    made = problem(where, None, None)
    x = made.vector(where.truth)
    asymmetric = replace(made.joint, friction=ji.AsymmetricFriction())
    loop = replace(made.loop, joint=asymmetric)
    values = made.values(x)
    values |= {p.name: values[p.name.rpartition("_")[0]] for p in asymmetric.parameters if p.name.endswith("wards")}
    beside = made.parameters[len(made.joint.parameters) :]
    own = tuple(p.fixed(values[p.name]) if p.name == "offset" else p for p in asymmetric.parameters)
    other = replace(made, loop=loop, parameters=(*own, *beside))
    ours, theirs = list(vary_mechanics(made, x)), list(vary_mechanics(other, other.vector(values)))
    assert {one.name for one in ours} == set(MECHANICS)
    assert [one.name for one in ours] == [one.name for one in theirs]
    for one, there in zip(ours, theirs, strict=True):
        assert np.allclose(one.column, there.column, rtol=1e-6, atol=1e-6 * np.max(np.abs(one.column))), one.name
