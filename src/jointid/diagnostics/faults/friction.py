"""Faults of the friction: at low speed, wound up behind a reversal, growing with the load, changing over the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.diagnostics.faults.fault import AxisMotion, Fault, FaultSignature, Hint, Measure, words
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.faults.trials import Trial, respond_to_force, search_stiffer
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import (
    PARTS,
    AsymmetricFriction,
    AsymmetricStribeckFriction,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    StribeckFriction,
    SymmetricFriction,
)
from jointid.models.joints import FlexibleJoint, frictions_beside
from jointid.simulation.closed_loop import Simulation
from jointid.uncertainty.verdict import Reason

_SPEEDS = (0.02, 0.04, 0.08)  # of the largest speed: the Stribeck speeds that are tried
_DISTANCES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)  # of the travel, over which friction winds up
_LOSS, _LOST = 0.03, 0.2  # of the load's torque, and of a friction at the end
_SIDES = ("motor_", "load_")
_AT_LOW_SPEED = (StribeckFriction.name, AsymmetricStribeckFriction.name)
VISCOUS, COULOMB = 1.0, 0.0
"""Shapes of a friction that changes over the record."""


def _vary_stribeck(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a larger, or smaller, friction at low speed.

    The motor's friction is larger by ``S exp(-(v / vs)^2)``, for some vs: a force in the loop.
    """
    if isinstance(problem.joint.friction, StribeckFriction | PreslidingFriction):  # its own law has that
        return
    velocity = problem.simulate(x).motor_velocity
    for share in _SPEEDS:
        speed = share * float(np.max(np.abs(velocity), initial=0.0))
        if speed > 0:
            force = -np.exp(-((velocity / speed) ** 2)) * np.sign(velocity)
            for raw in respond_to_force(problem, x, force):
                column = problem.filter(raw)
                yield FaultSignature(STRIBECK, column, speed, raw)
                yield FaultSignature(PRESLIDING, -column, speed, -raw)


def _along_stribeck(motion: AxisMotion) -> Iterator[FaultSignature]:
    """Yield the friction that is larger, or smaller, at low speed."""
    for share in (*_SPEEDS, 2 * _SPEEDS[-1]):
        speed = share * float(np.max(np.abs(motion.velocity))) or 1.0
        column = np.exp(-((motion.velocity / speed) ** 2)) * np.sign(motion.velocity)
        yield FaultSignature(STRIBECK, column, speed)
        yield FaultSignature(PRESLIDING, -column, speed)


def _along_load(motion: AxisMotion) -> Iterator[FaultSignature]:
    yield FaultSignature(LOAD_DEPENDENT_FRICTION, np.sign(motion.velocity) * np.abs(motion.torque))


def _along_direction(motion: AxisMotion) -> Iterator[FaultSignature]:
    yield FaultSignature(ASYMMETRIC_FRICTION, np.abs(motion.velocity))


