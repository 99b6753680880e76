"""MuJoCo, stepped: the law in Python once a period, between calls of `mj_step`.

The joint is two bodies on slides, a tendon between them, and dry friction as a constraint.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.peers.shape import Peer, Setting
from benchmarks.problem import PERIOD, TRUTH, Array, Loop

_HARD = "0.9999 0.9999 0.001"  # impedance of the friction constraint; the default of 0.9 lets what sticks creep

_XML = """
<mujoco>
  <option timestep="{step!r}" gravity="0 0 0" integrator="{integrator}"><flag contact="disable"/></option>
  <default><joint type="slide" axis="1 0 0" solimpfriction="{hard}" solreffriction="{settling!r} 1"/></default>
  <worldbody>
    <body name="motor"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="motor"/></body>
    <body name="load"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="load"/></body>
  </worldbody>
  <tendon>
    <fixed springlength="0 0" stiffness="1" damping="1" >
      <joint joint="motor" coef="-1"/><joint joint="load" coef="1"/>
    </fixed>
  </tendon>
  <actuator><motor name="drive" joint="motor"/></actuator>
</mujoco>
"""


class MujocoStep(Peer):
    """The law as it is: read every period, held in between. `mujoco.rollout` replays torques and cannot do that."""

    title = "MuJoCo mj_step"
    imports = ("mujoco",)
    settings = (
        Setting("implicit, 1 step", 1, method="implicit"),
        Setting("implicit, 8 steps", 8, method="implicit"),
        Setting("RK4, 1 step", 1, method="RK4"),
        Setting("RK4, 2 steps", 2, method="RK4"),
    )
    slow = 2500

    def __init__(self, loop: Loop, setting: Setting) -> None:
        import mujoco

        super().__init__(loop, setting)
        step = PERIOD / setting.steps
        text = _XML.format(step=step, settling=2 * step, integrator=setting.method, hard=_HARD)
        self.compiled: Any = mujoco.MjModel.from_xml_string(text)

    def torque(self, parameters: Array = TRUTH) -> Array:
        """Step through the record."""
        import mujoco

        model, steps, controller = self.compiled, self.setting.steps, self.loop.controller()
        m1, v1, c1, k, d, m2, v2, c2 = map(float, parameters)
        model.body_mass[1:] = m1, m2
        model.dof_damping[:] = v1, v2
        model.dof_frictionloss[:] = c1, c2
        model.tendon_stiffness[:], model.tendon_damping[:] = k, d
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        data.qpos[:] = self.loop.reference[0]
        found, position, control = np.empty(self.loop.samples), data.qpos, data.ctrl
        for period in range(found.size):
            control[0] = found[period] = controller(period, position[0])
            mujoco.mj_step(model, data, steps)
        return found
