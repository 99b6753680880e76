"""Controllers: sampled laws, each lowered to one state-space form that can be run, inverted and scaled.

A law is evaluated once per period and its output is held until the next (zero-order hold), after an optional
computing delay that may be a fraction of a period::

    u[k]   = C z[k] + D (reference, reference velocity, position)[k]
    out[k] = clip(u[k], -limit, limit)
    z[k+1] = A z[k] + B (reference, reference velocity, position, out - u)[k]

The last input, what the limit cut off, is how anti-windup enters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.errors import MethodError
from jointid.data.record import FloatArray

REFERENCE, REFERENCE_VELOCITY, POSITION, EXCESS = range(4)
"""Columns of a law's inputs; D has the first three."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledLaw:
    """A controller in state-space form, in torque units (the module's equations).

    Attributes:
        A: (nz, nz). B: (nz, 4), columns as named above. C: (nz,). D: (3,).
        limit: of the output, in torque units; infinite when there is none.
        period: seconds between evaluations.
        delay: seconds from the evaluation's instant to the instant the torque acts.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    limit: float
    period: float
    delay: float = 0.0

    def memory(self, column: int, value: float, slope: float) -> FloatArray:
        """Return the state an input leaves that has moved uniformly until now, at `value` with `slope` per second.

        Memories of several inputs add up. An integrator's own part is taken as 0: at rest its input is 0.
        """
        if self.C.size == 0:
            return np.zeros(0)
        into = self.B[:, column]
        inverse = np.linalg.pinv(np.eye(self.C.size) - self.A)
        drift = inverse @ (into * slope * self.period)
        return np.asarray(inverse @ (into * value - drift))

    def feedback(self, hertz: FloatArray) -> FloatArray:
        """Return the magnitude of the law's response to the position at these frequencies, torque per position."""
        z = np.exp(2j * np.pi * hertz * self.period)
        order = self.C.size
        response = np.full(z.size, self.D[POSITION], dtype=np.complex128)
        if order:
            systems = z[:, np.newaxis, np.newaxis] * np.eye(order) - self.A
            states = np.linalg.solve(systems, np.broadcast_to(self.B[:, POSITION, np.newaxis], (z.size, order, 1)))
            response += states[..., 0] @ self.C
        return np.abs(response)


class Controller(Protocol):
    """What a closed loop asks of a controller; every law below is one."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the record's channels the law reads, beside the motor position."""

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form; `sample_time` is the log's, used when the law has no period of its own."""


@dataclass(frozen=True, slots=True)
class _Timing:
    """What every law has beside its gains."""

    gain: float = 1.0
    limit: float = math.inf
    period: float | None = None
    delay: float = 0.0

    def _check(self, **gains: float) -> None:
        faults = [f"{name} = {value}" for name, value in gains.items() if not math.isfinite(value)]
        faults += [f"{name} = {value}" for name, value in gains.items() if value < 0]
        faults += [f"gain = {self.gain}"] * (not (math.isfinite(self.gain) and self.gain > 0))
        faults += [f"limit = {self.limit}"] * (not self.limit > 0)
        faults += [f"delay = {self.delay}"] * (not (math.isfinite(self.delay) and self.delay >= 0))
        faults += [f"period = {self.period}"] * (self.period is not None and not 0 < self.period < math.inf)
        if faults:
            raise MethodError(
                f"A controller's gains are zero or positive numbers, its gain, limit and period positive, its "
                f"delay zero or positive; received {', '.join(faults)}."
            )

    def _lowered(self, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, sample_time: float) -> SampledLaw:
        return SampledLaw(
            np.array(A, dtype=np.float64),
            np.array(B, dtype=np.float64),
            np.array(C, dtype=np.float64) * self.gain,
            np.array(D, dtype=np.float64) * self.gain,
            self.limit * self.gain,
            self.period or sample_time,
            self.delay,
        )


@dataclass(frozen=True, slots=True)
class DigitalFilter:
    """``H(z) = (b0 + b1 z^-1 + ...) / (a0 + a1 z^-1 + ...)``; the default passes everything."""

    numerator: tuple[float, ...] = (1.0,)
    denominator: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "numerator", tuple(float(b) for b in self.numerator))
        object.__setattr__(self, "denominator", tuple(float(a) for a in self.denominator))
        finite = all(map(math.isfinite, (*self.numerator, *self.denominator)))
        if not self.numerator or not self.denominator or self.denominator[0] == 0.0 or not finite:
            raise MethodError(
                f"A digital filter needs a numerator, and a denominator that does not start with 0, of finite numbers; "
                f"received {self.numerator} / {self.denominator}."
            )


