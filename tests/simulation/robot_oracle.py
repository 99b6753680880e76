"""Slow reference simulator of robots for tests: error-controlled (DOP853), events located, friction by enumeration.

It shares the links' dynamics with jointid and nothing else: the controllers are PD laws written out, the modes of
friction at rest are found by trying all of them, and the events by SciPy's own.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.integrate import solve_ivp

from jointid.common.arrays import FloatArray
from jointid.models.robots.dynamics import inverse_dynamics, mass_matrix
from jointid.simulation.robots import RobotNumbers

Tree = tuple[FloatArray, ...]


def simulate_pd(
    tree: Tree, numbers: RobotNumbers, gains: FloatArray, references: FloatArray, period: float, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return torques (periods, n) and positions (periods, masses) of a robot under PD laws, from rest.

    Args:
        tree: of the links. numbers: of links and joints. gains: (n, 2) of position and backward difference.
        references: (periods, n). period: s. start: (masses,) positions.
    """
    n, size = numbers.rotors.size, len(numbers.masses)
    coulomb, still = numbers.masses[:, 2], np.zeros(numbers.rotors.size)
    q, v, modes = start.copy(), np.zeros(size), np.zeros(size)
    error = references[0] - q[numbers.rotors] - (references[1] - references[0])  # they moved uniformly until then
    torques, positions = np.empty_like(references), np.empty((len(references), size))

    def forces(q: FloatArray, v: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        M, bias, links = np.zeros((size, size)), np.empty(n), np.empty((n, n))
        inverse_dynamics(*tree, numbers.inertials, q[:n], v[:n], still, bias)
        mass_matrix(*tree[:5], numbers.inertials, q[:n], links)
        M[:n, :n] = links
        M[np.diag_indices(size)] += numbers.masses[:, 0]
        force = -numbers.masses[:, 1] * v - numbers.masses[:, 3]
        force[:n] -= bias
        for i, r in enumerate(numbers.rotors):
            force[r] += torque[i]
            if r != i:
                spring = numbers.springs[i] @ [q[r] - q[i], v[r] - v[i]]
                force[i] += spring
                force[r] -= spring
        return M, force

    def accelerations(M: FloatArray, force: FloatArray, modes: FloatArray) -> tuple[FloatArray, FloatArray]:
        free = modes != 0
        a = np.zeros(size)
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (force - modes * coulomb)[free])
        return a, force - M @ a - modes * coulomb  # of the second only what rests is read

    def settled(q: FloatArray, v: FloatArray, torque: FloatArray, modes: FloatArray) -> FloatArray:
        standing = np.flatnonzero((v == 0) & (coulomb > 0))
        M, force = forces(q, v, torque)
        for choice in itertools.product((0.0, 1.0, -1.0), repeat=standing.size):
            tried = modes.copy()
            tried[standing] = choice
            a, held = accelerations(M, force, tried)
            rests = tried[standing] == 0
            if np.all(np.abs(held[standing][rests]) <= coulomb[standing][rests] * (1 + 1e-12) + 1e-12) and np.all(
                (a * tried)[standing][~rests] > 0
            ):
                return tried
        raise AssertionError("no mode of friction is consistent")

    for k, reference in enumerate(references):
        before, error = error, reference - q[numbers.rotors]
        torque = gains[:, 0] * error + gains[:, 1] * (error - before) / period
        torques[k], positions[k] = torque, q
        left = period
        modes[coulomb <= 0] = 1.0
        while left > 0:
            modes = settled(q, v, torque, modes)

            def slope(_: float, y: FloatArray, modes: FloatArray = modes, torque: FloatArray = torque) -> FloatArray:
                M, force = forces(y[:size], y[size:], torque)
                return np.concatenate([y[size:], accelerations(M, force, modes)[0]])

            guards = []
            for i in np.flatnonzero(coulomb > 0):
                if modes[i] != 0:

                    def guard(t: float, y: FloatArray, i: int = i, modes: FloatArray = modes) -> float:
                        # A mass that has just begun to slide is not at its event.
                        return float(modes[i] * y[size + i] + (1e-15 if t <= 1e-9 else 0.0))
                else:

                    def guard(
                        t: float, y: FloatArray, i: int = i, modes: FloatArray = modes, torque: FloatArray = torque
                    ) -> float:
                        M, force = forces(y[:size], y[size:], torque)
                        return float(coulomb[i] * (1 + 1e-11) - abs(accelerations(M, force, modes)[1][i]))

                guard.terminal, guard.direction = True, -1  # type: ignore[attr-defined]
                guards.append((i, guard))
            found = solve_ivp(
                slope, (0.0, left), np.concatenate([q, v]), "DOP853", rtol=1e-11, atol=1e-13,
                events=[guard for _, guard in guards] or None, max_step=left / 4,
            )  # fmt: skip
            q, v = found.y[:size, -1].copy(), found.y[size:, -1].copy()
            v[modes == 0] = 0.0
            left -= found.t[-1]
            if found.status != 1:
                break
            for (i, _), times in zip(guards, found.t_events, strict=True):
                if times.size:
                    if modes[i] != 0:
                        v[i] = 0.0
                    else:
                        _, force = forces(q, v, torque)
                        held = accelerations(forces(q, v, torque)[0], force, modes)[1][i]
                        modes[i] = np.sign(held)
    return torques, positions
