"""Common form of all controllers: a sampled linear law with limits inside.

Period k is in phase p = k mod `phases` of a cycle; a single-rate law has one phase. With the inputs named below, the
states z, and elements i = 1, 2, ... in order of evaluation::

    raw_i[k] = C_i z[k] + D_i inputs[k] + sum over j < i of E_ij excess_j[k]
    z[k+1]   = A z[k] + B inputs[k] + F excess[k]

A limit's excess is ``clip(raw, -limit, limit) - raw``. A gate stops an integrator while a limit acts: its excess is
``-raw`` if raw pushes its limit further, else 0. An element's value is raw plus excess; that of the element `output` is
the torque, which acts `delay` after the period's instant and is held for a period.

All nonlinearity is in the excesses, so responses to the inputs superpose. `run` maps inputs to torque, `invert` torque
to position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError

REFERENCE, REFERENCE_VELOCITY, DIRECTION, CONSTANT, INJECTED, POSITION = range(6)
"""Inputs of a law: the reference, its velocity as a channel, the sign of its motion, 1, the signal that is added before
the limit, and the motor position."""

INPUTS = POSITION + 1

LIMIT = -1
"""Placeholder of a limit, for a gate."""

_SINGULAR = 1e13  # a condition number


@dataclass(frozen=True, slots=True, eq=False)
class SampledLaw:
    """A controller in state-space form, in torque units (the module's equations).

    Attributes:
        A: (phases, states, states). B: (phases, states, INPUTS). C: (phases, elements, states).
        D: (phases, elements, INPUTS). E: (phases, elements, elements), below the diagonal.
        F: (phases, states, elements).
        limits: (elements,) of the elements that are limits; infinite for one that only has a value.
        gates: (elements,) the place of the limit that a gate watches; LIMIT for a limit.
        scales: (elements,) whether an element is in units of torque.
        output: which element's value acts: the torque's limit.
        period: seconds between evaluations.
        delay: seconds from the evaluation's instant to the instant the torque acts.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    E: FloatArray
    F: FloatArray
    limits: FloatArray
    gates: NDArray[np.int64]
    scales: NDArray[np.bool_]
    output: int
    period: float
    delay: float = 0.0

    @property
    def phases(self) -> int:
        """Periods in a cycle."""
        return len(self.A)

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[1])

    @property
    def limit(self) -> float:
        """Torque limit, possibly infinite."""
        return float(self.limits[self.output])

    def with_limit(self, level: float) -> SampledLaw:
        """Replace the torque limit."""
        limits = self.limits.copy()
        limits[self.output] = level
        return replace(self, limits=limits)

    def memory(self, column: int, value: float, slope: float) -> FloatArray:
        """States after uniform motion of an input to `value`, `slope` per second.

        Memories of inputs add up. An integrator's own content is 0; see `integral`.
        """
        at = np.arange(INPUTS) == column
        return self.memories(value * at, slope * at)

    def memories(self, values: FloatArray, slopes: FloatArray) -> FloatArray:
        """States after uniform motion of all inputs; values and slopes are (INPUTS,)."""
        memory = np.zeros(self.order)
        moving = ~self._integrators()
        valued, sloped = self.B @ values, self.B @ slopes
        if not np.any(moving) or not (np.any(valued) or np.any(sloped)):
            return memory
        whole = np.eye(self.order)
        still = np.zeros(self.order)  # what a cycle adds by the values
        rising, drift = still.copy(), still.copy()  # by the slopes as if they were values, and by what they add in it
        # An integrator is kept at 0 within the cycle, too.
        parts = zip(self.A * moving[:, np.newaxis], valued * moving, sloped * moving, strict=True)
        for j, (A, by_value, by_slope) in enumerate(parts):
            whole, still, rising = A @ whole, A @ still + by_value, A @ rising + by_slope
            drift = A @ drift + by_slope * (j * self.period)
        rest = (np.eye(self.order) - whole)[np.ix_(moving, moving)]
        at_slope = _solve(rest, rising[moving])
        change = drift[moving] - self.phases * self.period * at_slope
        memory[moving] = _solve(rest, still[moving] + change)
        return memory

    def known_memory(self, inputs: FloatArray) -> FloatArray:
        """States after uniform motion of all inputs but the position, (periods, INPUTS)."""
        first = inputs[0]
        slope = (inputs[1, REFERENCE] - first[REFERENCE]) / self.period if len(inputs) > 1 else 0.0
        values, slopes = np.zeros(INPUTS), np.zeros(INPUTS)
        known = [REFERENCE, REFERENCE_VELOCITY, DIRECTION, CONSTANT]
        values[known], slopes[REFERENCE] = first[known], slope
        return self.memories(values, slopes)

    def integral(self) -> FloatArray | None:
        """States at rest with unit output by an integrator; None without one."""
        integrators = np.flatnonzero(self._integrators())
        if not integrators.size:
            return None
        whole = _over_cycle(self.A)
        states = np.zeros(self.order)
        states[integrators[0]] = 1.0
        moving = ~self._integrators()
        rest = (np.eye(self.order) - whole)[np.ix_(moving, moving)]
        states[moving] = _solve(rest, whole[moving, integrators[0]])
        out = float(self.C[0, self.output] @ states)
        return states / out if out else None

    def _integrators(self) -> NDArray[np.bool_]:
        """States that accumulate over a cycle.

        A filter's state may have a unit eigenvalue, too, but its effect on other states returns.
        """
        whole = _over_cycle(self.A)
        found = np.diag(whole) == 1.0
        edges = whole != 0.0
        np.fill_diagonal(edges, False)
        for i in np.flatnonzero(found):
            found[i] = not edges[i] @ _find_reachable(edges, edges[:, i])
        return np.asarray(found)

    def feedback(self, hertz: FloatArray) -> NDArray[np.complex128]:
        """Frequency response to the position, torque per position.

        For several phases, the component at the frequency itself.
        """
        turn = np.exp(2j * np.pi * hertz * self.period)[:, np.newaxis]
        response = np.zeros(hertz.size, dtype=np.complex128)
        if self.order:
            forced = np.zeros((hertz.size, self.order), dtype=np.complex128)
            for j, (A, B) in enumerate(zip(self.A, self.B, strict=True)):
                forced = forced @ A.T + B[:, POSITION] * turn**j
            systems = turn[:, :, np.newaxis] ** self.phases * np.eye(self.order) - _over_cycle(self.A)
            states = np.linalg.solve(systems, forced[..., np.newaxis])[..., 0]
        for j in range(self.phases):
            out = self.D[j, self.output, POSITION] * turn[:, 0] ** j
            if self.order:
                out = out + states @ self.C[j, self.output]
                states = states @ self.A[j].T + self.B[j, :, POSITION] * turn**j
            response += out * turn[:, 0] ** -j / self.phases
        return response

    @property
    def stiffness(self) -> float:
        """Largest direct gain over a cycle, torque per position."""
        return float(np.max(np.abs(self.D[:, self.output, POSITION])))

    def split(self) -> tuple[SampledLaw, SampledLaw]:
        """Split into the motion-dependent part and the known part without limits.

        The first keeps the states moved by position, limits and gates. The second has the rest, with the first's
        elements and then one for the input of each of its states.
        """
        moved = self.fed_back()
        still = ~moved
        feedback = replace(
            self, A=self.A[:, moved][:, :, moved], B=self.B[:, moved], C=self.C[:, :, moved], F=self.F[:, moved]
        )
        B, D = self.B.copy(), self.D.copy()
        B[:, :, POSITION], D[:, :, POSITION] = 0.0, 0.0
        elements = self.limits.size + int(np.sum(moved))
        beforehand = replace(
            self,
            A=self.A[:, still][:, :, still],
            B=B[:, still],
            C=np.concatenate([self.C[:, :, still], self.A[:, moved][:, :, still]], axis=1),
            D=np.concatenate([D, B[:, moved]], axis=1),
            E=np.zeros((self.phases, elements, elements)),
            F=np.zeros((self.phases, int(np.sum(still)), elements)),
            limits=np.full(elements, np.inf),
            gates=np.full(elements, LIMIT),
            scales=np.ones(elements, dtype=np.bool_),
        )
        return feedback, beforehand

    @property
    def integrates(self) -> bool:
        """Whether a motion-dependent state keeps its value."""
        return bool(np.any(self._integrators() & self.fed_back()))

    def fed_back(self) -> NDArray[np.bool_]:
        """States moved by the position or a limit."""
        moved = np.any(self.B[:, :, POSITION] != 0.0, axis=0) | np.any(self.F != 0.0, axis=(0, 2))
        return _find_reachable(np.any(self.A != 0.0, axis=0), moved)


