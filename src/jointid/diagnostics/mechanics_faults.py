"""Signatures of what a flexible joint has and its model has not: in the spring, behind the load, in the friction.

Each is a pair of forces that the simulated motion would draw out, on the motor and on the load, per unit of its size:

- ``cubic_spring``: the spring is stiffer by this share at the largest wind-up ``d``, as the square of it:
  ``K d (d / d_max)^2``;
- ``backlash``: the spring pushes only behind a gap, whose half is a share of the largest wind-up that is tried; the
  size says how many such gaps;
- ``load_dependent_friction``: the load's friction grows by this share of the torque that drives it;
- ``changing_friction``: this share of the viscous, or of the Coulomb, friction is lost between the first sample and the
  last.

The load is a filter of the force on it: where it slides, a force pair ``(f1, f2)`` moves the motor as the force
``f1 + G f2`` on the motor alone, with ``G = (F12 s + K12) / (M2 s^2 + (F12 + Fv2) s + K12)``. It is that force that the
loop is simulated with, small, so that no mechanism is simulated anew. While the load rests it is not exact. How a large
fault moves the motion, and the parameters that make up for it, is of second order: the test is as sharp as those of the
loop, but of a gap a fourth to all was told in seven drives, of a spring 38 % stiffer 11 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.diagnostics.fault_signature import FaultSignature
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import LoadDependentFriction, Part
from jointid.models.joints import FlexibleJoint
from jointid.records.record import Tap
from jointid.simulation.closed_loop import Simulation
from jointid.simulation.loop_input import as_logged

CUBIC_SPRING, BACKLASH = "cubic_spring", "backlash"
LOAD_DEPENDENT_FRICTION, CHANGING_FRICTION = "load_dependent_friction", "changing_friction"
MECHANICS = (CUBIC_SPRING, BACKLASH, LOAD_DEPENDENT_FRICTION, CHANGING_FRICTION)
ONE_SIDED = (BACKLASH, LOAD_DEPENDENT_FRICTION)  # their size can only be positive

VISCOUS, COULOMB = 1.0, 0.0  # shapes of a friction that changes

_SIDES = ("motor", "load")
_GAPS = (0.1, 0.3)  # of the largest wind-up, to each side
_FORCE = 1e-3  # of the largest torque: small enough for the friction to answer it linearly


def vary_mechanics(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a flexible joint's mechanics; none of a rigid one."""
    run, values = problem.simulate(x), problem.values(x)
    if run.load_position is None or run.torque.size != problem.experiment.after_limit.size:
        return  # a force at the controller's instants needs the motion there
    joint = problem.joint
    assert isinstance(joint, FlexibleJoint)
    base, largest = problem.torque(x), float(np.max(np.abs(problem.measured)))
    viscous = sum(weight * values[name] for name, weight in joint.friction.mean("viscous", "load_").items())
    for name, shape, on_motor, on_load in _forces(run, values, joint):
        force = on_motor + _through_the_spring(on_load, values, viscous, problem.sample_time)
        small = _FORCE * largest / float(np.max(np.abs(force), initial=np.finfo(float).tiny))
        raw = (_with_force(problem, x, small * force) - base) / small
        if problem.experiment.tap is Tap.MEASURED:
            raw = raw - as_logged(problem.experiment, force)  # the force itself is not logged
        yield FaultSignature(name, problem.filtered(raw), shape, raw)


def _forces(
    run: Simulation, values: Mapping[str, float], joint: FlexibleJoint
) -> Iterator[tuple[str, float | None, FloatArray, FloatArray]]:
    """Yield name, shape, and the forces on motor and load, (samples,) each, per unit of every fault's size."""
    assert run.load_position is not None and run.load_velocity is not None
    windup, spring = run.motor_position - run.load_position, joint.spring
    torque, largest = spring.torque(values, windup, np.zeros_like(windup)), float(np.max(np.abs(windup)))
    if not (largest > 0 and values["stiffness"] > 0 and values["load_inertia"] > 0):
        return
    by_cube = torque * (windup / largest) ** 2
    if spring.linear:
        yield CUBIC_SPRING, None, -by_cube, by_cube
    for share in _GAPS if spring.linear else ():
        missing = values["stiffness"] * np.clip(windup, -share * largest, share * largest)
        yield BACKLASH, share * largest, missing, -missing
    if not isinstance(joint.friction, LoadDependentFriction):
        yield LOAD_DEPENDENT_FRICTION, None, np.zeros_like(torque), -np.abs(torque) * np.sign(run.load_velocity)
    if joint.friction.follows_time:
        return
    late, speeds = run.time / run.time[-1], (run.motor_velocity, run.load_velocity)
    shapes: dict[Part, float] = {"viscous": VISCOUS, "coulomb": COULOMB}
    for part, shape in shapes.items():
        motor, load = (
            late * _friction(joint, values, f"{side}_", part, speed) for side, speed in zip(_SIDES, speeds, strict=True)
        )
        yield CHANGING_FRICTION, shape, motor, load


def _friction(
    joint: FlexibleJoint, values: Mapping[str, float], prefix: str, part: Part, velocity: FloatArray
) -> FloatArray:
    """Return the viscous or the Coulomb friction of one side, (samples,), without what it has at low speed alone."""
    coefficients, columns = joint.friction.coefficients, joint.friction.columns(velocity)
    own = [values[prefix + c.name] if c.part == part else 0.0 for c in coefficients]
    return np.asarray(columns @ np.array(own))


def _through_the_spring(
    force: FloatArray, values: Mapping[str, float], viscous: float, sample_time: float
) -> FloatArray:
    """Return what of a force on a sliding load, (samples,), the motor feels."""
    from scipy.signal import bilinear, lfilter

    k, c = values["stiffness"], values["damping"]
    load, passed = np.array([values["load_inertia"], c + viscous, k]), np.array([c, k])
    share = values.get("swinging_share", 0.0)
    if share > 0.0:  # a part of the load follows the rest through a spring of its own
        second = [values["swinging_damping"], values["swinging_stiffness"]]
        swings = [share * values["load_inertia"], *second]
        rest = load - [share * values["load_inertia"], 0.0, 0.0]
        load = np.polyadd(np.polymul(rest, swings), np.polymul([swings[0], 0.0, 0.0], second))
        passed = np.polymul(passed, swings)
    return np.asarray(lfilter(*bilinear(passed, load, 1.0 / sample_time), force))


def _with_force(problem: ClosedLoopProblem, x: FloatArray, force: FloatArray) -> FloatArray:
    """Return the torque with a force on the motor, (samples,), which acts when the motion draws it out.

    It is held over each period, at its mean there, and is not delayed as the controller's torque is.
    """
    early = int(np.min(problem.experiment.lags))
    later = np.concatenate([force[early:], np.full(early + 1, force[-1])])
    mean = 0.5 * (later[:-1] + later[1:])
    return problem.torque(x, lambda e: replace(e, after_limit=e.after_limit + mean))
