"""Torque that a declared controller outputs for the logged motor position.

With a known law the position determines the torque: ``tau = C (reference, q)``. A fit of this torque minimises the
closed-loop output error of the motor position, filtered by the controller. A common factor of the law and the joint is
not identifiable: a loop whose gains, inertias, frictions and stiffnesses are all 10 % larger has the same position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.models.controllers import respond, run
from jointid.models.joints import ClosedLoop
from jointid.records.record import Channel, Record, Tap, Timing
from jointid.records.resampling import at_period
from jointid.simulation.loop_input import AxisInput, along, prepare, to_log

SOURCE = "computed from the controller and the motor position"


def compute_controller_torque(record: Record, loop: ClosedLoop) -> Record:
    """Record with the torque that the controller outputs for its motor position.

    Between two samples of the log the position follows a cubic spline. A logged torque is replaced; the computed one
    is then shown as the logged one was, at the same tap and with the same timing. The value of an integral at the first
    sample is unknown, and taken as 0: an offset of the joint then includes it.

    Args:
        record: with motor position, reference, and what else the controller reads.
        loop: joint and controller; no parameter of the joint is read.

    Raises:
        RecordError: a channel is missing, its unit is not the joint's, or the law gives no finite torque.

    Example:
        >>> import jointid as ji
        >>> law = ji.controller.PD(position_gain=400.0, derivative_gain=40.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
        >>> reference = ji.excitation.trapezoids((1.0, 2.0), acceleration=20.0, travel=1.0, sample_time=1e-3)
        >>> truth = {"inertia": 0.5, "viscous": 0.2, "coulomb": 1.0, "offset": 0.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> computed = ji.controller.compute_controller_torque(record.without("torque"), loop)
        >>> bool(abs(computed.torque.values - record.torque.values).max() < 1e-9)
        True
    """
    record.require(("motor_position", *loop.controller.channels), "A torque computed from the controller")
    assert record.motor_position is not None
    seen = record if record.torque is not None else replace(record, tap=Tap.COMMAND)
    output = law_outputs(record.motor_position, prepare(loop, seen).axis)[:, 0]
    if not np.all(np.isfinite(output)):
        raise RecordError(
            "The declared controller gives no finite torque for the logged motor position; expected a stable law: "
            "check its gains and units."
        )
    logged = record.torque
    timing = Timing.HELD if logged is None else logged.timing
    sample_time = record.motor_position.sample_time if logged is None else logged.sample_time
    return replace(
        seen, torque=Channel(output, loop.joint.force_unit, sample_time, timing, SOURCE), computed_by=loop.controller
    )


def law_outputs(position: Channel, axis: AxisInput) -> FloatArray:
    """Logged torque of the law, and of any unit integral, (samples, columns).

    Args:
        position: of the motor.
        axis: input of its record, from `prepare`.
    """
    law = axis.law
    inputs, start = _along(position, axis, axis.inputs)
    output = run(law, inputs, start) + axis.shown
    integral, columns = law.integral(), [output]
    if integral is not None:
        columns.append(respond(law, np.zeros_like(inputs), integral)[:, law.output])
    return to_log(axis, np.column_stack(columns))


def seen_position(record: Record, loop: ClosedLoop) -> SeenPosition | None:
    """Map from position to computed torque; None for a logged torque."""
    if record.computed_by is None or record.motor_position is None:
        return None
    return SeenPosition(prepare(replace(loop, controller=record.computed_by), record).axis)


@dataclass(frozen=True, slots=True, eq=False)
class SeenPosition:
    """Map from motor position to torque: the declared law without limits.

    Attributes:
        axis: input of the record under the declared law, from `prepare`.
    """

    axis: AxisInput

    def torque(self, position: FloatArray) -> FloatArray:
        """Torque as logged, (samples,), for a position at the log's instants."""
        return self.respond(position, self.axis.inputs) + to_log(self.axis, self.axis.shown)

    def slopes(self, positions: FloatArray) -> FloatArray:
        """Derivatives of the torque, (samples, names), from those of the motor position."""
        none = np.zeros_like(self.axis.inputs)
        columns = [self.respond(one, none) for one in positions.T]
        return np.column_stack(columns) if columns else positions

    def respond(self, position: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the output of a law without limits along a position, (samples,)."""
        channel, law = Channel(position, "", self.axis.sample_time), self.axis.law
        inputs, start = _along(channel, self.axis, inputs)
        return to_log(self.axis, respond(law, inputs, start)[:, law.output])


def _along(position: Channel, axis: AxisInput, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Law inputs of an axis with a motor position, and initial states."""
    law = axis.law
    return along(law, inputs, at_period(position, law.period, axis.periods, "motor_position", "spline"))
