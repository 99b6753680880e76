"""Slow reference simulator of robots for tests: error-controlled (DOP853), events located, friction by enumeration.

It takes the links' dynamics from jointid's regressor and shares nothing else: the controllers are PD laws written out,
the modes of friction at rest are found by trying all of them, and the events by SciPy's own.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.integrate import solve_ivp

from jointid.common.arrays import FloatArray
from jointid.models.friction import low_speed_share
from jointid.models.robots.robot import Tree
from jointid.simulation.robot_numbers import RobotNumbers
from tests.models.robots.trees import mass_matrix_by_regressor, torque_by_regressor


def simulate_pd(
    tree: Tree,
    numbers: RobotNumbers,
    gains: FloatArray,
    references: FloatArray,
    period: float,
    start: FloatArray,
    speeds: FloatArray | None = None,
    every: tuple[int, ...] = (),
    delays: tuple[float, ...] = (),
) -> tuple[FloatArray, FloatArray]:
    """Return torques (steps, n) and positions (steps, masses) of a robot under PD laws, the torques as put out.

    Args:
        tree: of the links, with what takes shafts of coupled motors to joints, or (0, 0).
        numbers: of links and joints.
        gains: (n, 2) of position and backward difference.
        references: (steps, n). period: s, of a step.
        start: (masses,) positions. speeds: (masses,) velocities there, or at rest.
        every: steps of each controller's period, 1 where they are not given.
        delays: s, after which each controller's torque acts.
    """
    n, size = numbers.rotors.size, len(numbers.masses)
    every, delays = every or (1,) * n, delays or (0.0,) * n
    still = np.zeros(numbers.rotors.size)
    rise, below = numbers.masses[:, 6], np.where(numbers.masses[:, 7] > 0.0, numbers.masses[:, 7], 1.0)
    coulomb = numbers.masses[:, 2] + rise  # at rest
    joints = tree.joints if tree.joints.size else np.eye(n)
    q, v = start.copy(), np.zeros(size) if speeds is None else speeds.copy()
    modes = np.sign(v)
    later = np.array([references[every[j], j] for j in range(n)])
    # References and motors moved uniformly until then.
    travelled = later - references[0] - np.array(every) * period * v[numbers.rotors]
    error = references[0] - q[numbers.rotors] - travelled
    torques, positions = np.empty_like(references), np.empty((len(references), size))
    torque, waiting = np.zeros(n), list[tuple[float, int, float]]()

    def forces(q: FloatArray, v: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        M = np.zeros((size, size))
        bias = torque_by_regressor(tree, numbers.inertials, joints @ q[:n], joints @ v[:n], still)
        links = mass_matrix_by_regressor(tree, numbers.inertials, joints @ q[:n])
        M[:n, :n] = joints.T @ links @ joints
        M[np.diag_indices(size)] += numbers.masses[:, 0]
        viscous = numbers.masses[:, 1] + np.where(v < 0, numbers.masses[:, 5], numbers.masses[:, 4])
        force = -viscous * v - numbers.masses[:, 3]
        force[:n] -= joints.T @ bias
        for i, r in enumerate(numbers.rotors):
            force[r] += torque[i]
            if r != i:
                spring = numbers.springs[i, :2] @ [q[r] - q[i], v[r] - v[i]]
                force[i] += spring
                force[r] -= spring
        return M, force

    def accelerations(
        M: FloatArray, force: FloatArray, modes: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        free = modes != 0
        a, grip = np.zeros(size), coulomb - rise * (1.0 - low_speed_share(v / below))
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (force - modes * grip)[free])
        return a, force - M @ a - modes * grip  # of the second only what rests is read

    def settled(q: FloatArray, v: FloatArray, torque: FloatArray, modes: FloatArray) -> FloatArray:
        standing = np.flatnonzero((v == 0) & (coulomb > 0))
        M, force = forces(q, v, torque)
        for choice in itertools.product((0.0, 1.0, -1.0), repeat=standing.size):
            tried = modes.copy()
            tried[standing] = choice
            a, held = accelerations(M, force, tried, v)
            rests = tried[standing] == 0
            if np.all(np.abs(held[standing][rests]) <= coulomb[standing][rests] * (1 + 1e-12) + 1e-12) and np.all(
                (a * tried)[standing][~rests] > 0
            ):
                return tried
        raise AssertionError("no mode of friction is consistent")

    def advance(q: FloatArray, v: FloatArray, modes: FloatArray, left: float) -> tuple[FloatArray, ...]:
        modes[coulomb <= 0] = 1.0
        while left > 0:
            modes = settled(q, v, torque, modes)

            def slope(_: float, y: FloatArray, modes: FloatArray = modes, torque: FloatArray = torque) -> FloatArray:
                M, force = forces(y[:size], y[size:], torque)
                return np.concatenate([y[size:], accelerations(M, force, modes, y[size:])[0]])

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
                        return float(coulomb[i] * (1 + 1e-11) - abs(accelerations(M, force, modes, y[size:])[1][i]))

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
                        held = accelerations(forces(q, v, torque)[0], force, modes, v)[1][i]
                        modes[i] = np.sign(held)
        return q, v, modes

    for k, reference in enumerate(references):
        positions[k] = q
        for j in range(n):
            if k % every[j] == 0:
                before, error[j] = error[j], reference[j] - q[numbers.rotors[j]]
                output = gains[j, 0] * error[j] + gains[j, 1] * (error[j] - before) / (every[j] * period)
                waiting.append((k * period + delays[j], j, output))
                torques[k, j] = output
                torque[j] = output if k == 0 else torque[j]  # what acted before the first is as large
            else:
                torques[k, j] = torques[k - 1, j]
        now, end = k * period, (k + 1) * period
        while now < end - 1e-12:
            for at, j, output in waiting:
                torque[j] = output if at <= now + 1e-12 else torque[j]
            waiting = [one for one in waiting if one[0] > now + 1e-12]
            until = min([end, *(at for at, _, _ in waiting)])
            q, v, modes = advance(q, v, modes, until - now)
            now = until
    return torques, positions
