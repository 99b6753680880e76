"""MuJoCo, stepped: the law in Python once a period, between calls of `mj_step`; batches by `mujoco.batch`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.peers.mujoco_model import model_of, tell
from benchmarks.peers.shape import CORES, Peer, Setting
from benchmarks.problem import PERIOD, Array, Loop


class MujocoStep(Peer):
    """The law as it is: read every period, held in between. `mujoco.rollout` replays torques and cannot do that."""

    key = "mujoco"
    title = "MuJoCo mj_step"
    imports = ("mujoco.batch",)
    requires = ("mujoco",)
    settings = (
        Setting("implicit, 1 step", 1, "frictionloss", method="implicit", error=0.07),
        Setting("implicit, 4 steps", 4, "frictionloss", method="implicit", error=0.02),
        Setting("implicit, 8 steps", 8, "frictionloss", method="implicit", error=0.01),
        Setting("RK4, 1 step", 1, "frictionloss", method="RK4", error=0.03),
        Setting("RK4, 2 steps", 2, "frictionloss", method="RK4", error=0.015),
        Setting("RK4, 8 steps", 8, "frictionloss", method="RK4", error=0.005),
    )
    model = "`frictionloss`, its constraint made hard; the law in Python around `mj_step`"
    many = "`mujoco.batch`, two threads, the law in NumPy"
    slow = 2500
    batch_size = 64

    def __init__(self, loop: Loop, setting: Setting) -> None:
        super().__init__(loop, setting)
        self.compiled = model_of(setting)

    def torque(self, parameters: Array) -> Array:
        """Step through the record."""
        import mujoco

        tell(self.compiled, parameters)
        data = mujoco.MjData(self.compiled)
        data.qpos[:] = self.loop.reference[0]
        return self._stepped(data, mujoco.mj_step)

    def _stepped(self, data: Any, step: Any) -> Array:
        model, steps, controller = self.compiled, self.setting.steps, self.loop.controller()
        found, position, control = np.empty(self.loop.samples), data.qpos, data.ctrl
        for period in range(found.size):
            control[0] = found[period] = controller(period, position[0])
            step(model, data, steps)
        return found

    def batch(self, candidates: Array, offsets: Array | None = None) -> Sequence[Array]:
        """Step all candidates together, each with an offset in N on its motor; the law is vectorised."""
        from mujoco.batch import Batch

        law, loop, w = self.loop.law, self.loop, self.loop.feedforward
        batch = Batch(self.compiled, len(candidates), CORES)
        batch.set_models([model_of(self.setting, parameters=parameters) for parameters in candidates])
        position, control = batch.bind("qpos"), batch.bind("ctrl")
        position[:] = loop.reference[0]
        if offsets is not None:
            batch.bind("qfrc_applied")[:, 0] = -offsets
        last, velocity, moved = position[:, 0].copy(), np.zeros(len(candidates)), np.zeros(len(candidates))
        found = np.empty((loop.samples, len(candidates)))
        for period in range(loop.samples):
            q = position[:, 0]
            velocity = law.memory * velocity + (law.now * (q - last) + law.before * moved) / PERIOD
            moved, last = q - last, q.copy()
            control[:, 0] = found[period] = np.clip(
                w[period] - law.position_gain * q - law.derivative_gain * velocity, -law.limit, law.limit
            )
            batch.step(nstep=self.setting.steps)
        return list(found.T)