def _over_cycle(A: FloatArray) -> FloatArray:
    """State transition over a cycle, (states, states), from all phases."""
    whole = np.eye(A.shape[1])
    for step in A:
        whole = step @ whole
    return whole


def _find_reachable(edges: NDArray[np.bool_], sources: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """States reachable from given ones, including these; `edges` (to, from)."""
    reached = sources
    while not np.array_equal(sources := reached | (edges @ reached), reached):
        reached = sources
    return reached


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve, by least squares if a double integrator makes it singular."""
    if not right.size:
        return right
    # States differ in size by powers of the period: without equal rows and columns rounding would hide small ones.
    rows = np.max(np.abs(matrix), axis=1)
    rows[rows == 0.0] = 1.0
    columns = np.max(np.abs(matrix) / rows[:, np.newaxis], axis=0)
    columns[columns == 0.0] = 1.0
    even = matrix / rows[:, np.newaxis] / columns
    if np.linalg.cond(even, 1) < _SINGULAR:
        return np.asarray(np.linalg.solve(even, right / rows) / columns)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def scale(law: SampledLaw, factor: float) -> SampledLaw:
    """Scale output and torque limit.

    The loop of a joint with `factor` times the inertia then has the same bandwidth.
    """
    by = np.where(law.scales, factor, 1.0)
    return replace(
        law,
        C=law.C * by[:, np.newaxis],
        D=law.D * by[:, np.newaxis],
        E=law.E * by[:, np.newaxis] / by,
        F=law.F / by,
        limits=law.limits * by,
    )


def refer(law: SampledLaw, ratio: float) -> SampledLaw:
    """Refer a law through a transmission to the joint.

    The law sees ``ratio`` times the joint's positions, and the joint ``ratio`` times its torques; a negative ratio
    keeps the feedback's sign. Other limits, as of velocity, stay on the law's side.
    """
    if ratio == 1.0:
        return law
    seen = np.ones(INPUTS)
    seen[[REFERENCE, REFERENCE_VELOCITY, POSITION]] = ratio
    seen[DIRECTION], seen[INJECTED] = np.sign(ratio), 1.0 / ratio
    turned = scale(law, ratio)
    return replace(turned, B=turned.B * seen, D=turned.D * seen, limits=np.abs(turned.limits))


def law_inputs(reference: FloatArray, velocity: FloatArray | None) -> FloatArray:
    """Inputs of a law, (periods, INPUTS), without position and injection.

    Args:
        reference: (periods,).
        velocity: (periods,) of the reference, if a channel.
    """
    inputs = np.zeros((reference.size, INPUTS))
    inputs[:, REFERENCE], inputs[:, CONSTANT] = reference, 1.0
    inputs[1:, DIRECTION] = np.sign(np.diff(reference))
    inputs[0, DIRECTION] = inputs[1, DIRECTION]
    if velocity is not None:
        inputs[:, REFERENCE_VELOCITY] = velocity
    return inputs


def run(law: SampledLaw, inputs: FloatArray, state: FloatArray, excess: FloatArray | None = None) -> FloatArray:
    """Return the torque of a law within its limits, (periods,).

    Args:
        law: the law.
        inputs: (periods, INPUTS), once per period.
        state: (states,) at the first period (see `SampledLaw.memory`).
        excess: (periods, elements), filled with what limits and gates take away or add.
    """
    excess = np.zeros((len(inputs), law.limits.size)) if excess is None else excess
    raw = respond(law, inputs, state, excess, free=True)
    return np.asarray(raw[:, law.output] + excess[:, law.output])


def respond(
    law: SampledLaw, inputs: FloatArray, state: FloatArray, excess: FloatArray | None = None, *, free: bool = False
) -> FloatArray:
    """Linear response of all elements before limits and gates, (periods, elements).

    Args:
        law: the law.
        inputs: (periods, INPUTS); zero columns give the response to the others alone.
        state: (states,) at the first period.
        excess: (periods, elements) of limits and gates; none when None.
        free: whether limits and gates act, and `excess` is filled.
    """
    from scipy.sparse import csr_array

    from jointid.models.controllers.recurrence import respond as recur

    whole = np.concatenate(
        [np.concatenate([law.C, law.D, law.E], axis=2), np.concatenate([law.A, law.B, law.F], axis=2)], axis=1
    )
    sparse, raw = csr_array(whole.reshape(-1, whole.shape[2])), np.empty((len(inputs), law.limits.size))
    given = np.zeros(raw.shape) if excess is None else np.ascontiguousarray(excess)
    recur(
        sparse.indptr, sparse.indices, sparse.data, law.limits, law.gates, free, state.copy(),
        np.ascontiguousarray(inputs), given, raw,
    )  # fmt: skip
    return raw


def invert(law: SampledLaw, torque: FloatArray, inputs: FloatArray, state: FloatArray) -> FloatArray:
    """Motor position at which the law outputs `torque`, (periods,).

    ``position = reference - C^-1(torque)``, exact while no limit acts. Torque noise dT becomes position noise dT / |D|
    within the period, and dT over the static gain slowly, for most loops far below an encoder's step.

    Args:
        law: with a direct gain from position.
        torque: (periods,) before the law's delay, at its period.
        inputs: (periods, INPUTS) as for `run`; the position column is ignored.
        state: (states,) at the first period.
    """
    gain = law.D[:, law.output, POSITION]
    if np.any(gain == 0.0):
        raise MethodError("This law does not react to the position within its period, so it cannot be inverted.")
    back, out = law.B[:, :, POSITION] / gain[:, np.newaxis], law.C[:, law.output]
    direct = law.D[:, law.output]
    A = law.A - back[:, :, np.newaxis] * out[:, np.newaxis]
    if law.order and np.max(np.abs(np.linalg.eigvals(_over_cycle(A)))) >= 1.0 + 1e-9:
        raise MethodError("The inverse of this law is unstable, so it gives no start.")
    B = law.B - back[:, :, np.newaxis] * direct[:, np.newaxis]
    D = -direct / gain[:, np.newaxis]
    # The torque takes the place of the position among the inputs.
    B[:, :, POSITION], D[:, POSITION] = back, 1.0 / gain
    none = np.zeros((law.phases, 1, 1))
    turned = SampledLaw(
        A, B, -out[:, np.newaxis] / gain[:, np.newaxis, np.newaxis], D[:, np.newaxis], none,
        np.zeros((law.phases, law.order, 1)), np.array([np.inf]), np.array([LIMIT]), np.array([True]), 0, law.period,
    )  # fmt: skip
    columns = inputs.copy()
    columns[:, POSITION] = torque
    return respond(turned, columns, state)[:, 0]
