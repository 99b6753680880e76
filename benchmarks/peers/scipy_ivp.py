"""SciPy's `solve_ivp`: what one writes without a package for the purpose."""

from __future__ import annotations

from math import tanh

import numpy as np

from benchmarks.peers.shape import Peer, Setting
from benchmarks.problem import PERIOD, Array


class SolveIvp(Peer):
    """A call for every held period, with LSODA, which turns to a stiff method where the friction asks for one.

    A `sign` in place of the `tanh` makes the step collapse at the first standstill.
    """

    title = "SciPy solve_ivp"
    settings = tuple(
        Setting(f"LSODA, rtol 1e-6, friction smooth over {width:g} m/s", 0, width, "LSODA") for width in (1e-5, 1e-6)
    )
    slow = 2500

    def torque(self, parameters: Array) -> Array:
        """Integrate period after period, as the law asks for it."""
        from scipy.integrate import solve_ivp

        m1, v1, c1, k, d, m2, v2, c2 = map(float, parameters)
        width = self.setting.width

        def rates(_t: float, x: Array, torque: float) -> tuple[float, float, float, float]:
            q, v, p, u = x
            spring = k * (p - q) + d * (u - v)
            return (
                v, (torque + spring - v1 * v - c1 * tanh(v / width)) / m1,
                u, (-spring - v2 * u - c2 * tanh(u / width)) / m2,
            )  # fmt: skip

        start = float(self.loop.reference[0])
        x, controller, found = np.array([start, 0.0, start, 0.0]), self.loop.controller(), np.empty(self.loop.samples)
        for period in range(found.size):
            found[period] = controller(period, float(x[0]))
            x = solve_ivp(
                rates, (0.0, PERIOD), x, self.setting.method, args=(found[period],), rtol=1e-6, atol=1e-9
            ).y[:, -1]  # fmt: skip
        return found
