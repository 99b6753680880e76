"""One slow, independent reference of all simulations: DOP853, friction's modes by trying all, stops located.

It reads the numbers of a plant, and the controllers and torques of a `SampledLoop`, and shares no equation with the
kernels: of a tree it takes mass matrix and bias from the regressor alone. What winds up is a state in the form of its
rate, ``z' = (v - |v| z) / s``. The integrator's error control sees the bends of friction; a mass that stops, one that
comes loose, and the ends of a spring's pieces are events.
"""

import itertools
import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import Tree
from jointid.simulation import kernels
from jointid.simulation.kernels import Plant, SampledLoop
from jointid.simulation.loop_input import LoopInput
from jointid.simulation.start import Initial, Numbers, begin
from tests.models.robots.trees import mass_matrix_by_regressor, torque_by_regressor

_EDGE = 1e-12  # of what friction holds: a mass that is pushed that hard rests


class _Motion:
    """Masses between two changes of the torque: positions, velocities, what is wound up, and directions."""

    def __init__(
        self, plant: Plant, tree: Tree | None, inertials: FloatArray, state: list[FloatArray], period: float
    ) -> None:
        self.rows, self.springs = plant.masses.tolist(), plant.springs.tolist()
        self.pairs, self.carriers = plant.pairs.tolist(), plant.carriers.tolist()
        self.places, self.tree, self.inertials = plant.places.tolist(), tree, inertials
        self.size, self.time, self.period = len(self.rows), 0.0, period
        place, speed, wound = state
        self.y = np.concatenate([place, speed, wound, np.zeros(len(self.springs))])
        self.winds = [row[0][kernels.WINDING] > 0.0 for row in self.rows]
        self.y[2 * self.size : 3 * self.size] *= self.winds
        holds = kernels.COULOMB, kernels.COULOMB_BACK, kernels.COULOMB_DRIFT, kernels.PER_TORQUE
        slips = [not any(row[0][number] for number in holds) for row in self.rows]
        self.free = [winds or slips for winds, slips in zip(self.winds, slips, strict=True)]  # nothing ever sticks
        self.modes = [float(np.sign(v)) for v in speed]
        self.drive, self.events, self.fastest = [0.0] * self.size, 0, 1e-9
        self.pieces = [0] * len(self.springs)  # of each spring, negative for negative deflections
        for s, (one, two) in enumerate(self.pairs):
            e = place[two] - place[one]
            self.pieces[s] = int(math.copysign(sum(abs(e) > row[kernels.BEGIN] for row in self.springs[s][1:]), e))

    def springs_at(self, y: list[float]) -> list[float]:
        """Return the torques of the springs."""
        n, found = self.size, []
        for s, (one, two) in enumerate(self.pairs):
            e, de, piece = y[two] - y[one], y[n + two] - y[n + one], self.pieces[s]
            k, damping, cubic, slips, held = self.springs[s][abs(piece)][: kernels.BEGIN]
            found.append(float(np.sign(piece)) * held + k * e + cubic * e**3 + damping * de + slips * y[3 * n + s])
        return found

    def room(self, s: int, y: FloatArray) -> tuple[float, float]:
        """Return how far a deflection is above and below the ends of its piece."""
        (one, two), piece = self.pairs[s], self.pieces[s]
        begins = [*(row[kernels.BEGIN] for row in self.springs[s]), math.inf]
        low, high = begins[abs(piece)], begins[abs(piece) + 1]
        low, high = (low, high) if piece > 0 else (-high, -low if piece < 0 else high)
        return float(y[two] - y[one]) - low, high - float(y[two] - y[one])

    def friction(self, i: int, t: float, v: float, way: float, pull: list[float]) -> tuple[float, float]:
        """Return the viscous coefficient and the Coulomb force of a mass that moves one way."""
        row = next(row for row in self.rows[i] if abs(v) <= row[kernels.HIGH])
        carried = self.drive[i] if self.carriers[i] < 0 else pull[self.carriers[i]]
        back = int(way < 0.0)
        viscous = row[kernels.VISCOUS + back] + row[kernels.VISCOUS_DRIFT] * t
        grip = row[kernels.COULOMB + back] + row[kernels.COULOMB_DRIFT] * t
        return viscous, grip + row[kernels.PER_TORQUE] * abs(carried)

    def forces(self, t: float, y: list[float]) -> tuple[list[float], list[float]]:
        """Return the forces on the masses but for friction, and the springs' torques."""
        pull = self.springs_at(y)
        push = [torque - rows[0][kernels.OFFSET] for torque, rows in zip(self.drive, self.rows, strict=True)]
        for (one, two), torque in zip(self.pairs, pull, strict=True):
            push[one], push[two] = push[one] + torque, push[two] - torque
        for cos, sin, rate, wave, where in self.places:
            q = y[int(where)]
            push[int(where)] -= cos * math.cos(wave * q) + sin * math.sin(wave * q) + rate * q
        return push, pull

    def mass_matrix(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mass matrix, and the torques that the links' motion takes."""
        M, bias, n = np.diag([row[0][kernels.INERTIA] for row in self.rows]), np.zeros(self.size), len(self.inertials)
        if self.tree is not None:
            joints = self.tree.joints if self.tree.joints.size else np.eye(n)
            q, v = joints @ y[:n], joints @ y[self.size : self.size + n]
            M[:n, :n] += joints.T @ mass_matrix_by_regressor(self.tree, self.inertials, q) @ joints
            bias[:n] = joints.T @ torque_by_regressor(self.tree, self.inertials, q, v, np.zeros(n))
        return M, bias

    def accelerations(
        self, t: float, y: FloatArray, modes: list[float], matrix: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return accelerations, what is left for friction of masses at rest, and the most that it can hold."""
        state, n = y.tolist(), self.size
        push, pull = self.forces(t, state)
        grip, held = np.zeros(n), np.zeros(n)
        for i in range(n):
            v = state[n + i]
            way = v if self.free[i] else modes[i] or push[i]
            viscous, coulomb = self.friction(i, t, v, way, pull)
            held[i] = push[i] - viscous * v - coulomb * (state[2 * n + i] if self.winds[i] else modes[i])
            grip[i] = coulomb
        if self.tree is None:
            moving = zip(held, modes, self.rows, strict=True)
            return (
                np.array([push / rows[0][kernels.INERTIA] if mode else 0.0 for push, mode, rows in moving]),
                held,
                grip,
            )
        M, bias = matrix or self.mass_matrix(y)
        a, free = np.zeros(n), np.array(modes) != 0.0
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (held - bias)[free])
        return a, held - bias - M @ a, grip

    def settle(self) -> None:
        """Find the directions of masses that stand still by trying all."""
        n = self.size
        standing = [i for i in range(n) if self.y[n + i] == 0.0 and not self.free[i]]
        for i in range(n):
            self.modes[i] = 1.0 if self.free[i] else self.modes[i]
        matrix = None if self.tree is None else self.mass_matrix(self.y)
        choices = itertools.product((0.0, 1.0, -1.0), repeat=len(standing))
        for choice in sorted(choices, key=np.count_nonzero):  # few begin to move at once
            tried = list(self.modes)
            for i, mode in zip(standing, choice, strict=True):
                tried[i] = mode
            a, held, grip = self.accelerations(self.time, self.y, tried, matrix)
            rests = all(abs(held[i]) <= grip[i] * (1 + _EDGE) + 1e-300 for i in standing if tried[i] == 0.0)
            if rests and all(tried[i] * a[i] > 0.0 for i in standing if tried[i] != 0.0):
                self.modes = tried
                return
        raise AssertionError("no directions are consistent")

    def slopes(self, t: float, y: FloatArray) -> FloatArray:
        """Return the rates of the state."""
        n, (a, _, _) = self.size, self.accelerations(t, y, self.modes)
        v, rates = y[n : 2 * n], np.zeros(n + len(self.springs))
        for i in range(n):
            rates[i] = (v[i] - abs(v[i]) * y[2 * n + i]) * self.rows[i][0][kernels.WINDING]
        for s, (one, two) in enumerate(self.pairs):
            de = v[two] - v[one]
            rates[n + s] = (de - abs(de) * y[3 * n + s]) * self.springs[s][0][kernels.WINDING]
        return np.concatenate([v, a, rates])

    def guard(self, i: int) -> Any:
        """Return the event of a mass: it stops, or comes loose; of a spring, after the masses, that its piece ends."""
        n, mode = self.size, self.modes[i] if i < self.size else 0.0

        def slides(t: float, y: FloatArray) -> float:
            return float(mode * y[n + i])

        def rests(t: float, y: FloatArray) -> float:
            _, held, grip = self.accelerations(t, y, self.modes)
            return float(grip[i] * (1 + 10 * _EDGE) - abs(held[i]))

        def ends(t: float, y: FloatArray) -> float:
            return min(self.room(i - n, y)) + _EDGE * self.fastest * self.period

        event: Any = ends if i >= n else (slides if mode else rests)
        event.terminal, event.direction = True, -1.0
        return event

    def advance(self, duration: float, drive: list[float]) -> None:
        """Move on under torques."""
        self.drive, end, n = drive, self.time + duration, self.size
        while end - self.time > 1e-13 * self.period:
            self.settle()
            watched = [i for i in range(n) if not self.free[i]]
            watched += [n + s for s, rows in enumerate(self.springs) if len(rows) > 1]
            self.fastest = max(self.fastest, float(np.max(np.abs(self.y[n : 2 * n]))))
            atol = np.repeat(1e-13 * np.array([self.fastest * self.period, self.fastest, 1.0]), n)
            atol = np.append(atol, np.full(len(self.springs), 1e-13))
            run = solve_ivp(
                self.slopes, (self.time, end), self.y, "DOP853", rtol=1e-11, atol=atol,
                events=[self.guard(i) for i in watched] or None, max_step=duration / 6.0,
            )  # fmt: skip
            self.time, self.y = float(run.t[-1]), run.y[:, -1].copy()
            if run.status != 1:
                self.time = end
            for i, times in zip(watched, run.t_events if run.status == 1 else [], strict=False):
                if len(times):
                    self.events += 1
                    if i >= n:
                        below, above = self.room(i - n, self.y)
                        self.pieces[i - n] += 1 if above < below else -1
                    elif self.modes[i]:
                        self.y[n + i] = 0.0
                    else:
                        _, held, _ = self.accelerations(self.time, self.y, self.modes)
                        self.modes[i] = math.copysign(1.0, held[i])


def simulate(
    plant: Plant, tree: Tree | None, inertials: FloatArray, loop: SampledLoop, before: FloatArray, z: FloatArray,
    place: FloatArray, speed: FloatArray, wound: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, int]:  # fmt: skip
    """Return torques that act, (axes, clock), positions and velocities, (clock, masses), and the number of events."""
    law, (axes, clock) = loop, loop.post.shape
    motion = _Motion(plant, tree, inertials, [place, speed, wound], float(np.sum(loop.lengths)))
    command, z, n = np.zeros((axes, clock)), z.copy(), len(plant.masses)
    q, v = np.zeros((clock, n)), np.zeros((clock, n))
    for k in range(clock):
        q[k], v[k] = motion.y[:n], motion.y[n : 2 * n]
        for j in range(axes):
            own, held = divmod(k, int(loop.every[j]))
            if held:
                command[j, k] = command[j, k - 1]
                continue
            p, seen, cut = own % law.A.shape[1], q[k, int(plant.motors[j])], np.zeros(loop.w.shape[1])
            for i, limit in enumerate(law.limits[j]):
                raw = loop.w[j, i, own] + law.D[j, p, i] * seen + law.C[j, p, i] @ z[j] + law.E[j, p, i] @ cut
                gate = int(law.gates[j, i])
                cut[i] = min(max(raw, -limit), limit) - raw
                if gate >= 0:
                    cut[i] = -raw if raw * cut[gate] < 0.0 else 0.0
                if i == law.output[j]:
                    command[j, k] = raw + cut[i]
            driven = law.driven[j, own] if law.driven.shape[1] else 0.0
            z[j] = law.A[j, p] @ z[j] + law.Bq[j, p] * seen + law.F[j, p] @ cut + driven
        for part, length in enumerate(loop.lengths):
            drive = [0.0] * n
            for j in range(axes):
                source = k - int(loop.lags[j, part])
                torque = command[j, source] + loop.post[j, source] if source >= 0 else before[j]
                drive[int(plant.motors[j])] = float(torque)
            motion.advance(float(length), drive)
    return command, q, v, motion.events


def of_loop(
    experiment: LoopInput, numbers: Numbers, initial: Initial | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Return what `simulate` does with a joint or a robot that begins where the package lets it."""
    began = begin(experiment, numbers, initial)
    return simulate(
        numbers.plant, experiment.tree, numbers.inertials, experiment.sampled, began.before, began.states,
        began.places, began.speeds, began.wound,
    )  # fmt: skip
