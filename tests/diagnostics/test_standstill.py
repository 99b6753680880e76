"""An axis that hardly moves is told that, and by how much; no healthy one is, nor one with any other mistake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import JointidError
from jointid.diagnostics.faults.record import find_lost_motion, find_standstill
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.uncertainty.verdict import Reason
from tests.mistakes import Axis, AxisName, axis, mistakes_of, run, tell, without_positions


def smaller(name: AxisName, share: float, noise: float = 1.0) -> tuple[Axis, Record, ClosedLoop]:
    """An axis that is asked for so much of its motion only, with so much of its noise."""
    made = axis(name)
    reference = made.reference[0] + share * (made.reference - made.reference[0])
    made = replace(made, reference=reference, noise=noise * made.noise, log_noise=noise * made.log_noise)
    return made, run(made, made.controller), ClosedLoop(made.joint, made.controller)


@pytest.mark.parametrize(("name", "share"), [("direct", 4e-4), ("flexible", 2e-5)])
def test_an_axis_that_its_friction_holds_is_told_so_from_its_torque(name: AxisName, share: float) -> None:
    made, record, loop = smaller(name, share, noise=0.03)
    assert np.ptp(record.motor_position.values) == 0  # type: ignore[union-attr]
    for seen in (record, without_positions(record)):
        message = find_standstill(seen, loop)
        assert message is not None and message.code is Reason.HARDLY_MOVES
        assert str(message).startswith("the axis hardly moves: ")
        asked = np.ptp(made.reference)
        assert f"{asked:.1e}" in str(message)
    assert "with the motor at rest the controller would make all of this torque but" in str(message)


@pytest.mark.slow
def test_that_is_what_an_identification_says_then() -> None:
    _, record, loop = smaller("flexible", 2e-5, noise=0.03)
    words = tell(without_positions(record), loop)[1]
    assert "the axis hardly moves: with the motor at rest the controller would make all of this torque but" in words
    assert "no response" not in words


def test_a_few_steps_of_an_encoder_are_hardly_a_motion() -> None:
    _, record, loop = smaller("direct", 0.01)
    motor = record.motor_position
    assert motor is not None
    step = np.ptp(motor.values) / 6
    coarse = record.with_channels({"motor_position": replace(motor, values=step * np.round(motor.values / step))})
    message = find_standstill(coarse, loop)
    assert message is not None
    assert "6 steps of its encoder, where 0.015 rad are asked" in str(message)
    assert find_standstill(record, loop) is None


def test_a_motion_that_is_lost_in_what_disturbs_the_axis_is_told_so() -> None:
    """Where no cause explains the torque: the reference would make less than all of it even with the motor at rest."""
    _, record, loop = smaller("flexible", 1e-4)
    record = without_positions(record)
    message = find_lost_motion(record, loop, 0.89)
    assert message is not None
    assert str(message).startswith(
        "the axis hardly moves: the reference travels 5.0e-06 m in all, and 89 % of the torque"
    )
    assert find_lost_motion(record, loop, 0.2) is None
    _, record, loop = smaller("flexible", 1.0)
    assert find_lost_motion(record, loop, 0.89) is None


@pytest.mark.parametrize("name", ["rigid", "direct", "flexible", "lift"])
def test_no_other_axis_hardly_moves(name: AxisName) -> None:
    """None at all of a healthy one, nor of one with another mistake; a record that is refused is told why."""
    _, record, loop = smaller(name, 1.0)
    made, found = axis(name), [find_standstill(record, loop)]
    for mistake in mistakes_of(made)[:: 4 if name == "rigid" else 7]:
        try:
            found.append(find_standstill(*mistake.make(made, 1)))
        except JointidError:
            continue
    assert found == [None] * len(found)
