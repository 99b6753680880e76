"""Position encoders beside the torque of a test, for the prediction of its intervals.

Position encoders add information to that of the torque, from the exact sensitivities of the positions. An encoder adds
its sensitivities g, weighted by the spectrum S of its errors, to the information of an estimate, the inverse of its
covariance P::

    P1 = (P^-1 + sum_f g(f)* g(f)' / S(f))^-1

The mean of every column of g is left out, because an encoder's zero is not known. g and S depend on the source of the
torque residual, which a record does not tell: in the loop is assumed, the wider interval, where nobody says it.

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
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.loop_input import to_log
from jointid.uncertainty.covariance import smoothed_spectrum, sum_over_frequencies

Source: TypeAlias = Literal["loop", "log"]
"""Of the torque's noise."""


def encoder_information(
    problem: ClosedLoopProblem, x: FloatArray, source: Source, steps: tuple[float | None, float | None]
) -> FloatArray:
    """Return the information of encoders, (free, free) (see the module).

    Args:
        problem: of the torque.
        x: (free,) its parameters.
        source: of the torque residual.
        steps: of an encoder on the motor and of one on the load, m or rad; None without it, and not read of a rigid
            joint's load.
    """
    found, (on_motor, on_load) = problem.positions(x), steps
    motor, load = found.motor_position, found.load_position
    flexible, nothing = problem.loop.joint.model == "flexible", np.zeros((x.size, x.size))
    on_load = on_load if flexible else None
    if source == "log":
        read = [(motor, on_motor), (load, on_load)]
        return sum((_inform(columns, np.zeros(len(columns)), step) for columns, step in read if step), nothing)
    left = _simulate_load_error(problem, x) if on_load else None
    if left is None or on_load is None:
        return nothing
    of_load = [p.name.startswith("load_") or p.name in ("stiffness", "damping") for p in problem.free]
    own = subtract_driven_motion(problem, x, motor, load) * np.array(of_load)  # in the load's equation of motion
    return _inform(own, left, on_load)


def _inform(columns: FloatArray, left: FloatArray, step: float) -> FloatArray:
    """Return the information, (free, free), of a position: its sensitivities by the inverse of its errors' spectrum.

    `left`, (samples,), is an example of its errors beside rounding. The mean of the columns weighs nothing.
    """
    spectrum, both = smoothed_spectrum(left, left.size)
    weights = both / ((spectrum + step**2 / 12.0) * left.size)
    return sum_over_frequencies(columns, np.concatenate([[0.0], weights]))


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


def _simulate_load_error(problem: ClosedLoopProblem, x: FloatArray) -> FloatArray | None:
    """Return the load's response to a force that explains the torque residual, less the motion driven by the motor.

    The white force acts on the motor, scaled so that the filtered torque changes by the norm of the residual. None if
    the loop cannot be simulated with it.
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
            change = run.torque - quiet.torque - to_log(experiment, forced.shown - experiment.shown)
            size *= wanted / float(np.linalg.norm(problem.filter(change)))
    assert run.load_position is not None
    assert quiet.load_position is not None
    motor = run.motor_position - quiet.motor_position
    return subtract_driven_motion(problem, x, motor, run.load_position - quiet.load_position)
