"""The log of a run: the torque at its tap, at the log's instants, held or averaged."""

from __future__ import annotations

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.records.record import Tap, Timing
from jointid.simulation.loop_input import LoopInput


def seen_torque(experiment: LoopInput, command: FloatArray, tapped: FloatArray) -> FloatArray:
    """Return the torque at the log's tap, (periods,): the controller's output, or the torque behind its limit."""
    behind = tapped if experiment.tap is Tap.COMMAND else command
    return behind + experiment.shown if experiment.shows else behind


def as_logged(experiment: LoopInput, signal: FloatArray) -> FloatArray:
    """Return a signal of the controller's instants as the log's torque channel shows it; linear in it.

    The signal, (periods,) or (periods, columns), is the controller's output, or at a tap that measures what acts the
    torque before the delay: piecewise constant over periods, or over the parts of periods.
    """
    shown = acting(experiment, signal)
    if experiment.timing is not Timing.AVERAGED:
        return shown if experiment.looked.size == len(shown) else np.asarray(shown[experiment.looked])
    lengths = np.tile(experiment.lengths, len(signal)).reshape(-1, *(1,) * (signal.ndim - 1))
    means = averages(experiment, lengths * shown)
    means[0] = shown[0]
    return means


def acting(experiment: LoopInput, signal: FloatArray) -> FloatArray:
    """Return a signal of the controller's instants in each part of each period as the tap sees it, parts in a row."""
    parts = experiment.lengths.size
    if experiment.tap is Tap.MEASURED:
        sources = (np.arange(len(signal))[:, np.newaxis] - experiment.lags).reshape(-1)
        return np.asarray(signal[np.maximum(sources, 0)])
    return signal if parts == 1 else np.repeat(signal, parts, axis=0)


def averages(experiment: LoopInput, integrals: FloatArray) -> FloatArray:
    """Return the mean over each sample time that ends at an instant of the log, from the integrals over the parts."""
    integral = np.zeros((len(integrals) + 1, *integrals.shape[1:]))
    np.cumsum(integrals, axis=0, out=integral[1:])
    means = np.zeros((experiment.looked.size, *integrals.shape[1:]))
    means[1:] = np.diff(integral[experiment.looked], axis=0) / experiment.sample_time
    return means
