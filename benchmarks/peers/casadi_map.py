"""CasADi: one period as an expression, `mapaccum` over the record, compiled by gcc where there is one."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.peers.shape import CORES, Peer, Setting, step_of
from benchmarks.problem import NAMES, PERIOD, Array, Loop

_TERMS = 12  # of the exponential's series: the fastest rate times the step is 0.2 at most


class CasadiMap(Peer):
    """The sliding joint is stepped by its matrix exponential; only friction is approximate."""

    key = "casadi"
    title = "CasADi mapaccum"
    imports = ("casadi",)
    requires = ("casadi",)
    settings = (
        Setting("1 step, friction held", 1, "held", error=0.02),
        Setting("2 steps, friction held", 2, "held", error=0.01),
        Setting("4 steps, friction held", 4, "held", error=0.006),
        Setting("8 steps, friction held", 8, "held", error=0.004),
        Setting("4 steps, friction smooth over 2e-5 m/s", 4, "smooth", 2e-5, error=0.05),
    )
    model = "`mapaccum`, generated C (gcc -O3 -march=native); steps as for JAX"
    derivatives = "`forward(8)` of the same function, generated C"
    many = "`map` over two threads"
    batch_size = 64

    def __init__(self, loop: Loop, setting: Setting) -> None:
        super().__init__(loop, setting)
        self.w = loop.feedforward[np.newaxis]
        self._one = _simulation(loop, setting)
        self._slopes: Any = None
        self._many: Any = None

    def torque(self, parameters: Array) -> Array:
        """Call the compiled function."""
        return np.asarray(self._one(parameters, self.w)).ravel()

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Propagate one direction for each parameter; building that takes seconds, once."""
        size = len(NAMES)
        self._slopes = self._slopes or self._one.forward(size)
        torque = self.torque(parameters)
        seeds = np.zeros((1, size * torque.size))  # the feedforward does not move
        columns = self._slopes(parameters, self.w, torque[np.newaxis], np.eye(size), seeds)
        return torque, np.asarray(columns).reshape(size, -1).T

    def batch(self, candidates: Array) -> Sequence[Array]:
        """Map the function over the candidates."""
        self._many = self._many or self._one.map(len(candidates), "thread", CORES)
        torques = self._many(candidates.T, np.tile(self.w, (1, len(candidates))))
        return list(np.asarray(torques).reshape(len(candidates), -1))


def _simulation(loop: Loop, setting: Setting) -> Any:
    """Return torque as a function of the parameters (8) and the feedforward (1, samples)."""
    import casadi as ca

    prepared, period = _prepared(setting), _period(loop, setting)
    p, w = ca.MX.sym("p", len(NAMES)), ca.MX.sym("w", 1, loop.samples)
    start = float(loop.reference[0])
    begun = ca.MX([start, 0.0, start, 0.0, 0.0, start, 0.0])
    torque = period.mapaccum(loop.samples)(begun, w, ca.repmat(prepared(p), 1, loop.samples))[1]
    options = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O3", "-march=native"]}}
    return ca.Function("simulation", [p, w], [torque], options if shutil.which("gcc") else {})


def _prepared(setting: Setting) -> Any:
    """Return what is computed once: the step's matrix, (4, 6) by columns, and both Coulomb forces."""
    import casadi as ca

    p = ca.SX.sym("p", len(NAMES))
    m1, v1, c1, k, d, m2, v2, c2 = ca.vertsplit(p)
    system = ca.SX(6, 6)
    system[0, 1] = system[2, 3] = 1
    for row, entries in {1: (-k, -v1 - d, k, d, 1, 0), 3: (k, d, -k, -v2 - d, 0, 1)}.items():
        for column, entry in enumerate(entries):
            system[row, column] = entry / (m1 if row == 1 else m2)
    term = matrix = ca.SX.eye(6)
    for order in range(1, _TERMS + 1):
        term = term @ system * (step_of(setting) / order)
        matrix = matrix + term
    return ca.Function("prepared", [p], [ca.vertcat(ca.vec(matrix[:4, :]), c1, c2)])


def _period(loop: Loop, setting: Setting) -> Any:
    """Return one held period: its states are those of the joint, then of the law."""
    import casadi as ca

    law = loop.law
    state, fed, given = ca.SX.sym("state", 7), ca.SX.sym("fed"), ca.SX.sym("given", 26)
    phi, c1, c2 = ca.reshape(given[:24], 4, 6), given[24], given[25]
    x, velocity, last, moved = state[:4], state[4], state[5], state[6]
    velocity = law.memory * velocity + (law.now * (x[0] - last) + law.before * moved) / PERIOD
    torque = _clip(fed - law.position_gain * x[0] - law.derivative_gain * velocity, law.limit)
    law_state = ca.vertcat(velocity, x[0], x[0] - last)
    for _ in range(setting.steps):
        free = phi[:, :4] @ x + phi[:, 4] * torque
        if setting.friction == "smooth":
            f1, f2 = c1 * ca.tanh(x[1] / setting.width), c2 * ca.tanh(x[3] / setting.width)
        else:
            f1, f2 = _clip(free[1] / phi[1, 4], c1), _clip(free[3] / phi[3, 5], c2)
        x = free - phi[:, 4] * f1 - phi[:, 5] * f2
    return ca.Function("period", [state, fed, given], [ca.vertcat(x, law_state), torque])


def _clip(value: Any, limit: Any) -> Any:
    import casadi as ca

    return ca.fmin(ca.fmax(value, -limit), limit)
