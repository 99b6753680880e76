"""Drives that run faster than they log: their log, and their loop without the period."""

from dataclasses import replace

import numpy as np

import jointid as ji

LOG = 1e-3  # s
RIGID = {"inertia": 1.0, "viscous": 1.7, "coulomb": 4.5, "offset": 0.3}
CASCADE = ji.controller.Cascade(position_gain=25.0, velocity_gain=110.0)
SERVO = ji.controller.PD(position_gain=2500.0, derivative_gain=95.0, velocity_filter=ji.controller.FirstOrder(0.8e-3))


def drive(
    law: ji.controller.Cascade | ji.controller.PD, times: int, *, noise: float = 0.3
) -> tuple[ji.Record, ji.ClosedLoop]:
    """The log, at 1 kHz, of a drive that runs so many times as fast, and its loop without the period."""
    fine, rng = LOG / times, np.random.default_rng(1)
    controller = replace(law, delay=fine)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), controller)
    reference = ji.excitation.trapezoids((0.4, 0.8, 1.2), 8.0, 0.6, fine, duration=6.0)
    record = ji.simulated_record(loop, reference, RIGID, sample_time=fine, name="drive")

    def logged(channel: ji.Channel) -> ji.Channel:
        return replace(channel, values=channel.values[::times].copy(), sample_time=LOG)

    assert record.torque is not None
    assert record.reference is not None
    torque = logged(record.torque)
    torque = replace(torque, values=torque.values + noise * rng.standard_normal(torque.values.size))
    shown = replace(record, torque=torque, reference=logged(record.reference), motor_position=None, load_position=None)
    return shown, loop
