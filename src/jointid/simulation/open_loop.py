"""A joint in open loop: the torque is prescribed as the drive logged it, and the motor's motion follows.

The kernels take it as a controller without feedback, whose reference is the torque, held from each of its instants to
the next. When it begins to act follows from its stamp, its timing and how late the log is.

Nothing holds a motor in open loop: its position is the double integral of every small force that the model lacks, so
it drifts, and only what is faster than the drift can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import StateSpaceController
from jointid.models.joints import Joint
from jointid.models.parameters import POSITION_UNIT
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.loop_input import ClosedLoop, LoopInput, prepare
from jointid.simulation.sensitivities import simulate_sensitivities

_BEGINS = {Timing.HELD: 0.0, Timing.SAMPLED: -0.5, Timing.AVERAGED: -1.0}  # samples after its stamp, see `signals`


@dataclass(frozen=True, slots=True)
class OpenLoop:
    """A joint under a torque that does not answer to its motion: from torque to motor position.

    Attributes:
        joint: rigid or flexible.
    """

    joint: Joint

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels a record must have to be compared with this."""
        return ("torque", "motor_position")


@dataclass(frozen=True, slots=True, eq=False)
class OpenLoopRun:
    """The motor's position in one run, and its derivatives by the names asked for.

    Attributes:
        position: (samples,), as an encoder would show it.
        derivatives: (samples, names).
        finished: False for values that no joint has, or a joint too fast to be simulated; all else is then 0.
    """

    position: FloatArray
    derivatives: FloatArray
    finished: bool


def simulate_open_loop(
    joint: Joint, torque: Channel, values: Mapping[str, float], names: Sequence[str] = ()
) -> OpenLoopRun:
    """Simulate a joint under a torque; a load begins in steady motion with the motor.

    Args:
        joint: rigid or flexible.
        torque: on the motor.
        values: every parameter of the joint by name, ``initial_position`` and ``initial_velocity`` of the motor, and
            ``log_delay``, by which the channel shows the torque later than it acts.
        names: of these, to return derivatives by.
    """
    loop, experiment = _driven(joint, torque, values["log_delay"])
    initial = Initial(values["initial_position"], values["initial_velocity"])
    run = simulate(loop, experiment, values, initial)
    if run.outcome is not Outcome.FINISHED:
        return OpenLoopRun(np.zeros(torque.values.size), np.zeros((torque.values.size, len(names))), False)
    if not names:
        return OpenLoopRun(run.motor_position, np.zeros((run.motor_position.size, 0)), True)
    of_law = ["delay" if name == "log_delay" else name for name in names]
    slopes = simulate_sensitivities(loop, experiment, values, of_law, initial, positions=True).motor_position
    # A log that is later by so much shows a torque that acts earlier by as much.
    signs = np.array([-1.0 if name == "log_delay" else 1.0 for name in names])
    return OpenLoopRun(run.motor_position, slopes * signs, True)


def _driven(joint: Joint, torque: Channel, log_delay: float) -> tuple[ClosedLoop, LoopInput]:
    """Return the joint under the law that only passes the torque on, and what drives it."""
    period = torque.sample_time
    late = _BEGINS[torque.timing] - log_delay / period
    whole = math.floor(late)
    picked = np.clip(np.arange(torque.values.size) - whole, 0, torque.values.size - 1)
    passed = Channel(torque.values[picked], POSITION_UNIT[joint.kind], period)
    law = StateSpaceController(
        A=np.zeros((0, 0)), B={}, C=np.zeros(0), D={"reference": 1.0}, delay=(late - whole) * period
    )
    loop = ClosedLoop(joint, law)
    return loop, prepare(loop, Record(reference=passed))
