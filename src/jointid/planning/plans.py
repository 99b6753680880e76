"""Parametrised tests that a drive can play: a motion with a signal added to the torque.

Drives generate trapezoids (with a jerk limit) and sums of sines; test benches play tables. A family
combines one motion with one added signal; the axis limits or the present test bound its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.simulation import excitation

_SPEEDS = 3  # of the trapezoids of one cycle
_REST = 0.4  # s before each way at most
_INSIDE = 0.985  # of the stroke, that a reference takes at most: the motor passes where it was asked to stop
_LINES = 24  # of a sum of sines


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """A signal of a test, which can be made smaller.

    Attributes:
        make: returns its values from a count of samples and their time.
        words: describe it in a unit, and by the factor that its sizes are smaller.
        center: value about which it is made smaller.
        factor: by which it is smaller than made.
        fixed: whether it keeps its size.
    """

    make: Callable[[int, float], FloatArray]
    words: Callable[[str, float], str]
    center: float = 0.0
    factor: float = 1.0
    fixed: bool = False

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Return its values, (samples,)."""
        return np.asarray(self.center + self.factor * (self.make(samples, sample_time) - self.center))

    def describe(self, unit: str) -> str:
        """Return it in words."""
        return self.words(unit, self.factor)

    def scale(self, factor: float) -> Signal:
        """Return the signal, smaller by a factor."""
        return self if self.fixed else replace(self, factor=factor * self.factor)


def trapezoids(
    speeds: Sequence[float], acceleration: float, travel: float, rest: float = 0.0, smoothing: float = 0.0,
    start: float = 0.0,
) -> Signal:  # fmt: skip
    """Move back and forth from `start` at each speed; `smoothing` is the jerk time, s."""

    def make(samples: int, sample_time: float) -> FloatArray:
        lasts = samples * sample_time
        played = excitation.trapezoids(speeds, acceleration, travel, sample_time, rest=rest, duration=lasts)[:samples]
        # A way that would exceed the time is left out: the axis rests at the last reversal.
        ends = np.flatnonzero(np.minimum(played, travel - played) <= acceleration * sample_time**2)
        ends = ends[ends < samples - round(smoothing / sample_time)]
        last = int(ends[-1]) if ends.size else 0
        kept = np.append(played[: last + 1], np.full(samples - 1 - last, played[last]))
        return start + excitation.smooth(kept, sample_time, smoothing)

    def words(unit: str, factor: float) -> str:
        each = ", ".join(number(factor * one, 3) for one in speeds)
        ramps = f", the acceleration rising in {number(1e3 * smoothing, 3)} ms" if smoothing else ""
        return (
            f"trapezoids from {number(start, 3)} {unit} over {number(factor * travel, 3)} {unit} and back, at "
            f"{each} {unit}/s, {number(factor * acceleration, 3)} {unit}/s2{ramps}, {number(rest, 2)} s of rest "
            "before each way"
        )

    return Signal(make, words, start)


def sines(amplitude: float, lowest: float, highest: float, start: float = 0.0) -> Signal:
    """Sum position sines with equal accelerations, between two frequencies, Hz."""

    def make(samples: int, sample_time: float) -> FloatArray:
        wave = excitation.multisine(samples, sample_time, amplitude, lowest, highest, lines=_LINES, tilt=2.0)
        return start + wave

    def words(unit: str, factor: float) -> str:
        return (
            f"a sum of {_LINES} sines of the position, {number(lowest, 2)} to {number(highest, 2)} Hz, "
            f"within {number(factor * amplitude, 3)} {unit} of {number(start, 3)} {unit}"
        )

    return Signal(make, words, start)


def positions(values: FloatArray) -> Signal:
    """Return positions of a table; a short one is repeated, reversed in time, and none is made smaller."""

    def make(samples: int, sample_time: float) -> FloatArray:
        del sample_time
        whole = values
        while whole.size < samples:
            whole = np.concatenate([whole, whole[::-1]])
        return np.asarray(whole[:samples])

    def words(unit: str, factor: float) -> str:
        del factor
        return f"the reference as given, {number(float(np.ptp(values)), 3)} {unit} of travel"

    return Signal(make, words, fixed=True)


def torque_sines(amplitude: float, lowest: float, highest: float) -> Signal:
    """Sum equal torque sines between two frequencies, Hz, with a peak of `amplitude`."""

    def words(unit: str, factor: float) -> str:
        return (
            f"a sum of {_LINES} sines of up to {number(factor * amplitude, 3)} {unit} on the torque, "
            f"{number(lowest, 2)} to {number(highest, 2)} Hz"
        )

    return Signal(lambda n, T: excitation.multisine(n, T, amplitude, lowest, highest, lines=_LINES), words)


def torque_lines(frequencies: Sequence[float], amplitudes: Sequence[float]) -> Signal:
    """Sum torque sines of given frequencies, Hz, and amplitudes, with low peaks."""

    def words(unit: str, factor: float) -> str:
        pairs = zip(frequencies, amplitudes, strict=True)
        each = ", ".join(f"{number(factor * size, 2)} {unit} at {number(f, 3)} Hz" for f, size in pairs)
        return f"sines on the torque: {each}"

    return Signal(lambda n, T: excitation.sines(n, T, frequencies, amplitudes), words)