def _derivative(velocity_filter: DigitalFilter, period: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return A, B, C, D of the filtered backward difference ``H(z) (1 - z^-1) / T`` in observer form."""
    numerator = np.convolve(velocity_filter.numerator, [1.0, -1.0]) / period
    denominator = np.array(velocity_filter.denominator)
    order = max(numerator.size, denominator.size) - 1
    b = np.pad(numerator, (0, order + 1 - numerator.size)) / denominator[0]
    a = np.pad(denominator, (0, order + 1 - denominator.size)) / denominator[0]
    A = np.eye(order, k=1)
    A[:, 0] = -a[1:]
    C = np.zeros(order)
    C[0] = 1.0
    return A, b[1:] - a[1:] * b[0], C, float(b[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Cascade(_Timing):
    """P position loop around a P velocity loop: ``u = kv (kp (reference - position) - velocity)``.

    The velocity is the backward difference of the position through `velocity_filter`; ``(0.5, 0.5)`` is the mean of
    two samples, the law of the EMPS benchmark.

    Attributes:
        kp: position gain in 1/s.
        kv: velocity gain in controller units per m/s (rad/s).
        velocity_filter: numerator of the velocity's filter, or a `DigitalFilter`.
        gain: torque per controller unit.
        limit: of the output, in controller units.
        period: of the controller in seconds; the log's sample time when None.
        delay: seconds from the sampled position to the torque that follows from it.
    """

    kp: float
    kv: float
    velocity_filter: DigitalFilter | Sequence[float] = (1.0,)

    def __post_init__(self) -> None:
        self._check(kp=self.kp, kv=self.kv)

    @property
    def channels(self) -> tuple[str, ...]:
        """Only the reference."""
        return ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        A, b, C, d = _derivative(_as_filter(self.velocity_filter), self.period or sample_time)
        B = np.zeros((C.size, 4))
        B[:, POSITION] = b
        D = [self.kv * self.kp, 0.0, -self.kv * (self.kp + d)]
        return self._lowered(A, B, -self.kv * C, D, sample_time)


@dataclass(frozen=True, slots=True, kw_only=True)
class PD(_Timing):
    """``u = kp (reference - position) + kd (reference velocity - velocity)``.

    The velocity is the backward difference of the position through `velocity_filter`. The reference's velocity is
    the same difference of the reference, or the record's own channel, or none (damping on the position only).

    Attributes:
        kp: controller units per m (rad).
        kd: controller units per m/s (rad/s).
        reference_velocity: "difference", "channel" or "none".
        velocity_filter, gain, limit, period, delay: as for `Cascade`.
    """

    kp: float
    kd: float
    reference_velocity: Literal["difference", "channel", "none"] = "difference"
    velocity_filter: DigitalFilter | Sequence[float] = (1.0,)

    def __post_init__(self) -> None:
        self._check(kp=self.kp, kd=self.kd)
        if self.reference_velocity not in ("difference", "channel", "none"):
            raise MethodError(
                f'A PD\'s reference_velocity is "difference", "channel" or "none"; got "{self.reference_velocity}".'
            )

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity when that is a channel."""
        return ("reference", "reference_velocity") if self.reference_velocity == "channel" else ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        A, b, C, d = _derivative(_as_filter(self.velocity_filter), self.period or sample_time)
        B = np.zeros((C.size, 4))
        B[:, POSITION] = b
        D = [self.kp, 0.0, -(self.kp + self.kd * d)]
        if self.reference_velocity == "difference":
            B[:, REFERENCE] = -b
            D[REFERENCE] += self.kd * d
        elif self.reference_velocity == "channel":
            D[REFERENCE_VELOCITY] = self.kd
        return self._lowered(A, B, -self.kd * C, D, sample_time)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpaceController(_Timing):
    """Any discrete linear law with a limit (the module's equations, in controller units).

    Attributes:
        A: (nz, nz). C: (nz,).
        B: name of an input to its column (nz,); inputs are "reference", "reference_velocity", "position", "excess".
        D: name of an input to its direct gain; "position" feeds back negatively, so its gain is usually < 0.
        gain, limit, period, delay: as for `Cascade`.
    """

    A: ArrayLike
    B: dict[str, ArrayLike]
    C: ArrayLike
    D: dict[str, float]

    def __post_init__(self) -> None:
        self._check()
        order = np.size(self.C)
        shapes = {"A": np.shape(self.A), **{f"B.{name}": np.shape(column) for name, column in self.B.items()}}
        wrong = [
            f"{name} {shape}"
            for name, shape in shapes.items()
            if shape != ((order, order) if name == "A" else (order,)) and not (order == 0 and np.prod(shape) == 0)
        ]
        unknown = (set(self.B) - set(_INPUTS)) | (set(self.D) - set(_INPUTS[:3]))
        if wrong or unknown:
            raise MethodError(
                f"A state-space law with {order} states (the length of C) needs A ({order}, {order}) and each column "
                f"of B ({order},), for the inputs {', '.join(_INPUTS)}; received {', '.join([*wrong, *unknown])}."
            )

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity when the law uses it."""
        uses = "reference_velocity" in self.B or "reference_velocity" in self.D
        return ("reference", "reference_velocity") if uses else ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        order = np.size(self.C)
        B = np.zeros((order, 4))
        for name, column in self.B.items():
            B[:, _INPUTS.index(name)] = np.asarray(column, dtype=np.float64)
        B[:, EXCESS] /= self.gain  # what the limit cut off is fed back in controller units
        D = [self.D.get(name, 0.0) for name in _INPUTS[:3]]
        return self._lowered(np.reshape(self.A, (order, order)), B, np.reshape(self.C, order), D, sample_time)


_INPUTS = ("reference", "reference_velocity", "position", "excess")


def _as_filter(value: DigitalFilter | Sequence[float]) -> DigitalFilter:
    return value if isinstance(value, DigitalFilter) else DigitalFilter(tuple(value))


def run(law: SampledLaw, inputs: FloatArray, state: FloatArray) -> FloatArray:
    """Return the law's output before its limit.

    Args:
        law: the law.
        inputs: (samples, 3): reference, reference velocity, position, once per period; leave a column 0 to get the
            response to the others alone.
        state: (nz,) the law's state at the first sample (see `SampledLaw.memory`).
    """
    from jointid.data.recurrences import respond

    out = np.empty(len(inputs))
    respond(
        law.A,
        np.ascontiguousarray(law.B[:, :3]),
        law.C,
        law.D,
        state.copy(),
        np.ascontiguousarray(inputs),
        out,
    )
    return out


def invert(law: SampledLaw, torque: FloatArray, inputs: FloatArray, state: FloatArray) -> FloatArray:
    """Return the motor position that makes the law put out `torque`, shape (samples,).

    ``position = reference - C^-1(torque)``: exact where the torque was not at the limit. It turns noise dT of the
    torque into dT / |D| of position within the sample, and dT over the law's static gain slowly: for most loops far
    below an encoder's step.

    Args:
        law: the law; its direct gain from position must not be 0.
        torque: (samples,) output of the law before its delay, at its period.
        inputs: (samples, 3) as for `run`; the position column is not read.
        state: (nz,) the law's state at the first sample.

    Raises:
        MethodError: the law has no direct gain from position, or its inverse is unstable.
    """
    from jointid.data.recurrences import respond

    gain = law.D[POSITION]
    if gain == 0.0:
        raise MethodError(
            "This law does not react to the position within its period, so it cannot be inverted; "
            'choose start = "regular".'
        )
    back = law.B[:, POSITION]
    A = law.A - np.outer(back, law.C) / gain
    if law.C.size and np.max(np.abs(np.linalg.eigvals(A))) >= 1.0 + 1e-9:
        raise MethodError('The inverse of this law is unstable, so it gives no start; choose start = "regular".')
    forward = law.B[:, :POSITION]
    B = np.column_stack([forward - np.outer(back, law.D[:POSITION]) / gain, back / gain])
    D = np.append(-law.D[:POSITION] / gain, 1.0 / gain)
    out = np.empty(len(torque))
    columns = np.column_stack([inputs[:, :POSITION], torque])
    respond(A, np.ascontiguousarray(B), -law.C / gain, D, state.copy(), np.ascontiguousarray(columns), out)
    return out


def scaled(law: SampledLaw, factor: float) -> SampledLaw:
    """Return the law with its output, and its limit, `factor` times as large.

    A simulated joint whose inertia is `factor` times the real one then keeps the real loop's bandwidth.
    """
    B = law.B.copy()
    B[:, EXCESS] /= factor
    return replace(law, B=B, C=law.C * factor, D=law.D * factor, limit=law.limit * factor)
