"""Drives that run faster than they log: their log, and their loop without the period."""

from dataclasses import replace

import numpy as np

import jointid as ji

LOG = 1e-3  # s
RIGID = {"inertia": 1.0, "viscous": 1.7, "coulomb": 4.5, "offset": 0.3}
FLEXIBLE = {
    "motor_inertia": 0.45, "motor_viscous": 0.9, "motor_coulomb": 2.5, "stiffness": 9000.0, "damping": 2.5,
    "load_inertia": 0.55, "load_viscous": 0.8, "load_coulomb": 2.0, "offset": 0.3,
}  # fmt: skip
CASCADE = ji.controller.Cascade(position_gain=25.0, velocity_gain=110.0)
SERVO = ji.controller.PD(position_gain=2500.0, derivative_gain=95.0, velocity_filter=ji.controller.FirstOrder(0.8e-3))


def drive(
    law: ji.controller.Cascade | ji.controller.PD, times: int, *, flexible: bool = False, noise: float = 0.3
) -> tuple[ji.Record, ji.ClosedLoop]:
    """The log, at 1 kHz, of a drive that runs so many times as fast, and its loop without the period."""
    fine, rng = LOG / times, np.random.default_rng(1)
    controller = replace(law, delay=fine)
    joint = ji.FlexibleJoint("revolute") if flexible else ji.RigidJoint("revolute")
    reference = ji.excitation.trapezoids((0.4, 0.8, 1.2), 8.0, 0.6, fine, duration=12.0 if flexible else 6.0)
    record = ji.simulated_record(
        ji.ClosedLoop(joint, controller), reference, FLEXIBLE if flexible else RIGID, sample_time=fine,
        name="drive",
    )  # fmt: skip

    def logged(channel: ji.Channel) -> ji.Channel:
        return replace(channel, values=channel.values[::times].copy(), sample_time=LOG)

    assert record.torque is not None
    assert record.reference is not None
    torque = logged(record.torque)
    torque = replace(torque, values=torque.values + noise * rng.standard_normal(torque.values.size))
    shown = replace(
        record, torque=torque, reference=logged(record.reference), motor_position=None, load_position=None,
    )  # fmt: skip
    return shown, ji.ClosedLoop(joint, controller)
