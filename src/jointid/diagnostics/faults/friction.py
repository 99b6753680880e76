"""Faults of the friction: at low speed, wound up behind a reversal, growing with the load, changing over the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, Measure, Trial, words
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.seen import Columns, Seen
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
_AT_LOW_SPEED = (StribeckFriction.name, AsymmetricStribeckFriction.name)
_LOSS, _LOST = 0.03, 0.2  # of the load's torque, and of a friction at the end
_OF_LOAD = 1.0  # shape of a friction under load that is the load's; that of the motor has none
VISCOUS, COULOMB = 1.0, 0.0
"""Shapes of a friction that changes over the record."""


def _at_low_speed(sign: float, seen: Seen) -> Columns:
    """Yield a friction that is larger, or smaller, by ``S exp(-(v / vs)^2)``, for some vs."""
    if seen.loop is not None and isinstance(seen.loop[0].joint.friction, StribeckFriction | PreslidingFriction):
        return  # its own law has that
    for speed in (share * (seen.fastest or 1.0) for share in (*_SPEEDS, *([] if seen.loop else [2 * _SPEEDS[-1]]))):
        column = seen.force(-np.exp(-((seen.velocity / speed) ** 2)) * np.sign(seen.velocity))
        yield speed, None if column is None else sign * column


def _describe_stribeck(sense: str, finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    speed, size = f"{number(s.shape, 2)} {check.on_side('velocity')}", s.show_size(check.units["torque"], spread=spread)
    return words(f"towards standstill, below some {speed}, the friction is", size, f"{sense} than Coulomb's")


STRIBECK = Fault(
    "stribeck", "friction that rises towards standstill", describe=partial(_describe_stribeck, "larger"),
    columns=partial(_at_low_speed, 1.0), one_sided=True, kin="low-speed friction", measure=Measure.TORQUE,
    table="friction", laws=_AT_LOW_SPEED,
)  # fmt: skip
PRESLIDING = replace(
    STRIBECK, name="presliding", title="friction that falls towards standstill",
    describe=partial(_describe_stribeck, "smaller"), columns=partial(_at_low_speed, -1.0),
    laws=(PreslidingFriction.name, *_AT_LOW_SPEED),
)  # fmt: skip


def _along_travel(seen: Seen) -> Columns:
    """Yield a friction that changes over the travel, by 1 at most: by a line, half a wave and a whole one."""
    low, span = float(seen.position.min()), float(np.ptp(seen.position)) or 1.0
    way = 2.0 * (seen.position - low) / span - 1.0
    for shape, over in enumerate((way, np.cos(np.pi * way), np.sin(np.pi * way))):
        yield float(shape), seen.force(-np.sign(seen.velocity) * over)


def _describe_uneven(finding: Finding, check: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size(check.on_side("torque"), spread=spread)
    return words("the friction differs along the travel", size and f"by {size} either way")


UNEVEN_FRICTION = Fault(
    "uneven_friction", "friction that differs along the travel", describe=_describe_uneven, columns=_along_travel,
    mechanical=True, measure=Measure.TORQUE, reason=Reason.FORCE_FOLLOWS_POSITION,
)  # fmt: skip


def _winds_up(seen: Seen) -> Columns:
    """Yield a flexible joint's Coulomb friction as it winds up over some distances, less that which does not."""
    if not seen.is_flexible or not seen.has_linear_friction:
        return
    still, moves = np.sign(seen.velocity), np.diff(seen.position, prepend=seen.position[0])
    for distance in (share * float(np.ptp(seen.position)) for share in _DISTANCES):
        if distance > 0:
            yield distance, seen.force(-seen.friction("coulomb") * (_wind(moves / distance) - still))


def _wind(moves: FloatArray) -> FloatArray:
    """Return the share of Dahl's friction that is wound up after each move, (samples,), in winding distances."""
    wound, found = 0.0, np.empty(moves.size)
    for k, (way, left) in enumerate(zip(np.sign(moves).tolist(), np.exp(-np.abs(moves)).tolist(), strict=True)):
        wound = way + (wound - way) * left if way else wound
        found[k] = wound
    return found


