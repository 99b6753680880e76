"""What a robot's drives may do with their references otherwise than declared, as suspects of its joints.

A drive that is faster than its reference holds it, draws lines through it, or cubics; it may average it over a time.
One simulation for each, of all joints at once, shows what that changes of their torques: what a joint's reference
changes of another's torque is little.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.faults.fault import Fault, FaultSignature, Measure
from jointid.diagnostics.robot_causes import RobotCause
from jointid.diagnostics.variants import AVERAGED, INTERPOLATIONS, list_other_ways, say_way
from jointid.estimation.robots.problem import RobotLoopProblem, robot_problem
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.models.controllers.servo_base import DiagramController
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import LoopInput
from jointid.simulation.robot_numbers import RobotNumbers
from jointid.simulation.robots import RobotLoop

_SCREENED = 4  # samples of the log: of the mean that is simulated
_LEAST = 0.5  # of a change: less shows that the drive runs no such law
_FAR_OFF, _BETTER = 0.1, 0.3  # of a torque, that the model leaves; of that, under what the drives do

_WAYS = {
    way: replace(fault, says=f'{say_way(way)}: declare interpolation = "{way}"', one_sided=True, least=_LEAST)
    for way, fault in INTERPOLATIONS.items()
}
WHOLE = tuple(fault.name for fault in _WAYS.values())
"""Names of those that a drive has or has not, so that their size is 1."""
_MEAN = replace(
    AVERAGED, says="the drive averages the reference over some {size}, or it is late by half of that: declare "
    "reference_average, or reference_delay", one_sided=True, measure=Measure.TIME,
)  # fmt: skip


def list_reference_laws(
    setup: RobotLoop, records: Sequence[Record], problem: RobotLoopProblem, numbers: RobotNumbers, predicted: FloatArray
) -> list[list[FaultSignature]]:
    """Return what other ways of its reference change of the torque of each joint, per unit of their sizes, (rows,).

    Args:
        setup: the robot under its controllers.
        records: of each joint.
        problem: of them.
        numbers: of the robot.
        predicted: (n, rows) filtered torques of its simulation.
    """
    log, inputs = problem.sample_time, problem.experiment.experiments
    each = [dict(_list_ways(*one, log)) for one in zip(setup.controllers, records, inputs, strict=True)]
    found: list[list[FaultSignature]] = [[] for _ in each]
    for fault in dict.fromkeys(fault for ways in each for fault in ways):
        laws = tuple(ways.get(fault, law) for ways, law in zip(each, setup.controllers, strict=True))
        with contextlib.suppress(JointidError):  # a log that such a controller cannot have
            other = robot_problem(replace(setup, controllers=laws), records, problem.parameters, problem.filtering)
            run = other.run_of(numbers, keep=False)
            moved = None if run is None else other.by_joint(other.decimate(other.predict(run))) - predicted
            for k, ways in enumerate(each if moved is not None else ()):
                if fault in ways and moved is not None:
                    found[k].append(FaultSignature(fault, moved[k] / (_SCREENED * log if fault is _MEAN else 1.0)))
    return found


def _list_ways(law: Any, record: Record, read: LoopInput, log: float) -> Iterator[tuple[Fault, Any]]:
    """Yield the other ways of a joint's reference, and its controller with each."""
    for way in list_other_ways(law, record, read.law.period):
        yield _WAYS[way], replace(law, interpolation=way)
    if isinstance(law, DiagramController) and not law.reference_average:
        yield _MEAN, replace(law, reference_average=_SCREENED * log)


def find_filled_references(
    setup: RobotLoop, records: Sequence[Record], filtering: Filtering, left: Mapping[str, float]
) -> RobotCause | None:
    """Return the other interpolation under which a robot that is far off is identified; None if it is no better.

    One step from there shows no law, and drives of a robot are alike: one identification of all joints tells.

    Args:
        setup: the robot under its controllers.
        records: of each joint.
        filtering: of its identification.
        left: share of its torque that each joint leaves, by name.
    """
    laws: list[Any] = [*setup.controllers]
    steps = [getattr(law, "period", None) or np.inf for law in laws]  # at the rate of the log nothing is filled in
    ways = [list_other_ways(*one) for one in zip(laws, records, steps, strict=True)]
    first = next((each[0] for each in ways if each), None)
    if first is None or max(left.values()) < _FAR_OFF:
        return None
    for k in (k for k, each in enumerate(ways) if each):
        laws[k] = replace(laws[k], interpolation=first)
    try:
        other = identify_simulated_robot(replace(setup, controllers=tuple(laws)), records, filtering=filtering)
    except (JointidError, np.linalg.LinAlgError):
        return None
    after = other.fit.axis_errors
    if max(after.values()) > _BETTER * max(left.values()):
        return None
    explained = sum(1.0 - (after[name] / left[name]) ** 2 for name in after if left[name] > 0.0)
    joints = tuple(name for name, each in zip(after, ways, strict=True) if each)
    return RobotCause(INTERPOLATIONS[first].name, joints, _WAYS[first].says, None, explained)
