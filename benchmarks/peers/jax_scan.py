"""JAX: a compiled `lax.scan` over the periods, with `jacfwd` and `vmap`, in double precision on the processor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.peers.shape import Peer, Setting, step_of
from benchmarks.problem import PERIOD, Array, Loop


class JaxScan(Peer):
    """The sliding joint is stepped by its matrix exponential; only friction is approximate."""

    key = "jax"
    title = "JAX scan"
    imports = ("jax",)
    requires = ("jax",)
    settings = (
        Setting("1 step, friction held", 1, "held", error=0.02),
        Setting("2 steps, friction held", 2, "held", error=0.01),
        Setting("4 steps, friction held", 4, "held", error=0.006),
        Setting("8 steps, friction held", 8, "held", error=0.004),
        Setting("4 steps, friction smooth over 2e-5 m/s", 4, "smooth", 2e-5, error=0.05),
        Setting("16 steps, friction smooth over 5e-6 m/s", 16, "smooth", 5e-6, error=0.03),
    )
    model = "`lax.scan`, jitted, float64; steps by the matrix exponential, Coulomb friction held over a step"
    derivatives = "`jacfwd` of the same scan"
    many = "`vmap`, jitted; XLA's own threads"

    def __init__(self, loop: Loop, setting: Setting) -> None:
        import jax

        super().__init__(loop, setting)
        jax.config.update("jax_enable_x64", True)
        simulate = _simulation(loop, setting)
        self.w = jax.numpy.asarray(loop.feedforward)
        self._one, self._slopes = jax.jit(simulate), jax.jit(jax.jacfwd(simulate))
        self._many = jax.jit(jax.vmap(simulate, (0, None)))

    def torque(self, parameters: Array) -> Array:
        """Run the compiled scan."""
        return np.asarray(self._one(parameters, self.w))

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Return the derivatives by forward differentiation; the torque by a run of its own would add little."""
        return self.torque(parameters), np.asarray(self._slopes(parameters, self.w))

    def batch(self, candidates: Array) -> Sequence[Array]:
        """Run all candidates in one scan."""
        return list(np.asarray(self._many(candidates, self.w)))


def _simulation(loop: Loop, setting: Setting) -> Any:
    import jax
    import jax.numpy as jnp
    from jax.scipy.linalg import expm

    law, start, h = loop.law, float(loop.reference[0]), step_of(setting)

    def exact(p: Any) -> Any:
        """Return the step as numbers: a row for each state, of the four states and both forces."""
        m1, v1, _, k, d, m2, v2, _ = p
        system = jnp.zeros((6, 6)).at[0, 1].set(1.0).at[2, 3].set(1.0)
        system = system.at[1].set(jnp.array([-k / m1, -(v1 + d) / m1, k / m1, d / m1, 1 / m1, 0.0]))
        system = system.at[3].set(jnp.array([k / m2, d / m2, -k / m2, -(v2 + d) / m2, 0.0, 1 / m2]))
        matrix = expm(h * system)
        return [[matrix[i, j] for j in range(6)] for i in range(4)]

    def simulate(p: Any, w: Any) -> Any:
        phi, coulomb = exact(p), (p[2], p[7])

        def period(carry: Any, fed: Any) -> Any:
            x, velocity, last, moved = carry
            velocity = law.memory * velocity + (law.now * (x[0] - last) + law.before * moved) / PERIOD
            torque = jnp.clip(fed - law.position_gain * x[0] - law.derivative_gain * velocity, -law.limit, law.limit)
            moved, last = x[0] - last, x[0]
            for _ in range(setting.steps):
                x = _step(phi, coulomb, x, torque, setting, jnp)
            return (x, velocity, last, moved), torque

        zero = 0.0 * p[0]
        begun = (tuple(zero + value for value in (start, 0.0, start, 0.0)), zero, zero + start, zero)
        return jax.lax.scan(period, begun, w)[1]

    return simulate


def _step(phi: Any, coulomb: Any, x: Any, torque: Any, setting: Setting, jnp: Any) -> Any:
    """Return the state a step later; `x` is a tuple, because a scan of numbers is faster than one of small arrays."""
    free = [sum(phi[i][j] * x[j] for j in range(4)) + phi[i][4] * torque for i in range(4)]
    if setting.friction == "smooth":
        forces = [c * jnp.tanh(x[i] / setting.width) for c, i in zip(coulomb, (1, 3), strict=True)]
    else:  # what stops the mass at the end of the step, or as much of it as Coulomb's force can
        forces = [jnp.clip(free[i] / phi[i][4 + i // 2], -c, c) for c, i in zip(coulomb, (1, 3), strict=True)]
    return tuple(free[i] - phi[i][4] * forces[0] - phi[i][5] * forces[1] for i in range(4))
