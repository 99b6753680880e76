"""Starts for a flexible joint without a simulation: regressions at a row of antiresonances.

The motor's motion is reconstructed by the inverse of the controller (`inverse_controller`). Along a known motion of the
motor, the load of a spring with antiresonance f_a and little damping moves as a filter of second order says,
``q12 = G(f_a) q1``, and what is left is linear::

    tau = ZZ1 a1 + ZZ2 a12 + Fv (v1 + v12) / 2 + Fc sign(v1) + offset,     K12 = ZZ2 (2 pi f_a)^2

It is solved for each f_a of a grid, by least squares, and with the same columns along the reference as instruments:
where the loop answers to noise or to forces, the reconstructed motion is no independent one. A rigid joint need not
explain anything for that: it works where the mode lies inside the loop's bandwidth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.starts.inverse_controller import reconstructed_position, torque_behind_limit
from jointid.models.controllers import REFERENCE
from jointid.models.joints import spring_at

_MOST, _WIDER, _SHARE = 0.99, 4.0, 0.2  # the band: times that holds so much of the torque, or of the sampling frequency
_SLOWEST, _FASTEST, _COUNT = 0.015, 0.75, 36  # of the band, antiresonances that are tried
_SAMPLES = 5.0  # of the band kept per second
_RATIO = 0.03  # damping of the load against the motor
_ENDS = 5.0  # periods of the band at both ends that the filters spoil
_RESTING = 1e-3  # of the largest speed
_SHORTEST = 100  # samples: of fewer nothing is said
_KEPT = 4  # starts by least squares, and as many by instruments


def antiresonance_starts(problem: ClosedLoopProblem) -> list[dict[str, float]]:
    """Return starts, every parameter by name, the best first; none where the controller cannot be inverted."""
    try:
        position = reconstructed_position(problem)
    except MethodError:  # the log does not show the output, or the law cannot be turned round
        return []
    experiment = problem.experiment
    law, sample_time = experiment.law, problem.sample_time
    reference = experiment.inputs[:: experiment.every, REFERENCE][: position.size]
    at = np.arange(position.size) * sample_time
    acting = np.interp(at - law.delay - 0.5 * law.period, at, torque_behind_limit(problem))
    motions = np.column_stack([position, reference, acting])[law.order // experiment.every + 2 :]
    if len(motions) < _SHORTEST or not (np.all(np.isfinite(motions)) and np.ptp(motions[:, 2]) > 0):
        return []
    first = {"initial_position": float(motions[0, 0]), "initial_velocity": 0.0}
    first["initial_torque"] = float(problem.measured[0])
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free}
    starts = []
    for values in _solve_row(*_resample(motions, sample_time)):
        # A friction law may have a coefficient for each direction, which begin alike.
        known = {
            p.name: value
            for base, value in (values | first).items()
            for p in problem.parameters
            if f"{p.name}_".startswith(f"{base}_")
        }
        starts.append({p.name: p.start or 0.0 for p in problem.parameters} | known | fixed)
    return starts


def _resample(motions: FloatArray, sample_time: float) -> tuple[FloatArray, float, float]:
    """Return motions below a band that holds most of the torque, their sample time, and the band in Hz."""
    from scipy.signal import butter, sosfiltfilt

    energy = np.cumsum(np.abs(np.fft.rfft(motions[:, 2] - motions[:, 2].mean())) ** 2)
    most = float(np.searchsorted(energy, _MOST * energy[-1])) / (len(motions) * sample_time)
    band = min(_WIDER * most, _SHARE / sample_time)
    low_pass = butter(4, band, fs=1 / sample_time, output="sos")
    every = max(math.floor(1.0 / (_SAMPLES * band * sample_time)), 1)
    return np.asarray(sosfiltfilt(low_pass, motions, axis=0)[::every]), every * sample_time, band


def _solve_row(seen: FloatArray, step: float, band: float) -> Iterator[dict[str, float]]:
    """Yield the values that explain the torque best, by least squares and by instruments in turn.

    The motions are (samples, 3) motor position, reference and torque, below a band in Hz.
    """
    ends = max(round(_ENDS / (band * step)), 2)
    inside, torque = slice(ends, -ends), seen[ends:-ends, 2]
    found: tuple[list[tuple[float, dict[str, float]]], ...] = ([], [])
    for frequency in np.geomspace(_SLOWEST * band, _FASTEST * band, _COUNT):
        W, R = (_columns(seen[:, i], float(frequency), step)[inside] for i in (0, 1))
        for kind, Z in enumerate((W, R)):
            x = _by_instruments(Z, W, torque)
            if x[0] > 0 and x[1] > 0:
                found[kind].append((float(np.linalg.norm(torque - W @ x)), _values(x, float(frequency))))
    ranked = [sorted(kind, key=lambda one: one[0])[:_KEPT] for kind in found]
    for place in range(_KEPT):
        for best in ranked:
            yield from (values for _, values in best[place : place + 1])


def _columns(position: FloatArray, frequency: float, step: float) -> FloatArray:
    """Return the columns of the module's equation along a motion of the motor, (samples, 5)."""
    from scipy.signal import bilinear, lfilter, lfilter_zi

    rate = 2 * math.pi * frequency
    numerator, denominator = bilinear([2 * _RATIO * rate, rate**2], [1.0, 2 * _RATIO * rate, rate**2], 1 / step)
    rest = lfilter_zi(numerator, denominator) * position[0]
    load = lfilter(numerator, denominator, position, zi=rest)[0]
    motor_velocity, load_velocity = np.gradient(position, step), np.gradient(load, step)
    return np.column_stack(
        [
            np.gradient(motor_velocity, step),
            np.gradient(load_velocity, step),
            0.5 * (motor_velocity + load_velocity),
            # At rest the sign would be that of rounding.
            np.sign(motor_velocity) * (np.abs(motor_velocity) > _RESTING * np.max(np.abs(motor_velocity))),
            np.ones(position.size),
        ]
    )


def _by_instruments(Z: FloatArray, W: FloatArray, torque: FloatArray) -> FloatArray:
    """Return the solution of ``Z' (torque - W x) = 0``, (parameters,)."""
    of_Z, of_W = (np.maximum(np.linalg.norm(M, axis=0), 1e-300) for M in (Z, W))
    return np.asarray(np.linalg.lstsq((Z / of_Z).T @ (W / of_W), (Z / of_Z).T @ torque)[0] / of_W)


def _values(x: FloatArray, frequency: float) -> dict[str, float]:
    """Return a solution as the parameters of a flexible joint, with both sides' frictions halved."""
    motor, load, viscous, coulomb, offset = map(float, x)
    values = {"motor_inertia": motor, "load_inertia": load, "offset": offset, **spring_at(frequency, load, _RATIO)}
    for side in ("motor", "load"):
        values |= {f"{side}_viscous": max(0.5 * viscous, 0.0), f"{side}_coulomb": max(0.5 * coulomb, 0.0)}
    return values
