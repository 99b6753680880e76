"""Select the frequencies at which the record is informative about the controller (signal over noise > 4).

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
from jointid.controller_id.noise import PositionError, band_means, band_power, band_widths
from jointid.controller_id.structures import SLOWER
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE

_PAST = 48  # samples of reference and position: a notch of 10 Hz at 1 kHz rings as long
_BESIDE = 24  # samples of what passes the torque's filter only
_IMAGES = 3  # samples of what a slower position loop makes of slow signals: near its rate, where it holds nothing
_LOUDER = 4.0  # times the noise, in power: what is not tells of the noise, not of the law
_ROWS = 4096  # samples whose columns are in memory at a time
_DEPENDENT = 1e-12  # of the largest singular value: what is below is rounding


def informative_frequencies(
    inputs: FloatArray, torque: FloatArray, added: FloatArray, kept: FloatArray, error: PositionError
) -> FloatArray:
    """Return 1 at the informative frequencies of the real transform, else 0.

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
    asked = [np.ones((r.size, 1)), np.cumsum(r - q)[:, np.newaxis], *_signal_and_past(r), *_images(_difference(r))]
    asked += [
        _lagged_columns(one, _BESIDE) for one in (inputs[:, DIRECTION], inputs[:, INJECTED], added) if np.any(one)
    ]
    shown, left = map(band_power, _regress(asked, [*_signal_and_past(q), *_images(r - q)], torque, kept))
    loud = band_power(torque - torque.mean()) > _LOUDER * left
    loud &= (error.power > _LOUDER * error.variance * band_means(error.shape**2)) | (shown > _LOUDER * left)
    return np.concatenate([[1.0], np.repeat(np.asarray(loud, dtype=np.float64), band_widths(torque.size // 2 + 1))])


def _regress(
    asked: list[FloatArray], seen: list[FloatArray], torque: FloatArray, kept: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the torque explained by the position, and the residual, scaled as on samples of its own.

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
    explained = np.vstack([np.hstack([one[part] for one in every]) @ split for part in parts])
    counted = float(np.sum(kept))
    left = (torque - explained.sum(axis=1)) * kept * np.sqrt(counted / max(counted - int(rank), 1.0))
    return explained[:, 1], np.asarray(left)


def _images(signal: FloatArray) -> list[FloatArray]:
    """Return the images of a signal in a slower position loop: the signal modulated by fractions of its rate."""
    parts = np.arange(1, max(SLOWER) // 2 + 1)[:, np.newaxis] / max(SLOWER)
    turns = np.exp(2j * np.pi * parts * np.arange(signal.size))
    return [_lagged_columns(signal * part, _IMAGES) for turn in turns for part in (turn.real, turn.imag)]


def _signal_and_past(signal: FloatArray) -> list[FloatArray]:
    """Return columns that span a signal and its earlier values; second differences keep them well conditioned."""
    change = _difference(signal)
    return [signal[:, np.newaxis], change[:, np.newaxis], _lagged_columns(_difference(change), _PAST)]


def _difference(signal: FloatArray) -> FloatArray:
    return np.diff(signal, prepend=signal[:1])


def _lagged_columns(signal: FloatArray, samples: int) -> NDArray[np.float64]:
    """Return a signal and its earlier values, (samples of it, samples + 1), at its first value until it begins."""
    led = np.concatenate([np.full(samples, signal[0]), signal])
    return np.lib.stride_tricks.sliding_window_view(led, samples + 1)
