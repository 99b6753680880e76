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


@dataclass(frozen=True, slots=True)
class Trapezoids:
    """Back and forth from `start` at each speed; `smoothing` is the jerk time, s."""

    speeds: tuple[float, ...]
    acceleration: float
    travel: float
    rest: float = 0.0
    smoothing: float = 0.0
    start: float = 0.0

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Return the positions, (samples,)."""
        played = excitation.trapezoids(
            self.speeds, self.acceleration, self.travel, sample_time, rest=self.rest, duration=samples * sample_time
        )[:samples]
        # A way that would exceed the time is left out: the axis rests at the last reversal.
        ends = np.flatnonzero(np.minimum(played, self.travel - played) <= self.acceleration * sample_time**2)
        ends = ends[ends < samples - round(self.smoothing / sample_time)]
        last = int(ends[-1]) if ends.size else 0
        return self.start + excitation.smooth(
            np.append(played[: last + 1], np.full(samples - 1 - last, played[last])), sample_time, self.smoothing
        )

    def describe(self, unit: str) -> str:
        """Describe it, with positions in that unit."""
        speeds = ", ".join(number(one, 3) for one in self.speeds)
        ramps = f", the acceleration rising in {number(1e3 * self.smoothing, 3)} ms" if self.smoothing else ""
        return (
            f"trapezoids from {number(self.start, 3)} {unit} over {number(self.travel, 3)} {unit} and back, at "
            f"{speeds} {unit}/s, {number(self.acceleration, 3)} {unit}/s2{ramps}, {number(self.rest, 2)} s of rest "
            "before each way"
        )


@dataclass(frozen=True, slots=True)
class Sines:
    """A sum of position sines with equal accelerations, between two frequencies, Hz."""

    amplitude: float
    lowest: float
    highest: float
    start: float = 0.0

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Return the positions, (samples,)."""
        return self.start + excitation.multisine(
            samples, sample_time, self.amplitude, self.lowest, self.highest, lines=_LINES, tilt=2.0
        )

    def describe(self, unit: str) -> str:
        """Describe it, with positions in that unit."""
        return (
            f"a sum of {_LINES} sines of the position, {number(self.lowest, 2)} to {number(self.highest, 2)} Hz, "
            f"within {number(self.amplitude, 3)} {unit} of {number(self.start, 3)} {unit}"
        )


@dataclass(frozen=True, slots=True)
class Table:
    """Positions as they stand in a table, one each sample."""

    values: FloatArray

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Positions, (samples,); a short table is repeated, reversed in time."""
        del sample_time
        whole = self.values
        while whole.size < samples:
            whole = np.concatenate([whole, whole[::-1]])
        return np.asarray(whole[:samples])

    def describe(self, unit: str) -> str:
        """Describe it, with positions in that unit."""
        return f"the reference as given, {number(float(np.ptp(self.values)), 3)} {unit} of travel"


@dataclass(frozen=True, slots=True)
class TorqueSines:
    """A sum of equal torque sines between two frequencies, Hz, with peak `amplitude`."""

    amplitude: float
    lowest: float
    highest: float

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Added torque, (samples,)."""
        return excitation.multisine(samples, sample_time, self.amplitude, self.lowest, self.highest, lines=_LINES)

    def describe(self, unit: str) -> str:
        """Describe it, with torques in that unit."""
        return (
            f"a sum of {_LINES} sines of up to {number(self.amplitude, 3)} {unit} on the torque, "
            f"{number(self.lowest, 2)} to {number(self.highest, 2)} Hz"
        )


