"""What position encoders would add to what the torque already told, from the exact sensitivities of the positions.

An encoder adds to the information of an estimate, the inverse of its covariance P::

    P1 = (P^-1 + sum_t g_t g_t' / R)^-1,    R = step^2 / 12

R is the variance of rounding to an encoder's steps, and the mean of every column of g is taken away first, because
nobody knows an encoder's zero. What g is, is decided by where the residual of the torque comes from:

- **in the loop**: the log is the controller's output, exact, and an unknown force acts on the motor. Its answers in
  torque T_u and positions T_m, T_l are those of one force, so that for each frequency the covariance of what is logged
  is ``T T* S + diag(0, R_m, R_l)``. Inverted, that is the information of the torque alone, and that of what torque does
  not already explain, ``g = f - (T / T_u) f_u``. The motor position is what the law was fed with: the torque shows it
  without error, g = 0, and a motor encoder adds nothing. The load hangs on the motor by equations that the force does
  not enter, so g is the sensitivity of the load position with the motor's motion prescribed, 0 for all parameters of
  the motor's side; ``f_l - H f_m``, H the load's answer to the motor while it slides.
- **on the log**: a measured current has noise of its own, the positions share none of it, and g is the sensitivity f.

The ratio T / T_u is not measured from simulated runs: an error of 1 % in it would be taken for information, because an
encoder's steps are that small against what a controller lets the motor move.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from jointid.data.record import Channel, FloatArray
from jointid.estimation.problem import Problem

Noise: TypeAlias = Literal["loop", "log"]

_OF_TRAVEL = 1e-6  # of the commanded travel: an encoder's step where nothing is known of it
_WHOLE = 0.05  # of a step: how far a position may be from a multiple of it
_MOSTLY = 0.95  # of the positions that are such multiples


@dataclass(frozen=True, slots=True, eq=False)
class Informations:
    """What one encoder each would add, (free, free), in the inverse squares of the parameters' units.

    Attributes:
        motor: of an encoder on the motor.
        load: of one on the load; None for a rigid joint.
    """

    motor: FloatArray
    load: FloatArray | None


def step_of(channel: Channel | None) -> float | None:
    """Return the step of the encoder that a position was read from, in its unit; None where none is to be seen."""
    if channel is None:
        return None
    moves = np.abs(np.diff(channel.values))
    moves = moves[moves > 1e-12 * (float(np.ptp(channel.values)) or 1.0)]
    if not moves.size:
        return None
    step = float(moves.min())
    steps = (channel.values - channel.values[0]) / step
    near = np.abs(steps - np.round(steps)) < _WHOLE
    # Positions that were never rounded have a smallest move too, but are no multiples of it.
    return step if np.mean(near) >= _MOSTLY else None


def usual_step(reference: FloatArray) -> float:
    """Return the step that is assumed of an encoder nobody has described: a millionth of the commanded travel."""
    return _OF_TRAVEL * (float(np.ptp(reference)) or 1.0)


def informations(problem: Problem, x: FloatArray, noise: Noise, motor_step: float, load_step: float) -> Informations:
    """Return what encoders would add (see the module).

    Args:
        problem: of the torque.
        x: (free,) its parameters.
        noise: where the torque's residual comes from.
        motor_step: of the encoder on the motor, m or rad.
        load_step: of that on the load.
    """
    found = problem.positions(x)
    names = [p.name for p in problem.free]
    motor, load = found.motor_position, found.load_position
    flexible = problem.loop.joint.model == "flexible"
    if noise == "loop":
        if flexible:
            load = _motor_prescribed(problem, problem.values(x), motor, load)
            load = load * np.array([_is_of_load(name) for name in names])
        motor = np.zeros_like(motor)
    return Informations(_of(motor, motor_step), _of(load, load_step) if flexible else None)


def with_information(covariance: FloatArray, information: FloatArray) -> FloatArray:
    """Return ``(covariance^-1 + information)^-1``, all (free, free); the covariance may be singular."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, 1.0)
    sizes, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    root = std[:, np.newaxis] * vectors * np.sqrt(np.maximum(sizes, 0.0))
    added = root.T @ information @ root
    return np.asarray(root @ np.linalg.solve(np.eye(std.size) + added, root.T))


def _of(columns: FloatArray, step: float) -> FloatArray:
    centred = columns - columns.mean(axis=0)
    return np.asarray(centred.T @ centred * 12.0 / step**2)


def _is_of_load(name: str) -> bool:
    """Whether a parameter stands in the load's own equation."""
    return name.startswith("load_") or name in ("stiffness", "damping")


def _motor_prescribed(problem: Problem, values: Mapping[str, float], motor: FloatArray, load: FloatArray) -> FloatArray:
    """Return the sensitivities of the load position with the motor's motion prescribed, (samples, free).

    ``ZZ2 a + (Fv2 + F12) v + K12 q = F12 v1 + K12 q1``: what the load does because the motor moved is subtracted. The
    motor is taken to move on a straight line between two samples, and the load not to stick.
    """
    from scipy.signal import cont2discrete, lfilter

    viscous = [value for name, value in values.items() if name.startswith("load_viscous")]
    drag = math.fsum(viscous) / len(viscous) + values["damping"]
    equation = np.array([values["load_inertia"], drag, values["stiffness"]])
    driven = np.array([values["damping"], values["stiffness"]])
    top, bottom, _ = cont2discrete((driven, equation), problem.experiment.sample_time, method="foh")
    return np.asarray(load - lfilter(np.ravel(top), bottom, motor, axis=0))
