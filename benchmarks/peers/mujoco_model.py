"""The joint as a MuJoCo model: two bodies on slides, a tendon between them, dry friction as a constraint."""

from __future__ import annotations

from typing import Any

from benchmarks.peers.shape import Setting, step_of
from benchmarks.problem import TRUTH, Array

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
  <actuator>{actuator}</actuator>
  <sensor><actuatorfrc actuator="drive"/></sensor>
</mujoco>
"""

MOTOR = '<motor name="drive" joint="motor"/>'
"""An actuator that puts out what it is told."""


def model_of(setting: Setting, actuator: str = MOTOR, parameters: Array = TRUTH) -> Any:
    """Return the model with these parameters."""
    import mujoco

    step = step_of(setting)
    model = mujoco.MjModel.from_xml_string(
        _XML.format(step=step, settling=2 * step, integrator=setting.method, hard=_HARD, actuator=actuator)
    )
    tell(model, parameters)
    return model


def tell(model: Any, parameters: Array) -> None:
    """Change the parameters of a model, and what MuJoCo derives from them."""
    import mujoco

    m1, v1, c1, k, d, m2, v2, c2 = map(float, parameters)
    model.body_mass[1:] = m1, m2
    model.dof_damping[:] = v1, v2
    model.dof_frictionloss[:] = c1, c2
    model.tendon_stiffness[:], model.tendon_damping[:] = k, d
    mujoco.mj_setConst(model, mujoco.MjData(model))
