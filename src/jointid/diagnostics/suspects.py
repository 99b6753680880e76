"""The table of suspects: what may be wrong with an axis of a joint or a robot, each a row, in the order of the tests.

To add one, write what a unit of it adds to the torque of the axis (`Fault.columns`), and its row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.common.parallel import in_threads
from jointid.diagnostics.faults import Fault, FaultSignature, name_number
from jointid.diagnostics.score import fit_whitener
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.result.verdict import Reason
from jointid.models.friction import PARTS, Friction
from jointid.models.joints import FlexibleJoint
from jointid.models.springs import Spring, swinging_part

_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the largest torque the law asks for: the limits that are tried
_HANGS = (0.0, 0.25 * np.pi, 0.5 * np.pi, 0.75 * np.pi)  # rad: the lowest place of a load, or the highest
_SAGS = (1.0, 2.0)  # powers of the torque, by which the torque constant may fall
_LEAST_SAG = 0.04  # of the torque at the peak: to so much a torque constant is known to be one
_WAVES = 4  # periods in the travel
_SPEEDS = (0.02, 0.04, 0.08)  # of the largest speed: the Stribeck speeds that are tried
_DISTANCES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)  # of the travel, over which friction winds up
_LOSS, _LOST = 0.03, 0.2  # of the load's torque, and of a friction at the end
_OF_LOAD = 1.0  # shape of a friction under load that is the load's; that of the motor has none
_SHARE, _MODES = 0.25, (1.4, 1.8, 2.3, 3.0, 4.0)  # of the load that swings, at times the first mode
_WAVES_TRIED = np.arange(3.0, 150.0, 0.25)  # times that a ripple comes back over the travel
_LIKELIEST = 6  # that are simulated
_RANK = 1e-10  # of the largest singular value of columns
_STEP = 1e-4  # of the known signal
VISCOUS, COULOMB = 1.0, 0.0
"""Shapes of a friction that changes over the record."""


# What each adds to the torque of an axis


def _late(seen: Seen) -> Columns:
    if seen.loop is None:  # of a loop its derivative is exact
        yield None, -np.gradient(seen.torque, seen.sample_time)


def _push(seen: Seen) -> Columns:
    """Yield a constant force on a joint that is declared without one."""
    if seen.loop is not None and any(
        p.name == "offset" and not p.free and not p.start for p in seen.loop[0].parameters
    ):
        yield None, seen.force(-np.ones(seen.position.size))


def _scale_injected(seen: Seen) -> Columns:
    """Yield the change by the injected signal's gain, where the signal is added after the limit."""
    if seen.loop is None or not np.any(seen.loop[0].axis.after_limit):
        return
    problem, x = seen.loop

    def scale(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=by * e.after_limit, logged=by * e.logged))

    yield None, (scale(1 + _STEP) - scale(1 - _STEP)) / (2 * _STEP)


def _limit(seen: Seen) -> Columns:
    """Yield the whole change of the torque by lower limits, so that size 1 is the limit."""
    for level in (share * float(np.max(np.abs(seen.asked))) for share in _LEVELS):
        yield level, seen.limited(level)


def _saturate(seen: Seen) -> Columns:
    """Yield the missing torque per unit loss at the peak, by powers of the current."""
    current = seen.torque
    share = np.abs(current) / (float(np.max(np.abs(current), initial=0.0)) or 1.0)
    for power in _SAGS:
        yield power, seen.force(-current * share**power)


def _hang(seen: Seen) -> Columns:
    """Yield the weight of a loop's load that hangs in four directions."""
    if seen.loop is None:
        return
    joint, gear = seen.loop[0].joint, seen.loop[0].joint.transmission
    if joint.gravity is not None or (joint.kind if gear is None else gear.load) != "revolute":
        return
    run = seen.loop[0].simulate(seen.loop[1])
    angle = run.motor_position if run.load_position is None else run.load_position
    if gear is not None and gear.ratio is not None and gear.side == "motor":
        angle = angle / gear.ratio
    for hangs in _HANGS:
        yield hangs, seen.force(-np.sin(angle - hangs))


