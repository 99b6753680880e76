"""What a record says of a law beside its numbers: other names of it, and what cannot be told."""

from __future__ import annotations

from collections.abc import Iterator

from jointid.common.text import number
from jointid.controller_id.fitting import Fitted, Task
from jointid.controller_id.structures import VELOCITY, Structure
from jointid.records.record import Tap

ALIKE = 10.0  # of the criterion: what is nearer cannot be told apart


def equivalents(structure: Structure) -> tuple[str, ...]:
    """Return the other names of a law: the same equation with its gains combined otherwise."""
    plain = structure.velocity_filter == "none" and structure.every == 1
    found = []
    if structure.law == "P-P" and structure.reference_velocity == "none" and structure.every == 1:
        found.append('PD with reference_velocity = "none", its kp = kp kv and kd = kv')
    if structure.law == "P-P" and structure.reference_velocity == "full" and plain:
        found.append('PD with reference_velocity = "difference", its kp = kp kv and kd = kv')
    if structure.law == "P-P" and structure.reference_velocity == "share":
        found.append("P-P with viscous_feedforward = kv velocity_feedforward instead")
    if structure.law == "P-PI" and structure.reference_velocity == "full" and plain:
        found.append(
            'PID with reference_velocity = "difference", its kp = kv (kp + ki), kd = kv (1 - ki T), ki = kv kp ki'
        )
    if not structure.cascade and VELOCITY in structure.feedforward and structure.reference_velocity == "difference":
        found.append("the same with a larger weight of the reference's velocity")
    return tuple(found)


def untold(task: Task, best: Fitted, alike: tuple[Structure, ...]) -> tuple[str, ...]:
    """Return what the record cannot tell, one sentence each."""
    return tuple(_untold(task, best, alike))


def _untold(task: Task, best: Fitted, alike: tuple[Structure, ...]) -> Iterator[str]:
    structure, watched = best.structure, task.watched
    unit = watched.record.torque.unit if watched.record.torque is not None else ""
    if not structure.integrates:
        yield "An integral does not act in this record: it carries less than 0.1 % of the torque, or there is none."
    if not structure.limited:
        most = number(float(abs(watched.torque).max()), 4)
        yield f"The limit is not reached in this record; it is above {most} {unit}, the largest torque."
    elif structure.integrates:
        yield "What becomes of the integral at the limit (anti_windup) was not weighed; it is taken to stop."
    if structure.torque_filter == "none":
        yield "A torque filter does not show where its change of the torque is lost in the noise."
    if watched.record.tap is Tap.COMMAND:
        yield (
            'A delay between the controller\'s output and the torque that acts does not show at the tap "command"; '
            "delay is what the drive's maker says."
        )
        if structure.late:
            yield (
                f"The log shows the torque {structure.late} samples later than the position it follows from; declare "
                'tap = "measured" for the torque, so that the delay is seen in it, or shift the log.'
            )
    if structure.rate > 1 or any(other.rate != structure.rate for other in alike):
        yield "The loop's period is only told by how late its velocity is; a filter of the velocity may do the same."
        yield (
            "Between the log's samples the reference is taken to be as the controller's interpolation says, and the "
            "position a cubic spline. Where that is not so, the numbers are off by more than their intervals."
        )
    if alike:
        yield f"The record does not tell this law from: {'; '.join(one.words for one in alike)}."