def torques(values: FloatArray) -> Signal:
    """Return an added signal of a table, one value each sample; a short one is repeated."""

    def words(unit: str, factor: float) -> str:
        size = number(factor * float(np.max(np.abs(values))), 3)
        return f"the signal as given on the torque, of up to {size} {unit}"

    return Signal(lambda n, _: np.asarray(np.resize(values, n)), words)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A test: a motion, and optionally a signal added to the torque."""

    motion: Signal
    added: Signal | None = None

    def play(self, samples: int, sample_time: float) -> tuple[FloatArray, FloatArray | None]:
        """Return reference and injected signal, (samples,) each."""
        injected = None if self.added is None else self.added.play(samples, sample_time)
        return self.motion.play(samples, sample_time), injected

    def describe(self, position_unit: str, torque_unit: str) -> str:
        """Return it in words."""
        said = self.motion.describe(position_unit)
        return said if self.added is None else f"{said}; {self.added.describe(torque_unit)}"

    def scale(self, factor: float) -> Plan:
        """Scale the added signal and the motion; a table of positions stays."""
        if self.motion.fixed and self.added is None:
            return self
        return Plan(self.motion.scale(factor), None if self.added is None else self.added.scale(factor))


@dataclass(frozen=True, slots=True)
class Room:
    """Ranges of a search: largest values, and frequencies in Hz.

    Attributes:
        stroke, speed, acceleration, torque: in the joint's units.
        low: end of the stroke from which it is reckoned.
        jerk: None where the drive limits none.
        lowest, highest: frequencies of a sum of sines.
        mode: about where the joint's resonance is; a rigid one's half of the highest.
        lines: frequencies, Hz, of sines that would tell most of a joint without friction, and their amplitudes, the
            largest 1; none where that is not known.
    """

    stroke: float
    speed: float
    acceleration: float
    torque: float
    jerk: float | None
    low: float
    lowest: float
    highest: float
    mode: float
    lines: tuple[tuple[float, float], ...] = ()


def _log(low: float, high: float, share: float) -> float:
    return low * math.pow(high / low, share)


_Numbers: TypeAlias = Sequence[float]


def _trapezoids(u: _Numbers, room: Room) -> Signal:
    speeds = tuple(_log(0.05, 1.0, one) * room.speed for one in u[:_SPEEDS])
    acceleration = _log(0.05, 1.0, u[_SPEEDS]) * room.acceleration
    smoothing = 0.0 if room.jerk is None else 2 * acceleration / room.jerk  # from full ahead to full back
    travel = _log(0.05, _INSIDE, u[_SPEEDS + 1]) * room.stroke
    start = room.low + 0.5 * (room.stroke - travel)
    return trapezoids(speeds, acceleration, travel, _REST * u[_SPEEDS + 2], smoothing, start)


def _sines(u: _Numbers, room: Room) -> Signal:
    lowest = _log(room.lowest, max(0.3 * room.highest, room.lowest), u[1])
    highest = min(max(_log(room.lowest, room.highest, u[2]), 1.05 * lowest), room.highest)
    return sines(0.5 * _log(0.02, _INSIDE, u[0]) * room.stroke, lowest, highest, room.low + 0.5 * room.stroke)


def _torque_sines(u: _Numbers, room: Room) -> Signal:
    least = max(room.lowest, 0.05 * room.mode)
    lowest = _log(least, max(0.9 * room.highest, least), u[1])
    return torque_sines(_log(0.02, 1.0, u[0]) * room.torque, lowest, min(lowest * _log(1.02, 10.0, u[2]), room.highest))


def _torque_lines(u: _Numbers, room: Room) -> Signal:
    size, tilt = _log(0.02, 0.7, u[0]) * room.torque, 2.0 * u[1]
    frequencies, shares = zip(*room.lines, strict=True)
    # Friction wants more at low frequencies than a joint without it, or less: the shares may be levelled.
    return torque_lines(frequencies, [size * share**tilt for share in shares])


_MOTIONS: Mapping[str, tuple[int, Callable[[_Numbers, Room], Signal]]] = {
    "trapezoids": (_SPEEDS + 3, _trapezoids), "sines": (3, _sines),
}  # fmt: skip
_ADDED: Mapping[str, tuple[int, Callable[[_Numbers, Room], Signal] | None]] = {
    "nothing": (0, None), "sines": (3, _torque_sines), "lines": (2, _torque_lines),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Family:
    """One kind of motion, "trapezoids" or "sines", with one added signal, "nothing", "sines" or "lines"."""

    motion: str
    added: str

    @property
    def size(self) -> int:
        """How many numbers say one of its tests."""
        return _MOTIONS[self.motion][0] + _ADDED[self.added][0]

    def plan(self, u: Sequence[float], room: Room) -> Plan:
        """Return the test for numbers between 0 and 1, (size,)."""
        count, motion = _MOTIONS[self.motion]
        make = _ADDED[self.added][1]
        return Plan(motion(u[:count], room), None if make is None else make(u[count:], room))


def families_in(room: Room, *, injection: bool = True) -> tuple[Family, ...]:
    """Return the families that a search tries; without `injection` those that add nothing to the torque."""
    possible = [one for one in _ADDED if injection or one == "nothing"]
    return tuple(Family(motion, one) for motion in _MOTIONS for one in possible if one != "lines" or room.lines)
