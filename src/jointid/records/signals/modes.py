"""Forward-backward filtering by modes, evaluated only at the kept samples.

A filter H with single poles p_i is a sum of modes (partial fractions), also forwards and then backwards::

    H(z) = d + sum_i r_i / (1 - p_i / z)
    H(z) H(1/z) = d H(0) + sum_i r_i H(1/p_i) (1 / (1 - p_i / z) + p_i z / (1 - p_i z))

Both directions read the signal itself. One small matrix sums the samples between two kept ones, so that a recurrence
runs over the kept samples only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, Room

if TYPE_CHECKING:
    from typing import Self

_BLOCKS = 512  # kept samples at a time: what they need stays in the cache
_ROOM = Room()

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """The modes of a real filter with single poles and as many zeros.

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
        """Modes of a filter given by zeros, poles and gain."""
        upper = poles[poles.imag > 0]
        every = np.concatenate([upper, upper.conj()])

        def response(inverse: ComplexArray, others: ComplexArray) -> complex:
            """Evaluate H at 1/z without the pole that `others` excludes."""
            return complex(gain * np.prod(1 - zeros * inverse) / np.prod(1 - others * inverse))

        residues = np.array([response(1 / p, np.delete(every, i)) for i, p in enumerate(upper)])
        backwards = np.array([response(p, every) for p in upper])
        direct = float(np.real(gain * np.prod(zeros) / np.prod(every)))
        shared = every / (1 - np.multiply.outer(upper, every))
        return cls(upper, residues, residues * backwards, direct, direct * gain, shared)


@dataclass(frozen=True, slots=True, eq=False)
class Thinning:
    """Coefficients of decimation by modes, for one decimation factor.

    Attributes:
        padding: samples by which the ends are reflected about their ends.
        between: (2, keep, 2 modes) what the samples between two that are kept add to the later, forwards, and to the
            earlier, backwards: real parts, then imaginary ones.
        older: (modes, padding + keep + 1) the powers of the poles.
        powers: see `common.compiled.carry`.
        weights: (2 modes,) of what the modes say: real parts, then imaginary ones.
    """

    modes: Modes
    keep: int
    padding: int
    between: FloatArray
    older: ComplexArray
    powers: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, modes: Modes, keep: int, padding: int) -> Self:
        """Return it for a filter."""
        older = modes.poles[:, np.newaxis] ** np.arange(padding + keep + 1)
        forwards, backwards = older[:, keep - 1 :: -1], older[:, 1 : keep + 1]
        between = np.stack([np.concatenate(_real_parts(one)).T for one in (forwards, backwards)])
        weights = np.concatenate([2 * modes.both.real, -2 * modes.both.imag])
        return cls(modes, keep, padding, between, older, _real_parts(older[:, keep]), weights)

    @np.errstate(over="ignore", invalid="ignore")  # the derivatives of a diverging loop may overflow
    def __call__(self, parts: Sequence[FloatArray], first: int) -> FloatArray:
        """Filter forwards and backwards, (signals, kept), as `scipy.signal.sosfiltfilt` does.

        Args:
            parts: of the signals, (signals, samples) each, not copied.
            first: first kept sample; the last one is kept, too.
        """
        modes, padding = self.modes, self.padding
        between = [part[:, first + 1 :] for part in parts]
        between = [part.reshape(len(part), part.shape[1] // self.keep, self.keep) for part in between]
        kept = modes.passed * np.concatenate([part[:, first :: self.keep] for part in parts])
        head = np.concatenate([part[:, : max(padding, first) + 1] for part in parts])
        tail = np.concatenate([part[:, -padding - 1 :] for part in parts])
        before = np.concatenate([2 * head[:, :1] - head[:, padding:0:-1], head[:, : first + 1]], axis=1)
        behind = 2 * tail[:, -1:] - tail[:, -2::-1]
        forwards = self._gather(before[:, ::-1], np.multiply.outer(before[:, 0], 1 / (1 - modes.poles)))
        last = self._gather(behind[:, ::-1], self._add(kept, between, forwards, 1))
        # Backwards the filter begins as if its own output had ended at a constant, not the signal.
        says = modes.residues * last
        output = modes.direct * behind[:, -1] + 2 * np.real(np.sum(says, axis=1))
        ended = np.multiply.outer(output, 1 / (1 - modes.poles))
        ended -= np.concatenate([says, says.conj()], axis=1) @ modes.shared.T
        ended *= modes.residues / modes.both
        self._add(kept, between, modes.poles * self._gather(behind, ended), -1)
        return kept

    def _gather(self, values: FloatArray, states: ComplexArray) -> ComplexArray:
        """Modes (signals, modes) after samples, newest first, and states."""
        size = values.shape[1]
        return np.asarray(values @ self.older[:, :size].T + states * self.older[:, size])

    def _add(self, kept: FloatArray, between: Sequence[FloatArray], states: ComplexArray, step: int) -> ComplexArray:
        """Add the modes of one direction to `kept`, and return their final states.

        Args:
            kept: (signals, kept).
            between: (signals, kept - 1, keep) samples from each kept one to the next.
            states: initial modes, (signals, modes).
            step: 1 forwards, -1 backwards.
        """
        from jointid.common.compiled import carry

        forwards = step > 0
        columns, stands = self.between[0 if forwards else 1], np.concatenate([states.real, states.imag], axis=1)
        kept[:, 0 if forwards else -1] += stands @ self.weights
        size, begins = min(_BLOCKS, kept.shape[1] - 1) + 1, range(0, kept.shape[1] - 1, _BLOCKS)
        room = _ROOM.array("said", (len(kept) * size * columns.shape[1],))
        for begin in begins if forwards else reversed(begins):
            count = min(_BLOCKS, kept.shape[1] - 1 - begin)
            said = room[: len(kept) * (count + 1) * columns.shape[1]].reshape(len(kept), count + 1, -1)
            said[:, 0 if forwards else -1] = stands
            new, row = said[:, 1:] if forwards else said[:, :-1], 0
            for part in between:
                np.matmul(part[:, begin : begin + count], columns, out=new[row : row + len(part)])
                row += len(part)
            carry(self.powers, said, step)
            later = 1 if forwards else 0
            kept[:, begin + later : begin + later + count] += new @ self.weights
            stands = said[:, -1 if forwards else 0].copy()
        half = stands.shape[1] // 2
        return np.asarray(stands[:, :half] + 1j * stands[:, half:])


def _real_parts(numbers: ComplexArray) -> FloatArray:
    return np.stack([numbers.real, numbers.imag])
