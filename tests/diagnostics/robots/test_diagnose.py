"""What a robot's record tells of each joint, what its residual follows, and whether its controllers are as declared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.diagnostics.axis_parameters import Told, parameters_by_axis
from jointid.diagnostics.axis_torques import DIRECTION, FRICTION
from jointid.diagnostics.diagnose import diagnose_robot
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.robots.didim import identify_rigid_robot
from jointid.models.controllers import Controller
from jointid.records.record import Record
from jointid.simulation.robots import RobotLoop, add_feed_forward
from jointid.simulation.synthesis import simulate
from tests.estimation.robots.twin import arm, axis_errors, identified, motion, records_of
from tests.robots_plants import two


def with_torque(records: Sequence[Record], joint: int, added: FloatArray) -> tuple[Record, ...]:
    """Return records with a torque added at one joint."""
    torque = records[joint].torque
    assert torque is not None
    more = replace(records[joint], torque=replace(torque, values=torque.values + added))
    return (*records[:joint], more, *records[joint + 1 :])


def logged_by(loop: RobotLoop, drives: Sequence[Record] | None = None) -> tuple[Record, ...]:
    """Return what the drives of two joints log, with a thousandth of noise."""
    driven = two().records(6.0) if drives is None else drives
    made, rng = simulate(loop, driven).records(driven), np.random.default_rng(3)
    noisy = []
    for one in made:
        assert one.torque is not None
        values = one.torque.values + 1e-3 * np.std(one.torque.values) * rng.normal(size=one.torque.values.size)
        noisy.append(replace(one, torque=replace(one.torque, values=values)))
    return tuple(noisy)


def asked(loop: RobotLoop, records: Sequence[Record], laws: Sequence[Controller]) -> Diagnosis:
    return diagnose_robot(identified(loop.robot, records), records, laws)


def test_a_model_that_holds_leaves_noise() -> None:
    records = records_of(arm(), 2, noise=0.2)
    found = diagnose_robot(identified(arm(), records), records)
    assert found.explained
    assert found.as_declared is None
    assert "Whether the controllers are as declared is not asked" in found.answer
    assert all(one.whiteness is not None and one.whiteness.white for one in found.axes)
    told = [name for one in found.axes for name in one.names(Told.TOLD)]
    assert len(told) > 30
    assert any("does not tell from 0" in one for one in found.sentences)


def test_friction_that_rises_towards_standstill_is_named_at_its_joint() -> None:
    records = records_of(arm(), 2, noise=0.02)
    v = motion(2)[1][:, 3]
    more = with_torque(records, 3, 1.5 * np.sign(v) * np.exp(-np.abs(v) / 0.15))
    found = diagnose_robot(identified(arm(), more), more)
    assert [one.name for one in found.axes if not one.explained] == ["joint4"]
    follows = found.axes[3].follows
    assert follows is not None and follows[0] == FRICTION
    assert any(one.startswith("joint4: the model leaves") and "standstill" in one for one in found.sentences)


def test_a_friction_that_differs_by_direction_is_named_until_it_is_declared() -> None:
    loop = two().loop()
    first, second = loop.robot.joints
    other = replace(loop.robot, joints=(replace(first, viscous_backwards=12.0), second))
    records = logged_by(RobotLoop(other, loop.controllers))
    found = diagnose_robot(identified(loop.robot, records), records).axes[0]
    assert not found.explained
    assert found.follows is not None and found.follows[0] == DIRECTION
    assert diagnose_robot(identified(other, records), records).axes[0].left < 0.2 * found.left


def test_what_is_left_is_no_noise_unless_it_is_white() -> None:
    records = records_of(arm(), 2, noise=0.2)
    estimate = identified(arm(), records)
    joint = diagnose_robot(estimate, records).axes[0]
    assert joint.whiteness is not None
    coloured = replace(joint, left=0.05, whiteness=replace(joint.whiteness, p_value=1e-6), follows=None)
    assert not coloured.explained
    assert replace(coloured, whiteness=replace(joint.whiteness, p_value=0.01)).explained
    assert replace(coloured, left=0.02).explained


def test_the_motion_of_another_joint_is_named() -> None:
    records = records_of(arm(), 2, noise=0.02)
    more = with_torque(records, 4, 0.3 * motion(2)[2][:, 5])
    found = diagnose_robot(identified(arm(), more), more).axes[4]
    assert found.follows is not None and found.follows[0].startswith("the motion of joint6")


def test_controllers_that_make_the_torque_hold_and_others_do_not() -> None:
    loop = two().loop()
    records = logged_by(loop)
    found = asked(loop, records, loop.controllers)
    assert found.as_declared and found.explained
    assert "declared controllers make the logged torques" in found.answer
    first, second = loop.controllers
    stiffer = asked(loop, records, (first, replace(second, position_gain=1.3 * second.position_gain)))  # type: ignore[type-var, attr-defined]
    assert [one.law_holds for one in stiffer.axes] == [True, False]
    assert not stiffer.as_declared and any("joint2" in one for one in stiffer.sentences)
    halved = [replace(one, torque=replace(one.torque, values=0.5 * one.torque.values)) for one in records if one.torque]
    half = asked(loop, halved, loop.controllers)
    assert any("0.5 times the law's: correct torque_constant" in one for one in half.sentences)


@pytest.mark.parametrize("kind", ["gravity", "inverse-model"])
def test_a_feed_forward_that_is_not_declared_is_named(kind: str) -> None:
    loop = two().loop()
    given = add_feed_forward(loop, two().records(6.0), kind)  # type: ignore[arg-type]
    records = [replace(one, injected=None) for one in logged_by(loop, given)]
    found = asked(loop, records, loop.controllers)
    assert found.feed_forward == kind
    assert f'robot.feed_forward = "{kind}"' in found.sentences[0]


def test_a_feed_forward_of_coupled_motors_is_named() -> None:
    plain = two().loop()
    first, second = plain.robot.joints
    coupled = replace(plain.robot, joints=(first, replace(second, coupling={"joint1": -2.0})))
    loop = RobotLoop(coupled, plain.controllers)
    given = add_feed_forward(loop, two().records(6.0))
    records = [replace(one, injected=None) for one in logged_by(loop, given)]
    assert asked(loop, records, loop.controllers).feed_forward == "inverse-model"


def test_the_travel_is_that_of_the_motors_wherever_they_turn() -> None:
    """Rows that are left out of the comparison are 0: they are no place that the motor was at."""
    driven = []
    for one in two().records(6.0):
        assert one.reference is not None
        driven.append(replace(one, reference=replace(one.reference, values=one.reference.values + 2.0)))
    loop = two().loop()
    records = logged_by(loop, driven)
    found = asked(loop, records, loop.controllers)
    true = [float(np.ptp(one.motor_position.values)) for one in records if one.motor_position is not None]
    assert [one.travel for one in found.axes] == pytest.approx(true, rel=0.05)  # the filter's borders are off
    assert found.torques.position.min() > 0.5


def test_an_offset_is_told_with_the_sum_that_it_stands_for() -> None:
    estimate = identified(arm(), records_of(arm(), 2, noise=0.2))
    part, said = estimate.require_robot(), "offset1 + m2 * 9.81"
    formulas = tuple(said if name == "offset1" else one for name, one in zip(part.names, part.formulas, strict=True))
    found = parameters_by_axis(replace(estimate, robot=replace(part, formulas=formulas)))
    assert {one.name: one.formula for one in found}["offset1"] == said


def test_what_is_fixed_is_neither_told_nor_not_told() -> None:
    records = records_of(arm(), 2, noise=0.2)
    free, kept = (identified(arm(), records, IDIM(fixed=one)) for one in ({}, {"Fv4": 1.5, "offset2": 0.0}))
    assert {row.name for row in free.params.rows if row.free} - set(kept.params.names) == {"Fv4", "offset2"}
    found = diagnose_robot(kept, records)
    known = {one.name: one.known for joint in found.axes for one in joint.parameters}
    assert known["Fv4"] is Told.FIXED and known["offset2"] is Told.FIXED
    told, asked = sum(one is Told.TOLD for one in known.values()), len(kept.params) - 2
    assert f"The record tells {told} of {asked} parameters" in found.answer
    assert f"{told} of {asked} parameters known to a tenth" in kept.sentence
    assert not any("offset2" in one for one in found.sentences)


def test_from_torques_alone_the_loop_is_not_seen_apart_from_the_model() -> None:
    loop = two().loop()
    records = [Record(torque=one.torque, reference=one.reference) for one in logged_by(loop)]
    estimate = identified(loop, records)
    found = diagnose_robot(estimate, records)
    assert found.as_declared is None and "not seen apart from the model" in found.answer
    assert found.explained
    np.testing.assert_allclose([one.left for one in found.axes], axis_errors(estimate), rtol=1e-9)


def test_the_sums_of_didim_are_those_of_its_parameters() -> None:
    loop = two().loop()
    fit = identify_rigid_robot(loop, logged_by(loop))
    sums = dict(zip(fit.names, fit.parameters.formulas(loop.robot), strict=True))
    assert sums["joint1.viscous"] == "joint1.viscous"
    assert any("lower" in text or " + " in text for text in sums.values())
    estimate = identified(loop, logged_by(loop))
    rows = parameters_by_axis(estimate)
    assert [one.axis for one in rows] == sorted(one.axis for one in rows)
    own = {one.name: one for one in rows}
    motors = [one for one in rows if one.name.startswith("joint")]
    assert {one.axis for one in motors} == {0, 1}
    assert all(one.name.startswith(f"joint{one.axis + 1}.") for one in motors)
    assert own["joint2.coulomb"].axis == 1 and own["joint2.coulomb"].nominal == pytest.approx(1.5)
    assert own["joint2.coulomb"].known is Told.TOLD


def test_little_that_is_left_is_not_called_noise_where_it_is_coloured() -> None:
    """A friction that rises a little towards standstill, undeclared: small, and said all the same."""
    records = records_of(arm(), 2, noise=0.002)
    v = motion(2)[1][:, 3]
    more = with_torque(records, 3, 0.1 * np.sign(v) * np.exp(-np.abs(v) / 0.15))
    found = diagnose_robot(identified(arm(), more), more)
    joint = found.axes[3]
    assert joint.explained and joint.coloured
    assert "but for noise" not in found.answer and "joint4 is no white noise" in found.answer
    assert any("which is little, but no white noise" in one and "stribeck_speed" in one for one in found.sentences)