def _describe_stribeck(sense: str, finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    speed, size = f"{number(s.shape, 2)} {check.on_side('velocity')}", s.show_size(check.units["torque"], spread=spread)
    return words(f"towards standstill, below some {speed}, the friction is", size, f"{sense} than Coulomb's")


STRIBECK = Fault(
    "stribeck", "friction that rises towards standstill", describe=partial(_describe_stribeck, "larger"),
    vary=_vary_stribeck, along=_along_stribeck, one_sided=True, kin="low-speed friction", measure=Measure.TORQUE,
    table="friction",
    laws=_AT_LOW_SPEED,
)  # fmt: skip
PRESLIDING = replace(
    STRIBECK, name="presliding", title="friction that falls towards standstill",
    describe=partial(_describe_stribeck, "smaller"), laws=(PreslidingFriction.name, *_AT_LOW_SPEED),
)  # fmt: skip


def _vary_along_travel(position: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Yield shapes over the travel, of at most 1, and the number of each: a line, half a wave and a whole one."""
    low, span = float(position.min()), float(np.ptp(position)) or 1.0
    way = 2.0 * (position - low) / span - 1.0
    for shape, over in enumerate((way, np.cos(np.pi * way), np.sin(np.pi * way))):
        yield float(shape), over


def _vary_uneven(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    run = problem.simulate(x)
    for shape, over in _vary_along_travel(run.motor_position):
        for raw in respond_to_force(problem, x, -np.sign(run.motor_velocity) * over):
            yield FaultSignature(UNEVEN_FRICTION, problem.filter(raw), shape, raw)


def _along_uneven(motion: AxisMotion) -> Iterator[FaultSignature]:
    for shape, over in _vary_along_travel(motion.position):
        yield FaultSignature(UNEVEN_FRICTION, np.sign(motion.velocity) * over, shape)


def _describe_uneven(finding: Finding, check: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size(check.on_side("torque"), spread=spread)
    return words("the friction differs along the travel", size and f"by {size} either way")


UNEVEN_FRICTION = Fault(
    "uneven_friction", "friction that differs along the travel", describe=_describe_uneven, vary=_vary_uneven,
    along=_along_uneven, mechanical=True, measure=Measure.TORQUE, reason=Reason.FORCE_FOLLOWS_POSITION,
)  # fmt: skip


def _beside_lines(
    joint: FlexibleJoint,
    law: DriftingFriction | LoadDependentFriction | PreslidingFriction,
    values: Mapping[str, float],
) -> tuple[FlexibleJoint, dict[str, float], dict[str, float] | None]:
    """Return the joint with a law of friction, the values without its effect, and those of `Trial.without`."""
    other = replace(joint, friction=law)
    still = {  # means of both directions
        f"{side}{part}": sum(by * values[name] for name, by in joint.friction.mean(part, side).items())
        for part, side in product(PARTS, _SIDES)
    }
    still |= {p.name: 0.0 for p in other.parameters if p.name.endswith(("_drift", "_per_torque"))}
    return other, still, None if joint.friction == SymmetricFriction() else still


def _try_winding(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    law, travel = PreslidingFriction(), float(np.ptp(run.motor_position))
    if joint.friction.linear and law in frictions_beside(joint):
        other, still, without = _beside_lines(joint, law, values)
        for share in _DISTANCES:
            distances = {f"{side}presliding_distance": share * travel for side in _SIDES}
            yield Trial(WINDING_FRICTION, other, still | distances, 1.0, share * travel, without)


def _search_winding(problem: ClosedLoopProblem, x: FloatArray, hint: Hint) -> list[FaultSignature]:
    """Return the signature of friction that winds up beside a far stiffer spring, if the loop has any other fault.

    Where friction winds up further than the spring, the joint without it is as soft as that friction. No friction
    beside that soft spring leaves this minimum.
    """
    if hint.first in (None, WINDING_FRICTION):
        return []
    end = search_stiffer(problem, x, WINDING_FRICTION)
    if end is None:
        return []
    distance = max(end.values[f"{side}presliding_distance"] for side in _SIDES)
    return [FaultSignature(WINDING_FRICTION, problem.filter(end.change), distance, end.change, len(_DISTANCES))]


WINDING_FRICTION = Fault(
    "winding_friction", "friction that winds up behind each reversal",
    describe=lambda finding, check, _: "friction winds up behind each reversal, over some "
    f"{number(finding.test.shape, 2)} {check.on_side('position')}",
    try_mechanics=_try_winding, search=_search_winding, softens=True, mechanical=True, one_sided=True,
    kin="low-speed friction", reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(PreslidingFriction.name,),
)  # fmt: skip


def _try_load_friction(joint: FlexibleJoint, _: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    law = LoadDependentFriction()
    if joint.friction.linear and law in frictions_beside(joint):
        other, still, without = _beside_lines(joint, law, values)
        grows = still | {"load_friction_per_torque": _LOSS}
        yield Trial(LOAD_DEPENDENT_FRICTION, other, grows, _LOSS, without=without)


def _vary_load_friction(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signature of a motor's friction that grows with the torque through the spring, or of a rigid joint."""
    joint, run, values = problem.joint, problem.simulate(x), problem.values(x)
    if not joint.friction.linear:
        return
    fault, through = LOAD_DEPENDENT_FRICTION, run.push
    if isinstance(joint, FlexibleJoint):
        assert run.load_position is not None and run.load_velocity is not None
        wound, rate = run.motor_position - run.load_position, run.motor_velocity - run.load_velocity
        fault, through = MOTOR_LOAD_FRICTION, joint.spring.torque(values, wound, rate)
    for raw in respond_to_force(problem, x, -np.abs(through) * np.sign(run.motor_velocity)):
        yield FaultSignature(fault, problem.filter(raw), raw=raw)


def _describe_load_friction(said: str, finding: Finding, _: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size("%", spread=spread, factor=100.0)
    return said + (f", by {size} of it" if size else "")


LOAD_DEPENDENT_FRICTION = Fault(
    "load_dependent_friction", "friction that grows with the load's torque",
    describe=partial(_describe_load_friction, "the load's friction grows with its torque"),
    try_mechanics=_try_load_friction, vary=_vary_load_friction, along=_along_load, mechanical=True, one_sided=True,
    kin="load friction", measure=Measure.SHARE,
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(LoadDependentFriction.name,),
)  # fmt: skip
MOTOR_LOAD_FRICTION = Fault(
    "motor_load_friction", "motor friction that grows with the load's torque",
    describe=partial(_describe_load_friction, "the motor's friction grows with the load's torque"),
    vary=_vary_load_friction, mechanical=True, one_sided=True, kin="load friction", measure=Measure.SHARE,
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(LoadDependentFriction.name,),
)  # fmt: skip


def _try_changing(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    duration, law = run.sample_time * run.torque.size, DriftingFriction()
    if joint.friction.linear and law in frictions_beside(joint):
        other, still, without = _beside_lines(joint, law, values)
        for part, shape in zip(PARTS, (VISCOUS, COULOMB), strict=True):
            falls = {f"{side}{part}_drift": -_LOST * still[f"{side}{part}"] / duration for side in _SIDES}
            yield Trial(CHANGING_FRICTION, other, still | falls, _LOST, shape, without)


def _along_time(motion: AxisMotion) -> Iterator[FaultSignature]:
    """Yield friction that falls over the record, by one unit at its end."""
    gone = np.linspace(0.0, 1.0, motion.velocity.size)
    for shape, column in ((VISCOUS, motion.velocity), (COULOMB, np.sign(motion.velocity))):
        yield FaultSignature(CHANGING_FRICTION, -gone * column, shape)


def _describe_changing(finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    kind, way = "Coulomb" if s.shape == COULOMB else "viscous", "falls" if s.size > 0 else "rises"
    size = s.show_size("%", spread=spread, factor=100.0) if check.of_loop else ""  # along a motion it is no share
    return f"the {kind} friction {way} over the record" + (f", by {size}" if size else "")


CHANGING_FRICTION = Fault(
    "changing_friction", "friction that changes over the record", describe=_describe_changing,
    try_mechanics=_try_changing, along=_along_time, mechanical=True, measure=Measure.SHARE,
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(DriftingFriction.name,),
)  # fmt: skip

ASYMMETRIC_FRICTION = Fault(
    "asymmetric_friction", "friction that differs by direction", along=_along_direction, mechanical=True,
    describe=lambda finding, *_: "the viscous friction is "
    f"{'larger' if finding.test.size > 0 else 'smaller'} forwards than backwards",
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(AsymmetricFriction.name,),
)  # fmt: skip
FAULTS = (
    STRIBECK, PRESLIDING, UNEVEN_FRICTION, WINDING_FRICTION, LOAD_DEPENDENT_FRICTION, MOTOR_LOAD_FRICTION,
    CHANGING_FRICTION, ASYMMETRIC_FRICTION,
)  # fmt: skip
