"""Before any law, what a record can tell of it: the frequencies at which torque and position are louder than noise.

Whatever the law, but for its limit: it is linear in the reference, its direction, the position and what is injected,
and its memory is short but for an integral. So a regression of the torque on long stretches of their past leaves little
but noise (Zhu 2001, Multivariable System Identification for Process Control, ch. 6: high orders first). What is heard
against *that* is the same for all laws. Judged by what a law itself leaves, a wrong one would silence just the
frequencies at which it is wrong.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.data.record import FloatArray
from jointid.learning.noise import loudness, widths
from jointid.learning.structures import SLOWER
from jointid.model.controllers import DIRECTION, INJECTED, POSITION, REFERENCE

_PAST = 48  # samples of reference and position: a notch of 10 Hz at 1 kHz rings as long
_BESIDE = 24  # samples of what passes the torque's filter only
_IMAGES = 3  # samples of what a slower position loop makes of slow signals: near its rate, where it holds nothing
_LOUDER = 4.0  # times the noise, in power: what is not tells of the noise, not of the law
_DEPENDENT = 1e-12  # of the largest singular value: what is below is rounding


def heard(inputs: FloatArray, torque: FloatArray, added: FloatArray, kept: FloatArray) -> FloatArray:
    """Return 1 at the frequencies of the real transform that tell of the law, else 0.

    Args:
        inputs: (samples, INPUTS) what a law as fast as the log reads.
        torque: (samples,) logged, less what was added after the limit.
        added: (samples,) what that was; in a log that is late it still shows.
        kept: (samples,) 1 where the torque is what a law gives, not a limit.
    """
    left = _unexplained(inputs, torque, added, kept)
    loud = loudness(torque - torque.mean()) > _LOUDER * loudness(left)
    return np.concatenate([[1.0], np.repeat(np.asarray(loud, dtype=np.float64), widths(torque.size // 2 + 1))])


def _unexplained(inputs: FloatArray, torque: FloatArray, added: FloatArray, kept: FloatArray) -> FloatArray:
    """Return what long stretches of the past leave, (samples,), as large as it would be on samples of its own."""
    r, e = inputs[:, REFERENCE] - inputs[0, REFERENCE], inputs[:, REFERENCE] - inputs[:, POSITION]
    columns = [np.ones((e.size, 1)), np.cumsum(e)[:, np.newaxis], *_bent(r), *_bent(e)]
    turns = np.exp(2j * np.pi * np.arange(e.size) * np.arange(1, max(SLOWER) // 2 + 1)[:, np.newaxis] / max(SLOWER))
    held = (part * one for turn in turns for part in (turn.real, turn.imag) for one in (e, _change(r)))
    columns += [_past(one, _IMAGES) for one in held]
    columns += [_past(one, _BESIDE) for one in (inputs[:, DIRECTION], inputs[:, INJECTED], added) if np.any(one)]
    X = np.hstack(columns) * kept[:, np.newaxis]
    norms = np.linalg.norm(X, axis=0)
    X /= np.where(norms > 0, norms, 1.0)
    wanted = torque * kept
    gains, _, rank, _ = np.linalg.lstsq(X, wanted, rcond=_DEPENDENT)
    rows = float(np.sum(kept))
    return np.asarray((wanted - X @ gains) * np.sqrt(rows / max(rows - int(rank), 1.0)))


def _bent(signal: FloatArray) -> list[FloatArray]:
    """Return what spans a signal and its earlier values: of smooth ones, mostly what bends them differs."""
    change = _change(signal)
    return [signal[:, np.newaxis], change[:, np.newaxis], _past(_change(change), _PAST)]


def _change(signal: FloatArray) -> FloatArray:
    return np.diff(signal, prepend=signal[:1])


def _past(signal: FloatArray, samples: int) -> NDArray[np.float64]:
    """Return a signal and its earlier values, (samples of it, samples + 1), at its first value until it begins."""
    led = np.concatenate([np.full(samples, signal[0]), signal])
    return np.lib.stride_tricks.sliding_window_view(led, samples + 1)
