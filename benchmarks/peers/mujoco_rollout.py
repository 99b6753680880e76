"""MuJoCo's `rollout`, which replays what is known beforehand: the law has to become an actuator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.peers.mujoco_model import model_of, tell
from benchmarks.peers.shape import CORES, Peer, Setting, perturbed
from benchmarks.problem import Array, Loop


class MujocoRollout(Peer):
    """An affine actuator reads position and velocity at every step: no filter, nothing held."""

    key = "rollout"
    title = "MuJoCo rollout"
    imports = ("mujoco.rollout",)
    requires = ("mujoco",)
    settings = tuple(
        Setting(f"implicit, {steps} step{'s' * (steps > 1)}", steps, "frictionloss", method="implicit", error=error)
        for steps, error in ((1, 0.3), (2, 0.3), (4, 0.3))
    )
    model = "`frictionloss`; the law is an affine actuator, without its filter and its hold"
    derivatives = "forward differences, nine simulations in one `rollout`, two threads"
    many = "`rollout` over two threads"
    slow = 2500
    batch_size = 64

    def __init__(self, loop: Loop, setting: Setting) -> None:
        super().__init__(loop, setting)
        law, steps = loop.law, setting.steps
        self.actuator = (
            f'<general name="drive" joint="motor" gainprm="1" biastype="affine" '
            f'biasprm="0 {-law.position_gain!r} {-law.derivative_gain!r}" '
            f'forcerange="{-law.limit!r} {law.limit!r}"/>'
        )
        self.compiled = model_of(setting, self.actuator)
        # The reference moves on between two samples, as the position does that is compared with it; pulses are held.
        at, smooth = np.arange(loop.samples * steps) / steps, loop.feedforward - loop.pulse
        filled = np.interp(at, np.arange(loop.samples), smooth) + np.repeat(loop.pulse, steps)
        self.control = filled[np.newaxis, :, np.newaxis]

    def torque(self, parameters: Array) -> Array:
        """Roll out one joint."""
        tell(self.compiled, parameters)
        return self._rolled([self.compiled], 1)[0]

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Roll out the perturbed joints side by side."""
        moved, by = perturbed(parameters)
        torque, *others = self.batch(moved)
        return torque, (np.array(others) - torque).T / by

    def batch(self, candidates: Array) -> Sequence[Array]:
        """Roll out all candidates."""
        return self._rolled([model_of(self.setting, self.actuator, parameters) for parameters in candidates], CORES)

    def _rolled(self, models: list[Any], threads: int) -> list[Array]:
        import mujoco
        from mujoco import rollout

        size = mujoco.mj_stateSize(self.compiled, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        begun = np.zeros((len(models), size))
        begun[:, 1:3] = self.loop.reference[0]  # after the time
        data = [mujoco.MjData(self.compiled) for _ in range(threads)]
        _, forces = rollout.rollout(models, data, begun, self.control)
        return list(forces[:, :: self.setting.steps, 0])