def _cog(seen: Seen) -> Columns:
    """Yield the ripple, per unit of amplitude, that explains most of a residual of a loop without smooth laws.

    The residual is regressed on cosine and sine of the simulated position over each period: a loop that holds its
    position against a force shows the force nearly as it is. The likeliest periods are then simulated.
    """
    travel = float(np.ptp(seen.position))
    if seen.loop is None or not isinstance(joint := seen.loop[0].joint, FlexibleJoint) or joint.stepped or not travel:
        return
    problem, basis = seen.loop[0], orthonormal_basis(seen.own, _RANK)
    position, way = seen.position[problem.kept], np.sign(seen.velocity[problem.kept])
    whiten = fit_whitener(seen.residual - basis @ (basis.T @ seen.residual))
    basis, left = orthonormal_basis(whiten(seen.own), _RANK), whiten(seen.residual)

    def explain(columns: FloatArray) -> tuple[float, FloatArray]:
        """Return the decrease of the squares of the residual by columns, and their weights."""
        white = whiten(columns)
        apart = white - basis @ (basis.T @ white)
        weights = np.linalg.lstsq(apart, left, rcond=_RANK)[0]
        return float(left @ apart @ weights), np.asarray(weights)

    def regress(wave: float) -> float:
        # A loop responds late to a force, in the direction of motion: so each direction has coefficients of its own.
        turn = 2 * np.pi * wave / travel * position
        return explain(np.column_stack([np.cos(turn), np.sin(turn), way * np.cos(turn), way * np.sin(turn)]))[0]

    def simulate(wave: float) -> tuple[float, float, FloatArray]:
        turn = 2 * np.pi * wave / travel * seen.position
        parts = [one for each in (np.cos(turn), np.sin(turn)) if (one := seen.force(-each)) is not None]
        if len(parts) < 2:
            return 0.0, wave, np.zeros(turn.size)
        raw = np.column_stack(parts)
        gain, weights = explain(problem.filter(raw))
        return gain, wave, raw @ weights / (float(np.linalg.norm(weights)) or 1.0)

    gains = np.array(in_threads(regress, _WAVES_TRIED.tolist()))
    likeliest = _WAVES_TRIED[np.argsort(-gains)[:_LIKELIEST]]
    _, wave, raw = max(in_threads(simulate, likeliest.tolist()), key=lambda one: one[0])
    yield travel / wave, raw


def _wave(seen: Seen) -> Columns:
    """Yield waves of one to four periods in the travel."""
    turns = 2.0 * np.pi * (seen.position - seen.position.min()) / (np.ptp(seen.position) or 1.0)
    for wave in range(1, _WAVES + 1) if seen.loop is None else ():
        yield float(wave), np.sin(wave * turns)
        yield -float(wave), np.cos(wave * turns)


def _follow_other(name: str, seen: Seen) -> Columns:
    """Yield velocity, acceleration and direction of another axis."""
    velocity, acceleration = seen.others[name]
    yield from enumerate((velocity, acceleration, np.sign(velocity)))


def _at_low_speed(sign: float, seen: Seen) -> Columns:
    """Yield a friction that is larger, or smaller, by ``S exp(-(v / vs)^2)``, for some vs."""
    own = "" if seen.loop is None else seen.loop[0].joint.friction.name
    if "stribeck" in own or "presliding" in own:
        return
    fastest = float(np.max(np.abs(seen.velocity), initial=0.0)) or 1.0
    for speed in (share * fastest for share in (*_SPEEDS, *([] if seen.loop else [2 * _SPEEDS[-1]]))):
        column = seen.force(-np.exp(-((seen.velocity / speed) ** 2)) * np.sign(seen.velocity))
        yield speed, None if column is None else sign * column


def _along_travel(seen: Seen) -> Columns:
    """Yield a friction that changes over the travel, by 1 at most: by a line, half a wave and a whole one."""
    low, span = float(seen.position.min()), float(np.ptp(seen.position)) or 1.0
    way = 2.0 * (seen.position - low) / span - 1.0
    for shape, over in enumerate((way, np.cos(np.pi * way), np.sin(np.pi * way))):
        yield float(shape), seen.force(-np.sign(seen.velocity) * over)


def _winds_up(seen: Seen) -> Columns:
    """Yield a flexible joint's Coulomb friction as it winds up over some distances, less that which does not."""
    if not seen.is_flexible or not seen.has_linear_friction:
        return
    still, moves = np.sign(seen.velocity), np.diff(seen.position, prepend=seen.position[0])
    for distance in (share * float(np.ptp(seen.position)) for share in _DISTANCES):
        if distance > 0:
            yield distance, seen.force(still - _wind(moves / distance))


def _wind(moves: FloatArray) -> FloatArray:
    """Return the share of Dahl's friction that is wound up after each move, (samples,), in winding distances."""
    wound, found = 0.0, np.empty(moves.size)
    for k, (way, left) in enumerate(zip(np.sign(moves).tolist(), np.exp(-np.abs(moves)).tolist(), strict=True)):
        wound = way + (wound - way) * left if way else wound
        found[k] = wound
    return found