@dataclass(frozen=True, slots=True)
class TorqueLines:
    """Torque sines of given frequencies, Hz, and amplitudes, with low peaks."""

    frequencies: tuple[float, ...]
    amplitudes: tuple[float, ...]

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Added torque, (samples,)."""
        return excitation.sines(samples, sample_time, self.frequencies, self.amplitudes)

    def describe(self, unit: str) -> str:
        """Describe it, with torques in that unit."""
        pairs = zip(self.frequencies, self.amplitudes, strict=True)
        each = ", ".join(f"{number(size, 2)} {unit} at {number(f, 3)} Hz" for f, size in pairs)
        return f"sines on the torque: {each}"


@dataclass(frozen=True, slots=True)
class TorqueTable:
    """A tabulated torque signal, one value per sample."""

    values: FloatArray

    def play(self, samples: int, sample_time: float) -> FloatArray:
        """Added torque, (samples,); a short table is repeated."""
        del sample_time
        return np.asarray(np.resize(self.values, samples))

    def describe(self, unit: str) -> str:
        """Describe it, with torques in that unit."""
        return f"the signal as given on the torque, of up to {number(float(np.max(np.abs(self.values))), 3)} {unit}"


Motion: TypeAlias = Trapezoids | Sines | Table
Added: TypeAlias = TorqueSines | TorqueLines | TorqueTable


@dataclass(frozen=True, slots=True)
class Plan:
    """A test: a motion, and optionally a signal added to the torque."""

    motion: Motion
    added: Added | None = None

    def play(self, samples: int, sample_time: float) -> tuple[FloatArray, FloatArray | None]:
        """Reference and injected signal, (samples,) each."""
        injected = None if self.added is None else self.added.play(samples, sample_time)
        return self.motion.play(samples, sample_time), injected

    def describe(self, position_unit: str, torque_unit: str) -> str:
        """Return it in words."""
        said = self.motion.describe(position_unit)
        return said if self.added is None else f"{said}; {self.added.describe(torque_unit)}"

    def scale(self, factor: float) -> Plan:
        """Scale the added signal and the motion; a table of positions stays."""
        added, motion = self.added, self.motion
        if isinstance(added, TorqueTable):
            added = replace(added, values=factor * added.values)
        elif isinstance(added, TorqueLines):
            added = replace(added, amplitudes=tuple(factor * one for one in added.amplitudes))
        elif added is not None:
            added = replace(added, amplitude=factor * added.amplitude)
        if isinstance(motion, Trapezoids):
            speeds = tuple(factor * one for one in motion.speeds)
            motion = replace(
                motion, speeds=speeds, acceleration=factor * motion.acceleration, travel=factor * motion.travel
            )
        elif isinstance(motion, Sines):
            motion = replace(motion, amplitude=factor * motion.amplitude)
        same = motion is self.motion and added is self.added
        return self if same else Plan(motion, added)


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


def _trapezoids(u: Sequence[float], room: Room) -> Trapezoids:
    speeds = tuple(_log(0.05, 1.0, one) * room.speed for one in u[:_SPEEDS])
    acceleration = _log(0.05, 1.0, u[_SPEEDS]) * room.acceleration
    smoothing = 0.0 if room.jerk is None else 2 * acceleration / room.jerk  # from full ahead to full back
    travel = _log(0.05, _INSIDE, u[_SPEEDS + 1]) * room.stroke
    start = room.low + 0.5 * (room.stroke - travel)
    return Trapezoids(speeds, acceleration, travel, _REST * u[_SPEEDS + 2], smoothing, start)


def _sines(u: Sequence[float], room: Room) -> Sines:
    lowest = _log(room.lowest, max(0.3 * room.highest, room.lowest), u[1])
    highest = min(max(_log(room.lowest, room.highest, u[2]), 1.05 * lowest), room.highest)
    return Sines(0.5 * _log(0.02, _INSIDE, u[0]) * room.stroke, lowest, highest, room.low + 0.5 * room.stroke)


def _band(u: Sequence[float], room: Room) -> tuple[float, float]:
    least = max(room.lowest, 0.05 * room.mode)
    lowest = _log(least, max(0.9 * room.highest, least), u[0])
    return lowest, min(lowest * _log(1.02, 10.0, u[1]), room.highest)


def _torque_sines(u: Sequence[float], room: Room) -> TorqueSines:
    return TorqueSines(_log(0.02, 1.0, u[0]) * room.torque, *_band(u[1:], room))


def _torque_lines(u: Sequence[float], room: Room) -> TorqueLines:
    size, tilt = _log(0.02, 0.7, u[0]) * room.torque, 2.0 * u[1]
    frequencies, shares = zip(*room.lines, strict=True)
    # Friction wants more at low frequencies than a joint without it, or less: the shares may be levelled.
    return TorqueLines(frequencies, tuple(size * share**tilt for share in shares))


_Numbers: TypeAlias = Sequence[float]
_MOTIONS: Mapping[str, tuple[int, Callable[[_Numbers, Room], Motion]]] = {
    "trapezoids": (_SPEEDS + 3, _trapezoids), "sines": (3, _sines),
}  # fmt: skip
_ADDED: Mapping[str, tuple[int, Callable[[_Numbers, Room], Added] | None]] = {
    "nothing": (0, None),
    "sines": (3, _torque_sines),
    "lines": (2, _torque_lines),
}


@dataclass(frozen=True, slots=True)
class Family:
    """One kind of motion with one kind of added signal.

    Attributes:
        motion: "trapezoids" or "sines".
        added: "nothing", "sines" or "lines".
    """

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
    """Families that a search tries; without `injection` those that add nothing to the torque."""
    possible = [one for one in _ADDED if injection or one == "nothing"]
    return tuple(Family(motion, one) for motion in _MOTIONS for one in possible if one != "lines" or room.lines)


def room_of(
    given: Mapping[str, float],
    found: Mapping[str, float],
    lowest: float,
    highest: float,
    mode: float,
    lines: tuple[tuple[float, float], ...] = (),
    low: float = 0.0,
) -> Room:
    """Ranges of a search, from limits and the present test.

    Args:
        given: the axis limits by name.
        found: maxima of the present test; twice its speed and acceleration, and its stroke and torque, replace missing
            limits.
        lowest: frequency, Hz.
        highest: frequency, Hz.
        mode: of the joint, Hz.
        lines: see `Room`.
        low: end of the stroke.
    """
    more = {"speed": 2.0, "acceleration": 2.0}
    size = {
        name: given.get(name, more.get(name, 1.0) * found[name])
        for name in ("stroke", "speed", "acceleration", "torque")
    }
    return Room(
        **size,
        jerk=given.get("jerk"),
        low=low,
        lowest=lowest,
        highest=highest,
        mode=min(mode, 0.9 * highest),
        lines=lines,
    )
