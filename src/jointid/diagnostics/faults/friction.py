"""Faults of the friction: at low speed, wound up behind a reversal, growing with the load, changing over the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, FaultSignature, Measure, words
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.faults.trials import Trial
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import (
    PARTS,
    AsymmetricStribeckFriction,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    StribeckFriction,
    SymmetricFriction,
)
from jointid.models.joints import FlexibleJoint, frictions_beside
from jointid.records.record import Tap
from jointid.simulation.closed_loop import Simulation
from jointid.simulation.loop_input import to_log
from jointid.uncertainty.verdict import Reason

_SPEEDS = (0.02, 0.04, 0.08)  # of the largest speed: the Stribeck speeds that are tried
_FORCE = 1e-3  # of the largest torque: small enough for the friction to answer it linearly
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
    if velocity.size != problem.experiment.after_limit.size:
        return  # a force at the controller's instants needs the motion there
    small = _FORCE * float(np.max(np.abs(problem.measured)))

    def simulate(force: FloatArray) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=e.after_limit + force))

    for share in _SPEEDS:
        speed = share * float(np.max(np.abs(velocity), initial=0.0))
        if speed > 0:
            force = -np.exp(-((velocity / speed) ** 2)) * np.sign(velocity)
            raw = (simulate(small * force) - simulate(-small * force)) / (2 * small)
            if problem.experiment.tap is Tap.MEASURED:
                raw = raw - to_log(problem.experiment, force)  # the force itself is not logged
            column = problem.filter(raw)
            yield FaultSignature(STRIBECK, column, speed, raw)
            yield FaultSignature(PRESLIDING, -column, speed, -raw)


def _describe_stribeck(sense: str, finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    speed, size = f"{number(s.shape, 2)} {check.on_side('velocity')}", s.show_size(check.units["torque"], spread=spread)
    return words(f"towards standstill, below some {speed}, the friction is", size, f"{sense} than Coulomb's")


STRIBECK = Fault(
    "stribeck", "friction that rises towards standstill", describe=partial(_describe_stribeck, "larger"),
    vary=_vary_stribeck, one_sided=True, kin="low-speed friction", measure=Measure.TORQUE, table="friction",
    laws=_AT_LOW_SPEED,
)  # fmt: skip
PRESLIDING = replace(
    STRIBECK, name="presliding", title="friction that falls towards standstill",
    describe=partial(_describe_stribeck, "smaller"), laws=(PreslidingFriction.name, *_AT_LOW_SPEED),
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


WINDING_FRICTION = Fault(
    "winding_friction", "friction that winds up behind each reversal",
    describe=lambda finding, check, _: "friction winds up behind each reversal, over some "
    f"{number(finding.test.shape, 2)} {check.on_side('position')}",
    try_mechanics=_try_winding, mechanical=True, one_sided=True, kin="low-speed friction",
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(PreslidingFriction.name,),
)  # fmt: skip


def _try_load_friction(joint: FlexibleJoint, _: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    law = LoadDependentFriction()
    if joint.friction.linear and law in frictions_beside(joint):
        other, still, without = _beside_lines(joint, law, values)
        grows = still | {"load_friction_per_torque": _LOSS}
        yield Trial(LOAD_DEPENDENT_FRICTION, other, grows, _LOSS, without=without)


def _describe_load_friction(finding: Finding, _: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size("%", spread=spread, factor=100.0)
    return "the load's friction grows with its torque" + (f", by {size} of it" if size else "")


LOAD_DEPENDENT_FRICTION = Fault(
    "load_dependent_friction", "friction that grows with the load's torque", describe=_describe_load_friction,
    try_mechanics=_try_load_friction, mechanical=True, one_sided=True, measure=Measure.SHARE,
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(LoadDependentFriction.name,),
)  # fmt: skip


def _try_changing(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    duration, law = run.sample_time * run.torque.size, DriftingFriction()
    if joint.friction.linear and law in frictions_beside(joint):
        other, still, without = _beside_lines(joint, law, values)
        for part, shape in zip(PARTS, (VISCOUS, COULOMB), strict=True):
            falls = {f"{side}{part}_drift": -_LOST * still[f"{side}{part}"] / duration for side in _SIDES}
            yield Trial(CHANGING_FRICTION, other, still | falls, _LOST, shape, without)


def _describe_changing(finding: Finding, _: AxisFaults, spread: bool) -> str:
    s = finding.test
    kind, way = "Coulomb" if s.shape == COULOMB else "viscous", "falls" if s.size > 0 else "rises"
    size = s.show_size("%", spread=spread, factor=100.0)
    return f"the {kind} friction {way} over the record" + (f", by {size}" if size else "")


CHANGING_FRICTION = Fault(
    "changing_friction", "friction that changes over the record", describe=_describe_changing,
    try_mechanics=_try_changing, mechanical=True, measure=Measure.SHARE, reason=Reason.FRICTION_NOT_AS_MODELLED,
    table="friction", laws=(DriftingFriction.name,),
)  # fmt: skip

FAULTS = (STRIBECK, PRESLIDING, WINDING_FRICTION, LOAD_DEPENDENT_FRICTION, CHANGING_FRICTION)