def _under_load(seen: Seen) -> Columns:
    """Yield a friction that grows with the torque through the gear."""
    if seen.has_linear_friction:
        yield None, seen.force(-np.abs(seen.through) * np.sign(seen.velocity))
    law = Friction("load-dependent")
    if _can_have(law, seen):
        yield _OF_LOAD, seen.vary({"load_friction_per_torque": _LOSS}, _LOSS, friction=law)


def _can_have(law: Friction, seen: Seen) -> bool:
    """Test whether another law can replace the symmetric friction of a flexible joint."""
    joint = seen.loop[0].joint if seen.loop is not None and seen.is_flexible else None
    return joint is not None and joint.friction == Friction()


def _over_time(seen: Seen) -> Columns:
    """Yield friction that falls over the record, by one unit at its end."""
    gone = np.linspace(0.0, 1.0, seen.velocity.size)
    if seen.loop is None:
        yield VISCOUS, seen.force(gone * seen.velocity)
        yield COULOMB, seen.force(gone * np.sign(seen.velocity))
    law, duration = Friction("drifting"), seen.sample_time * seen.velocity.size
    sides = ("motor_", "load_") if _can_have(law, seen) else ()
    still = {f"{side}{part}_drift": 0.0 for side in sides for part in PARTS}
    for part, shape in zip(PARTS if sides else (), (VISCOUS, COULOMB), strict=False):
        falls = {f"{side}{part}_drift": -_LOST * seen.values[f"{side}{part}"] / duration for side in sides}
        yield shape, seen.vary(still | falls, _LOST, friction=law)


def _by_direction(seen: Seen) -> Columns:
    if seen.loop is None:
        yield None, seen.force(-np.abs(seen.velocity))


def _other_spring(*laws: str) -> Callable[[Seen], Columns]:
    """Return a function that yields springs of other laws for a flexible joint's linear one, at their starts."""

    def vary(seen: Seen) -> Columns:
        joint, values = None if seen.loop is None else seen.loop[0].joint, seen.values
        if not isinstance(joint, FlexibleJoint) or not joint.spring.linear or seen.windup == 0.0:
            return
        for law in map(Spring, laws):
            if law.name == "elastic-load":
                first = joint.frequencies(values)["free_free"]
                for times in _MODES:
                    yield times * first, seen.vary(swinging_part(values, _SHARE, times), _SHARE, spring=law)
                continue
            for start in law.starts(values, seen.windup):
                if law.name == "backlash":
                    yield 0.5 * start["gap"], seen.vary(start, start["gap"], spring=law)
                else:  # stiffer at the largest wind-up than near none
                    torque = law.torque({**values, **start}, np.array([seen.windup]), np.zeros(1))
                    more = float(torque[0]) / (start["stiffness"] * seen.windup) - 1.0
                    yield more, seen.vary(start, more, spring=law)

    return vary


# The rows

_mechanical = partial(Fault, mechanical=True)
_friction = partial(Fault, table="friction", reason=Reason.FRICTION_NOT_AS_MODELLED)
_spring = partial(_mechanical, table="spring", reason=Reason.SPRING_NOT_LINEAR, kin="spring law")