WINDING_FRICTION = Fault(
    "winding_friction", "friction that winds up behind each reversal",
    describe=lambda finding, check, _: "friction winds up behind each reversal, over some "
    f"{number(finding.test.shape, 2)} {check.on_side('position')}",
    columns=_winds_up, mechanical=True, one_sided=True, kin="low-speed friction",
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(PreslidingFriction.name,),
)  # fmt: skip


def _under_load(seen: Seen) -> Columns:
    """Yield a friction that grows with the torque through the gear."""
    if seen.has_linear_friction:
        yield None, seen.force(-np.abs(seen.through) * np.sign(seen.velocity))


def _try_load_friction(joint: FlexibleJoint, _: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    """Yield the joint whose load has that friction."""
    law = LoadDependentFriction()
    if joint.friction == SymmetricFriction() and law in frictions_beside(joint):
        yield Trial(replace(joint, friction=law), {**values, "load_friction_per_torque": _LOSS}, _LOSS, _OF_LOAD)


def _describe_load_friction(finding: Finding, _: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size("%", spread=spread, factor=100.0)
    return "the friction grows with the load's torque" + (f", by {size} of it" if size else "")


LOAD_DEPENDENT_FRICTION = Fault(
    "load_dependent_friction", "friction that grows with the load's torque", describe=_describe_load_friction,
    columns=_under_load, trials=_try_load_friction, mechanical=True, one_sided=True, measure=Measure.SHARE,
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(LoadDependentFriction.name,),
)  # fmt: skip


def _over_time(seen: Seen) -> Columns:
    """Yield friction that falls over the record, by one unit at its end."""
    gone = np.linspace(0.0, 1.0, seen.velocity.size)
    if seen.loop is None:
        yield VISCOUS, seen.force(gone * seen.velocity)
        yield COULOMB, seen.force(gone * np.sign(seen.velocity))


def _try_changing(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    """Yield the joint whose friction of one part falls by a share on both sides."""
    law, duration = DriftingFriction(), run.sample_time * run.torque.size
    if joint.friction == SymmetricFriction() and law in frictions_beside(joint):
        other = replace(joint, friction=law)
        still = {p.name: 0.0 for p in other.parameters if p.name.endswith("_drift")}
        for part, shape in zip(PARTS, (VISCOUS, COULOMB), strict=True):
            falls = {f"{side}{part}_drift": -_LOST * values[f"{side}{part}"] / duration for side in ("motor_", "load_")}
            yield Trial(other, {**values, **still, **falls}, _LOST, shape)


def _describe_changing(finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    kind, way = "Coulomb" if s.shape == COULOMB else "viscous", "falls" if s.size > 0 else "rises"
    size = s.show_size("%", spread=spread, factor=100.0) if check.of_loop else ""  # along a motion it is no share
    return f"the {kind} friction {way} over the record" + (f", by {size}" if size else "")


CHANGING_FRICTION = Fault(
    "changing_friction", "friction that changes over the record", describe=_describe_changing, columns=_over_time,
    trials=_try_changing, mechanical=True, measure=Measure.SHARE, reason=Reason.FRICTION_NOT_AS_MODELLED,
    table="friction", laws=(DriftingFriction.name,),
)  # fmt: skip


def _by_direction(seen: Seen) -> Columns:
    if seen.loop is None:
        yield None, seen.force(-np.abs(seen.velocity))


ASYMMETRIC_FRICTION = Fault(
    "asymmetric_friction", "friction that differs by direction", columns=_by_direction, mechanical=True,
    describe=lambda finding, *_: "the viscous friction is "
    f"{'larger' if finding.test.size > 0 else 'smaller'} forwards than backwards",
    reason=Reason.FRICTION_NOT_AS_MODELLED, table="friction", laws=(AsymmetricFriction.name,),
)  # fmt: skip
FAULTS = (
    STRIBECK, PRESLIDING, UNEVEN_FRICTION, WINDING_FRICTION, LOAD_DEPENDENT_FRICTION, CHANGING_FRICTION,
    ASYMMETRIC_FRICTION,
)  # fmt: skip
