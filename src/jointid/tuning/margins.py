"""Stability margins of a loop: gain, phase, delay, and the distance of its response from -1.

All crossings count, not the first one: a lightly damped mode crosses several times. The response is taken as straight
between the frequencies of a grid, which is dense where a mode turns it round (`grid`): within 0.3 % of what
python-control finds on polynomials.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.models.linear import ComplexArray, LinearJoints

_LOWEST = 1e-4  # of half the sampling frequency, where a grid begins
_BASE = 1000  # frequencies without modes
_PER_WIDTH = 15  # frequencies in the half width of a resonance
_NARROWEST = 5e-4  # damping ratio below which the grid is not refined
_MOST = 2500  # frequencies for the modes
_WIDTHS = 8  # of a resonance, on each side of the modes

NAMES = ("gain", "reduction", "phase", "delay", "modulus")
"""The margins in the order of the arrays."""


@dataclass(frozen=True, slots=True)
class Margins:
    """The margins of a loop; all 0 where it is not stable, infinite where the response never crosses.

    Attributes:
        gain: by how much the loop's gain may grow, a ratio. reduction: by how much it may fall, a ratio above 1.
        phase: by how much its phase may turn either way, rad.
        delay: that may be added to the loop, seconds.
        modulus: the smallest distance of the response from -1, the inverse of the largest sensitivity.
    """

    gain: float
    reduction: float
    phase: float
    delay: float
    modulus: float

    @property
    def stable(self) -> bool:
        """True if the loop is stable."""
        return self.modulus > 0.0

    def __str__(self) -> str:
        """Return them in a line."""
        if not self.stable:
            return "not stable"
        said = [f"gain x {_size(self.gain)} ({_decibel(self.gain)})", f"gain / {_size(self.reduction)}"]
        phase = "none needed" if math.isinf(self.phase) else f"{number(math.degrees(self.phase), 3)} deg"
        delay = "any" if math.isinf(self.delay) else f"{number(1e3 * self.delay, 3)} ms"
        return ", ".join([*said, f"phase {phase}", f"delay {delay}", f"distance from -1 {number(self.modulus, 3)}"])


def margins_from_row(row: FloatArray) -> Margins:
    """Return a row of `all_margins`."""
    return Margins(*map(float, row))


def _size(ratio: float) -> str:
    return "any" if math.isinf(ratio) else number(ratio, 3)


def _decibel(ratio: float) -> str:
    return "-" if math.isinf(ratio) else f"{20 * math.log10(ratio):.1f} dB"


def grid(joints: LinearJoints, period: float) -> FloatArray:
    """Return the frequencies in Hz at which the loops of some joints are looked at, up to half the sampling one."""
    last = 0.5 / period
    parts = [np.geomspace(_LOWEST * last, last, _BASE)]
    for kind in range(joints.modes.shape[1]):
        at, ratio = joints.modes[:, kind, 0], np.maximum(joints.modes[:, kind, 1], _NARROWEST)
        narrow = float(np.min(ratio))
        width = _WIDTHS * min(narrow, 0.05)
        low, high = float(np.min(at)) * (1 - width), min(float(np.max(at)) * (1 + width), last)
        if low < high:
            steps = math.log(high / low) * _PER_WIDTH / min(narrow, 0.05)
            parts.append(np.geomspace(low, high, min(max(round(steps), 2), _MOST)))
    return np.unique(np.concatenate(parts))


def all_margins(response: ComplexArray, hertz: FloatArray) -> FloatArray:
    """Return the margins of loops that are known to be stable, (loops, 5), in the order of `NAMES`.

    Args:
        response: (loops, frequencies) of the loops cut open.
        hertz: (frequencies,) rising, the last at half the sampling frequency, where a response is real.
    """
    before, after = response[:, :-1], response[:, 1:]
    gain, reduction = _of_gain(before, after, response[:, -1].real)
    phase, delay = _of_phase(before, after, hertz)
    step = after - before
    size = np.maximum(_square(step), 1e-300)
    along = np.clip(-((before + 1) * step.conj()).real / size, 0.0, 1.0)
    modulus = np.sqrt(np.min(_square(before + along * step + 1), axis=1))
    return np.column_stack([gain, reduction, phase, delay, modulus])


def _of_gain(before: ComplexArray, after: ComplexArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the factors by which the gains may grow, and fall, until a response passes through -1."""
    grow, fall = (np.full(len(before), np.inf) for _ in range(2))
    loop, at = np.nonzero(np.signbit(before.imag) != np.signbit(after.imag))
    first, then = before[loop, at], after[loop, at]
    size = -(first.real + first.imag / (first.imag - then.imag) * (then.real - first.real))
    loop, size = np.concatenate([loop, np.arange(len(before))]), np.concatenate([size, -last])
    inside, outside = (size > 0) & (size < 1), size >= 1
    np.minimum.at(grow, loop[inside], 1 / size[inside])
    np.minimum.at(fall, loop[outside], size[outside])
    return grow, fall


def _of_phase(before: ComplexArray, after: ComplexArray, hertz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the phase margins and the delays that may be added."""
    turn, late = (np.full(len(before), np.inf) for _ in range(2))
    inside = _square(before) < 1.0, _square(after) < 1.0
    loop, at = np.nonzero(inside[0] != inside[1])
    first, then = before[loop, at], after[loop, at]
    sizes = np.log(np.abs(first)), np.log(np.abs(then))
    share = sizes[0] / (sizes[0] - sizes[1])
    lead = np.angle(-first * np.exp(1j * share * np.angle(then / first)))
    rate = 2 * math.pi * (hertz[at] + share * (hertz[at + 1] - hertz[at]))
    np.minimum.at(turn, loop, np.abs(lead))
    np.minimum.at(late, loop, np.mod(lead, 2 * math.pi) / rate)
    return turn, late


def _square(response: ComplexArray) -> FloatArray:
    return np.asarray(response.real**2 + response.imag**2)


def crossover(response: ComplexArray, hertz: FloatArray) -> float:
    """Return the highest frequency in Hz at which any of some loops has a gain of 1 or more; 0 where none has."""
    above = np.any(np.abs(response) >= 1.0, axis=0)
    return float(hertz[np.flatnonzero(above)[-1]]) if above.any() else 0.0
