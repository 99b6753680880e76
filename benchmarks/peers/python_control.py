"""python-control: the sampled loop as one nonlinear discrete-time system, run by `input_output_response`."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.peers.shape import InProcesses, Setting, rates, step_of
from benchmarks.problem import PERIOD, Array, Loop


class PythonControl(InProcesses):
    """The joint is a state-space model that `c2d` discretises exactly; friction and law are Python."""

    key = "control"
    title = "python-control"
    imports = ("control",)
    requires = ("control",)
    settings = (
        Setting("1 step, friction held", 1, "held", error=0.02),
        Setting("2 steps, friction held", 2, "held", error=0.01),
        Setting("4 steps, friction held", 4, "held", error=0.006),
        Setting("4 steps, friction smooth over 2e-5 m/s", 4, "smooth", 2e-5, error=0.05),
    )
    model = (
        "`ss`, `c2d`, `nlsys` and `input_output_response`; steps as for JAX. Continuous and sampled parts do not mix"
    )
    many = "two processes"
    slow = 2500

    def torque(self, parameters: Array) -> Array:
        """Build the system and run it."""
        import control

        loop = self.loop
        time = np.arange(loop.samples) * PERIOD
        start = float(loop.reference[0])
        begun = np.array([start, 0.0, start, 0.0, 0.0, start, 0.0])
        response = control.input_output_response(
            _system(loop, self.setting, parameters), time, loop.feedforward, begun
        )  # fmt: skip
        return np.asarray(response.outputs)


def _system(loop: Loop, setting: Setting, parameters: Array) -> Any:
    import control

    law = loop.law
    matrices = rates(parameters)
    sliding = control.ss(matrices[:, :4], matrices[:, 4:], np.eye(4), np.zeros((4, 2)))
    stepped = control.c2d(sliding, step_of(setting), "zoh")
    A, by_torque, by_load = np.asarray(stepped.A), np.asarray(stepped.B)[:, 0], np.asarray(stepped.B)[:, 1]
    c1, c2, width = float(parameters[2]), float(parameters[7]), setting.width

    def filtered(state: Array) -> float:
        moved = law.now * (state[0] - state[5]) + law.before * state[6]
        return float(law.memory * state[4] + moved / PERIOD)

    def output(_t: float, state: Array, fed: Array, _p: object) -> float:
        torque = fed[0] - law.position_gain * state[0] - law.derivative_gain * filtered(state)
        return float(min(max(torque, -law.limit), law.limit))

    def update(t: float, state: Array, fed: Array, given: object) -> Array:
        torque, x = output(t, state, fed, given), state[:4]
        for _ in range(setting.steps):
            free = A @ x + by_torque * torque
            if setting.friction == "smooth":
                f1, f2 = c1 * np.tanh(x[1] / width), c2 * np.tanh(x[3] / width)
            else:
                f1 = min(max(free[1] / by_torque[1], -c1), c1)
                f2 = min(max(free[3] / by_load[3], -c2), c2)
            x = free - by_torque * f1 - by_load * f2
        return np.array([*x, filtered(state), state[0], state[0] - state[5]])

    return control.nlsys(update, output, inputs=1, outputs=1, states=7, dt=PERIOD)