VELOCITY_FILTER = Fault("velocity_filter", "velocity filter")
TORQUE_FILTER = Fault("torque_filter", "torque filter")
_number = partial(Fault, declared=None)
DELAY = _number("delay", "delay of the torque", measure="ms")
REFERENCE_DELAY = _number("reference_delay", "reference delay", measure="ms")
LOG_DELAY = _number("log_delay", "delay of the log behind its time stamps", columns=_late, measure="ms")
LOG_GAIN = _number("log_gain", "size of the logged torque")
INJECTED_GAIN = Fault(
    "injected_gain", "size of the injected signal", columns=_scale_injected, declared=1.0, last=True
)  # fmt: skip
_NUMBERS = (
    DELAY, REFERENCE_DELAY, _number("gain", "gain of the controller's output", last=True), LOG_GAIN, LOG_DELAY,
    INJECTED_GAIN,
)  # fmt: skip
OFFSET = Fault("offset", "constant force that is not declared", columns=_push, measure="torque")
LIMIT = Fault("limit", "undeclared limit of the controller's output", columns=_limit, one_sided=True, measure="level")
TORQUE_SATURATION = _mechanical(
    "torque_saturation", "torque constant that falls with the current", columns=_saturate, one_sided=True,
    least=_LEAST_SAG, measure="%",
    remedy="the joint file has one torque constant: record with half of that torque, or see the curve of torque and "
    "current in the motor's data sheet",
)  # fmt: skip
GRAVITY = _mechanical(
    "gravity", "load that hangs", columns=_hang, measure="torque", reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy='to identify it, declare it: [gravity] load = "link"',
)  # fmt: skip
POSITION_FORCE = _mechanical(
    "position_force", "force that follows the position", columns=_wave, reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy="a gear that turns unevenly, a cable or a counterbalance makes one",
)  # fmt: skip
COGGING = _mechanical(
    "cogging", "force that comes back with the motor's position", columns=_cog, tried=_WAVES_TRIED.size, parts=2,
    one_sided=True, measure="torque", reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy="to identify it, declare it: [ripple] period = {shape}",
)  # fmt: skip
STRIBECK = Fault(
    "stribeck", "friction that rises towards standstill", columns=partial(_at_low_speed, 1.0), one_sided=True,
    kin="low-speed friction", measure="torque", table="friction",
    laws=("stribeck", "asymmetric-stribeck"),
)  # fmt: skip
PRESLIDING = replace(
    STRIBECK, name="presliding", title="friction that falls towards standstill", columns=partial(_at_low_speed, -1.0),
    laws=("presliding", *STRIBECK.laws),
)  # fmt: skip
UNEVEN_FRICTION = _mechanical(
    "uneven_friction", "friction that differs along the travel", columns=_along_travel, measure="torque",
    reason=Reason.FORCE_FOLLOWS_POSITION,
)  # fmt: skip
WINDING_FRICTION = _friction(
    "winding_friction", "friction that winds up behind each reversal", columns=_winds_up, mechanical=True,
    one_sided=True, kin="low-speed friction", laws=("presliding",),
)  # fmt: skip
LOAD_DEPENDENT_FRICTION = _friction(
    "load_dependent_friction", "friction that grows with the load's torque", mechanical=True, one_sided=True,
    columns=_under_load, measure="%", laws=("load-dependent",),
)  # fmt: skip
CHANGING_FRICTION = _friction(
    "changing_friction", "friction that changes over the record", columns=_over_time, mechanical=True,
    laws=("drifting",),
)  # fmt: skip
ASYMMETRIC_FRICTION = _friction(
    "asymmetric_friction", "friction that differs by direction", columns=_by_direction, mechanical=True,
    laws=("asymmetric",),
)  # fmt: skip
CUBIC_SPRING = _spring(
    "cubic_spring", "spring that is not linear, stiffer at the largest torque than near none", measure="%",
    columns=_other_spring("three-piece", "cubic"),
    laws=("three-piece", "cubic", "two-piece"),
)  # fmt: skip
BACKLASH = _spring(
    "backlash", "backlash of the transmission", measure="position", columns=_other_spring("backlash"), one_sided=True,
    laws=("backlash",),
)  # fmt: skip
SECOND_MODE = _mechanical(
    "second_mode", "load of which a part swings on a spring of its own", columns=_other_spring("elastic-load"),
    measure="%", one_sided=True, reason=Reason.LOAD_NOT_RIGID, table="spring", laws=("elastic-load",),
)  # fmt: skip
COMPLIANCE = _mechanical(
    "compliance", "gear that bends", reason=Reason.LOAD_NOT_RIGID,
    remedy="declare the spring of this joint, or identify below its mode by a lower filtering.cutoff",
)  # fmt: skip

FAULTS = (
    *_NUMBERS, OFFSET, TORQUE_SATURATION, GRAVITY, POSITION_FORCE, STRIBECK, PRESLIDING, UNEVEN_FRICTION,
    WINDING_FRICTION, LOAD_DEPENDENT_FRICTION, CHANGING_FRICTION, ASYMMETRIC_FRICTION, COGGING, CUBIC_SPRING, BACKLASH,
    SECOND_MODE, COMPLIANCE, LIMIT,
)  # fmt: skip
"""Every fault that can be tested, in the order of the tests."""


@cache
def number_fault(name: str) -> Fault:
    """Return the fault of a number of the controller or the log that is not as declared."""
    return next((one for one in _NUMBERS if one.name == name), None) or _number(name, name_number(name))


def list_signatures(seen: Seen) -> Iterator[FaultSignature]:
    """Yield the torque that each fault adds to an axis, before the filter."""
    coupled = (
        replace(
            POSITION_FORCE, name=f"coupled_{name}", title=f"torque that follows the motion of {name}",
            reason=Reason.LOOP_NOT_AS_DECLARED, remedy="motors or gears that are coupled make one",
            columns=partial(_follow_other, name),
        )
        for name in seen.others
    )  # fmt: skip
    for fault in (*FAULTS, *coupled):
        for shape, raw in () if fault.columns is None else fault.columns(seen):
            if raw is not None:
                yield FaultSignature(fault, raw, shape, raw, trial=seen.trials.get(id(raw)))
