"""This package: the exact simulation, its exact derivatives, threads."""

from __future__ import annotations

from typing import Any

from benchmarks.peers.shape import Peer, Setting
from benchmarks.problem import NAMES, PERIOD, Array, Law, Loop


class Engine(Peer):
    """`run_loop` and `differentiate`: exact to rounding, with exact derivatives of the same run."""

    title = "jointid"
    settings = (Setting("exact"),)

    def __init__(self, loop: Loop, setting: Setting) -> None:
        from jointid.simulation.loop_input import prepare

        super().__init__(loop, setting)
        self.closed = _closed(loop.law)
        self.experiment = prepare(self.closed, _record(loop))

    def torque(self, parameters: Array) -> Array:
        """Return the torque that an optimiser is given for one candidate."""
        from jointid.simulation.plant import Numbers
        from jointid.simulation.simulate import run_loop

        return run_loop(self.experiment, Numbers.of_joint(self.closed.joint, _values(parameters))).torque

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Return the torque and its exact derivatives."""
        from jointid.simulation.derivatives import differentiate
        from jointid.simulation.plant import Numbers, Place
        from jointid.simulation.simulate import run_loop

        run = run_loop(self.experiment, Numbers.of_joint(self.closed.joint, _values(parameters)), keep=True)
        (slopes,), _ = differentiate(run, [Place(0, name) for name in NAMES])
        return run.torque, slopes


def _closed(law: Law) -> Any:
    from jointid.controller import PD, Cascade, DigitalFilter
    from jointid.models.joints import ClosedLoop, FlexibleJoint

    filtered = DigitalFilter((law.now, law.before), (1.0, -law.memory))
    if law.fed:
        controller = PD(
            position_gain=law.position_gain, derivative_gain=law.derivative_gain, reference_velocity="channel",
            velocity_filter=filtered, limit=law.limit
        )  # fmt: skip
        return ClosedLoop(FlexibleJoint("prismatic"), controller)
    return ClosedLoop(
        FlexibleJoint("prismatic"), Cascade(position_gain=law.position_gain / law.derivative_gain,
        velocity_gain=law.derivative_gain, velocity_filter=filtered, limit=law.limit)
    )  # fmt: skip


def _record(loop: Loop) -> Any:
    from jointid.records.record import Channel, Injection, InjectionPoint, Record

    return Record(
        reference=Channel(loop.reference, "m", PERIOD),
        reference_velocity=Channel(loop.reference_velocity, "m/s", PERIOD),
        injected=Injection(Channel(loop.pulse, "N", PERIOD), InjectionPoint.BEFORE_LIMIT),
    )


def _values(parameters: Array) -> dict[str, float]:
    return {**dict(zip(NAMES, map(float, parameters), strict=True)), "offset": 0.0}
