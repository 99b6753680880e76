"""A filter forwards and backwards by its modes, at the samples that are kept and nowhere else.

A filter H with single poles p_i is a sum of modes, each of which forgets by its own factor a sample (partial
fractions), and so is what it makes of a signal forwards and then backwards::

    H(z) = d + sum_i r_i / (1 - p_i / z)
    H(z) H(1/z) = d H(0) + sum_i r_i H(1/p_i) (1 / (1 - p_i / z) + p_i z / (1 - p_i z))

The modes forwards and those backwards read the signal itself, side by side, so the samples between two that are kept
are summed up by one small matrix, and only one sample in so many takes a step of a recurrence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.memory import Room
from jointid.data.record import FloatArray

if TYPE_CHECKING:
    from typing import Self

_BLOCKS = 512  # kept samples at a time: what they need stays in the cache
_ROOM = Room()

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """A filter of real coefficients with as many zeros as poles, complex and single, by its modes.

    Attributes:
        poles: (modes,) those above the real axis; the others are their conjugates.
        residues: (modes,) r_i of the module.
        both: (modes,) the residues of the filter forwards and backwards, r_i H(1/p_i).
        direct: d of the module. passed: what goes straight through both ways, d H(0).
        shared: (modes, 2 modes) ``p_j / (1 - p_i p_j)`` over all poles j, those above the real axis first.
    """

    poles: ComplexArray
    residues: ComplexArray
    both: ComplexArray
    direct: float
    passed: float
    shared: ComplexArray

    @classmethod
    def of(cls, zeros: ComplexArray, poles: ComplexArray, gain: float) -> Self:
        """Return the modes of a filter given by its zeros, poles and gain."""
        upper = poles[poles.imag > 0]
        every = np.concatenate([upper, upper.conj()])

        def response(inverse: ComplexArray, others: ComplexArray) -> complex:
            """Return H at 1/z, without the pole that `others` leave out."""
            return complex(gain * np.prod(1 - zeros * inverse) / np.prod(1 - others * inverse))

        residues = np.array([response(1 / p, np.delete(every, i)) for i, p in enumerate(upper)])
        backwards = np.array([response(p, every) for p in upper])
        direct = float(np.real(gain * np.prod(zeros) / np.prod(every)))
        shared = every / (1 - np.multiply.outer(upper, every))
        return cls(upper, residues, residues * backwards, direct, direct * gain, shared)


def thinned(values: FloatArray, modes: Modes, padding: int, first: int, keep: int) -> FloatArray:
    """Return columns filtered forwards and backwards, (kept, columns), as `scipy.signal.sosfiltfilt` does.

    Args:
        values: (samples, columns).
        modes: of the filter.
        padding: samples by which the ends are reflected about their ends.
        first: sample that is kept first; the last one is kept, too.
        keep: one sample in so many.
    """
    from jointid.data.recurrences import add_modes

    p, at = modes.poles, np.arange(keep)
    values = np.ascontiguousarray(values, dtype=np.float64)
    between = values[first + 1 :].reshape(-1, keep, values.shape[1])
    kept = modes.passed * values[first::keep]

    def add(states: ComplexArray, samples: NDArray[np.intp], step: int) -> ComplexArray:
        """Add the modes of one direction to all that is kept, and return them where they end.

        Args:
            states: (modes, columns) where they begin.
            samples: (keep,) how often each sample between two that are kept is forgotten a part before the second.
            step: 1 forwards, -1 backwards.
        """
        kept[0 if step > 0 else -1] += 2 * np.real(modes.both @ states)
        rows, moved = np.concatenate(_parts(p[:, np.newaxis] ** samples)), _parts(states)
        begins = range(0, len(between), _BLOCKS)
        for begin in begins if step > 0 else reversed(begins):
            block = between[begin : begin + _BLOCKS]
            pushes = _ROOM.array("pushes", (len(block), len(rows), block.shape[2]))
            np.matmul(rows, block, out=pushes)
            add_modes(
                _parts(p**keep), 2 * _parts(modes.both), pushes, step, moved, kept[begin : begin + len(block) + 1]
            )
        return np.asarray(moved[0] + 1j * moved[1])

    before = np.concatenate([2 * values[:1] - values[padding:0:-1], values[: first + 1]])
    behind = 2 * values[-1:] - values[-2 : -padding - 2 : -1]
    settled = np.multiply.outer(1 / (1 - p), before[0])
    forwards = _gathered(p, before[::-1]) + _after(p, len(before), settled)
    forwards = add(forwards, keep - 1 - at, 1)
    last = _gathered(p, behind[::-1]) + _after(p, padding, forwards)
    # Backwards the filter begins as if its own output had ended at a constant, not the signal.
    output = modes.direct * behind[-1] + 2 * np.real(modes.residues @ last)
    every = np.concatenate([modes.residues[:, np.newaxis] * last, (modes.residues[:, np.newaxis] * last).conj()])
    ended = np.multiply.outer(1 / (1 - p), output) - modes.shared @ every
    ended *= (modes.residues / modes.both)[:, np.newaxis]
    backwards = p[:, np.newaxis] * _gathered(p, behind) + _after(p, padding + 1, ended)
    add(backwards, 1 + at, -1)
    return kept


def _gathered(poles: ComplexArray, values: FloatArray) -> ComplexArray:
    """Return the modes that samples leave, (modes, columns), each by so many samples older than the one before."""
    return np.asarray(poles[:, np.newaxis] ** np.arange(len(values)) @ values)


def _after(poles: ComplexArray, samples: int, states: ComplexArray) -> ComplexArray:
    return np.asarray((poles**samples)[:, np.newaxis] * states)


def _parts(numbers: ComplexArray) -> FloatArray:
    return np.stack([numbers.real, numbers.imag])
