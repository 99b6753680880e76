"""Information that position encoders add to that of the torque, from the exact sensitivities of the positions.

An encoder adds its sensitivities g, weighted by the spectrum S of its errors, to the information of an estimate, the
inverse of its covariance P::

    P1 = (P^-1 + sum_f g(f)* g(f)' / S(f))^-1

The mean of every column of g is left out, because an encoder's zero is not known. g and S depend on the source of the
torque residual:

- **on the log**: a measured current has noise of its own, independent of the positions; g is the sensitivity f of the
  position, S the variance of rounding to the encoder's steps, ``step^2 / 12``.
- **in the loop**: the log is the controller's output, exact, and an unknown force acts on the motor. Its answers in
  torque T_u and positions T_m, T_l are those of one force, so that the covariance of what is logged is
  ``T T* S_d + diag(0, R_m, R_l)``. Inverted, that is the information of the torque alone, plus that of the part which
  torque does not explain, ``g = f - (T / T_u) f_u``. The motor position is the input of the controller: the torque
  determines it without error, g = 0, and a motor encoder adds nothing. The equations from motor to load do not contain
  the force, so g is the sensitivity of the load position with the motor's motion prescribed, ``f_l - H f_m`` with H the
  load's answer to the motor while it slides, and 0 for all parameters of the motor's side.

  Rounding alone would promise the load's parameters 30 times better than IDIM by instruments reaches: between two
  samples the motor's motion is not known, and at its reversals the load does not slide. So a force that explains the
  residual is applied to the simulated loop, and the spectrum of the load's response that H does not explain is added
  to S.

An encoder is read whenever the torque is logged. The ratio T / T_u is not measured from simulated runs: an error of 1 %
in it would count as information, because an encoder's steps are that small beside the motion that a controller allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.loop_input import as_logged

Noise: TypeAlias = Literal["loop", "log"]

_OF_TRAVEL = 1e-6  # of the commanded travel: the step assumed of an unknown encoder


@dataclass(frozen=True, slots=True, eq=False)
class EncoderInformation:
    """Information of one encoder each, (free, free), in the inverse squares of the parameters' units.

    Attributes:
        motor: of an encoder on the motor.
        load: of one on the load; None for a rigid joint.
    """

    motor: FloatArray
    load: FloatArray | None


def assume_encoder_step(reference: FloatArray) -> float:
    """Return the step assumed of an unknown encoder: a millionth of the commanded travel."""
    return _OF_TRAVEL * (float(np.ptp(reference)) or 1.0)


def compute_encoder_information(
    problem: ClosedLoopProblem, x: FloatArray, noise: Noise, motor_step: float, load_step: float
) -> EncoderInformation:
    """Return the information of encoders (see the module).

    Args:
        problem: of the torque.
        x: (free,) its parameters.
        noise: source of the torque residual.
        motor_step: of the encoder on the motor, m or rad.
        load_step: of that on the load.
    """
    found = problem.positions(x)
    motor, load = found.motor_position, found.load_position
    flexible = problem.loop.joint.model == "flexible"
    if noise == "log":
        rounding = np.zeros(len(motor))
        on_load = compute_position_information(load, rounding, load_step) if flexible else None
        return EncoderInformation(compute_position_information(motor, rounding, motor_step), on_load)
    nothing = np.zeros((x.size, x.size))
    if not flexible:
        return EncoderInformation(nothing, None)
    left = _simulate_load_error(problem, x)
    own = subtract_driven_motion(problem, x, motor, load) * np.array([_acts_on_load(p.name) for p in problem.free])
    return EncoderInformation(nothing, nothing if left is None else compute_position_information(own, left, load_step))


def compute_position_information(columns: FloatArray, left: FloatArray, step: float) -> FloatArray:
    """Return the information, (free, free), of a position.

    Args:
        columns: (samples, free) its sensitivities.
        left: (samples,) an example of its errors beside rounding.
        step: of the encoder.
    """
    weights = weigh_frequencies(left, step)
    spectra = np.fft.rfft(columns, axis=0)
    return np.asarray(np.real((weights[:, np.newaxis] * spectra.conj()).T @ spectra))


def weigh_frequencies(left: FloatArray, step: float) -> FloatArray:
    """Return the weight of every frequency of a position, (samples // 2 + 1,): the inverse of its errors' spectrum.

    The periodogram is averaged over sqrt(samples) neighbours. The mean weighs nothing.
    """
    count = left.size
    half = math.isqrt(count) // 2
    padded = np.pad(np.abs(np.fft.rfft(left)[1:]) ** 2 / count, half, "reflect")
    spectrum = np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid") + step**2 / 12.0
    both = np.full(spectrum.size, 2.0)  # half a spectrum: all but the last of an even number stand for two
    both[-1] = 2.0 if count % 2 else 1.0
    return np.concatenate([[0.0], both / (spectrum * count)])


def add_information(covariance: FloatArray, information: FloatArray) -> FloatArray:
    """Return ``(covariance^-1 + information)^-1``, all (free, free); the covariance may be singular."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, 1.0)
    sizes, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    root = std[:, np.newaxis] * vectors * np.sqrt(np.maximum(sizes, 0.0))
    added = root.T @ information @ root
    return np.asarray(root @ np.linalg.solve(np.eye(std.size) + added, root.T))


def subtract_driven_motion(
    problem: ClosedLoopProblem, x: FloatArray, motor: FloatArray, load: FloatArray
) -> FloatArray:
    """Return the load's motion less that driven by the motor, ``load - H motor``, (samples, ...) as given.

    ``ZZ2 a + (Fv2 + F12) v + K12 q = F12 v1 + K12 q1``, the load sliding, the motor on a straight line between two
    samples.
    """
    from scipy.signal import cont2discrete, lfilter

    values = problem.values(x)
    viscous = [value for name, value in values.items() if name.startswith("load_viscous")]
    drag = math.fsum(viscous) / len(viscous) + values["damping"]
    equation = np.array([values["load_inertia"], drag, values["stiffness"]])
    driven = np.array([values["damping"], values["stiffness"]])
    top, bottom, _ = cont2discrete((driven, equation), problem.experiment.sample_time, method="foh")
    return np.asarray(load - lfilter(np.ravel(top), bottom, motor, axis=0))


def _acts_on_load(name: str) -> bool:
    """True if a parameter is in the load's equation of motion."""
    return name.startswith("load_") or name in ("stiffness", "damping")


def _simulate_load_error(problem: ClosedLoopProblem, x: FloatArray) -> FloatArray | None:
    """Return what the motor's motion leaves of the load's answer to a force that explains the torque's residual.

    The force is white and acts on the motor, scaled so that the filtered torque changes by as much as the residual.
    None where the loop cannot be simulated under it.
    """
    experiment = problem.experiment
    quiet = problem.simulate(x)
    white = np.random.default_rng(0).standard_normal(experiment.after_limit.size)
    wanted, size = float(np.linalg.norm(problem.error(quiet))), 1.0
    for attempt in range(3):  # the response is almost linear: two proportional steps, then the run itself
        forced = replace(experiment, after_limit=experiment.after_limit + size * white)
        run = replace(problem, experiment=forced).simulate(x)
        if run.outcome is not Outcome.FINISHED:
            return None
        if attempt < 2:
            change = run.torque - quiet.torque - as_logged(experiment, forced.shown - experiment.shown)
            size *= wanted / float(np.linalg.norm(problem.filtered(change)))
    assert run.load_position is not None
    assert quiet.load_position is not None
    motor = run.motor_position - quiet.motor_position
    return subtract_driven_motion(problem, x, motor, run.load_position - quiet.load_position)
