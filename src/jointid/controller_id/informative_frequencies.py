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

from jointid.common.arrays import FloatArray, column_norms
from jointid.controller_id.noise import PositionError, by_band, loudness, widths
from jointid.controller_id.structures import SLOWER
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE

_PAST = 48  # samples of reference and position: a notch of 10 Hz at 1 kHz rings as long
_BESIDE = 24  # samples of what passes the torque's filter only
_IMAGES = 3  # samples of what a slower position loop makes of slow signals: near its rate, where it holds nothing
_LOUDER = 4.0  # times the noise, in power: what is not tells of the noise, not of the law
_ROWS = 4096  # samples whose columns are in memory at a time
_DEPENDENT = 1e-12  # of the largest singular value: what is below is rounding


def heard(
    inputs: FloatArray, torque: FloatArray, added: FloatArray, kept: FloatArray, error: PositionError
) -> FloatArray:
    """Return 1 at the frequencies of the real transform that tell of the law, else 0.

    A law is applied to the logged position. Where that is no louder than its rounding it tells of the law only if it
    shows in the torque: if the controller saw the same rounding, or a slower position loop makes images there of what
    moves slowly. A rounding that the controller did not see cannot: what is taken from it is left in the residual.

    Args:
        inputs: (samples, INPUTS) what a law as fast as the log reads.
        torque: (samples,) logged, less what was added after the limit.
        added: (samples,) what that was; in a log that is late it still shows.
        kept: (samples,) 1 where the torque is what a law gives, not a limit.
        error: what is known of the position's.
    """
    r, q = (inputs[:, i] - inputs[0, REFERENCE] for i in (REFERENCE, POSITION))
    asked = [np.ones((r.size, 1)), np.cumsum(r - q)[:, np.newaxis], *_bent(r), *_images(_change(r))]
    asked += [_past(one, _BESIDE) for one in (inputs[:, DIRECTION], inputs[:, INJECTED], added) if np.any(one)]
    shown, left = map(loudness, _regressed(asked, [*_bent(q), *_images(r - q)], torque, kept))
    loud = loudness(torque - torque.mean()) > _LOUDER * left
    loud &= (error.power > _LOUDER * error.variance * by_band(error.shape**2)) | (shown > _LOUDER * left)
    return np.concatenate([[1.0], np.repeat(np.asarray(loud, dtype=np.float64), widths(torque.size // 2 + 1))])


def _regressed(
    asked: list[FloatArray], seen: list[FloatArray], torque: FloatArray, kept: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what is seen does to the torque, and what is left, as large as it would be on samples of its own.

    The hundreds of columns are made of a few thousand samples at a time: of a long record they would fill the memory.
    """
    every, first = [*asked, *seen], sum(one.shape[1] for one in asked)
    parts = [slice(at, at + _ROWS) for at in range(0, torque.size, _ROWS)]
    root = np.zeros((0, sum(one.shape[1] for one in every) + 1))
    for part in parts:
        rows = np.column_stack([*(one[part] for one in every), torque[part]]) * kept[part, np.newaxis]
        root = np.asarray(np.linalg.qr(np.vstack([root, rows]), mode="r"))
    norms = column_norms(root[:, :-1])
    gains, _, rank, _ = np.linalg.lstsq(root[:, :-1] / norms, root[:, -1], rcond=_DEPENDENT)
    split = np.zeros((norms.size, 2))  # what is asked, and what is seen
    split[:first, 0], split[first:, 1] = (gains / norms)[:first], (gains / norms)[first:]
    told = np.vstack([np.hstack([one[part] for one in every]) @ split for part in parts])
    counted = float(np.sum(kept))
    left = (torque - told.sum(axis=1)) * kept * np.sqrt(counted / max(counted - int(rank), 1.0))
    return told[:, 1], np.asarray(left)


def _images(signal: FloatArray) -> list[FloatArray]:
    """Return what a slower position loop may make of a signal: the same, turned by parts of its rate."""
    parts = np.arange(1, max(SLOWER) // 2 + 1)[:, np.newaxis] / max(SLOWER)
    turns = np.exp(2j * np.pi * parts * np.arange(signal.size))
    return [_past(signal * part, _IMAGES) for turn in turns for part in (turn.real, turn.imag)]


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
