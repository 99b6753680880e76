"""Table of fault hypotheses of an axis, their tests and findings.

Each is a row, in the order of the tests. It is tested as a small deviation, by the change of the axis's torque per unit
of it. Corrections of large ones are in `changes`. To add one, write its columns, and its row.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.common.messages import Message
from jointid.common.parallel import in_threads
from jointid.common.text import in_words, number
from jointid.common.transmission import Side
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import respond
from jointid.models.controllers.sampled import REFERENCE
from jointid.models.friction import PARTS, Friction
from jointid.models.springs import Spring, swinging_part
from jointid.simulation.controller_torque import SeenPosition
from jointid.uncertainty.covariance import INTERVAL
from jointid.uncertainty.model_tests import fit_whitener

_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_LISTED = 3  # parameters in a sentence, at most
_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the largest torque the law asks for: the limits that are tried
_HANGS = (0.0, 0.25 * np.pi, 0.5 * np.pi, 0.75 * np.pi)  # rad: the lowest place of a load, or the highest
_SAGS = (1.0, 2.0)  # powers of the torque, by which the torque constant may fall
_LEAST_SAG = 0.04  # of the torque at the peak: to so much a torque constant is known to be one
_WAVES, _TURNED = 4, 1.0  # periods in the travel; rad at least, that show an error of each turn, or a weight
_DISTANCES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)  # of the travel, over which friction winds up
_LOSS, _LOST = 0.03, 0.2  # of the load's torque, and of a friction at the end
_SHARE, _MODES = 0.25, (1.4, 1.8, 2.3, 3.0, 4.0)  # of the load that swings, at times the first mode
_LIKELIEST = 6  # that are simulated
_WAVES_TRIED = np.arange(3.0, 150.0, 0.25)  # times that a ripple comes back over the travel
_RANK = 1e-10  # of the largest singular value of columns
VISCOUS, COULOMB = 1.0, 0.0  # shapes of a friction that changes over the record


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of loop, log or mechanics: one row of a common table.

    Attributes:
        name: its code.
        title: noun phrase, without an article, that states it.
        columns: returns its change of the torque of an axis, for each of its shapes.
        remedy: what to declare, or to do, as the end of a sentence, with {shape}.
        tried: number of waves, of any phase, from which its column is chosen; 0 for a column without a phase.
        declared: value without the fault; None for a number of the controller, whose value is declared.
        one_sided: whether its size can only be positive.
        least: smallest size that is named; smaller ones are within the usual tolerance.
        mechanical: whether it is a fault of the joint's model, not of loop or log.
        kin: group of faults that describe one effect; after one is found, the others are not tested.
        measure: unit in which a sentence shows its size: none, "%", "ms", "torque", "position", or "level" (a torque).
        reason: code of the verdict.
    """

    name: str
    title: str
    columns: Callable[[Seen], Columns] | None = None
    remedy: str = ""
    tried: int = 0
    declared: float | None = 0.0
    one_sided: bool = False
    least: float = 0.0
    mechanical: bool = False
    kin: str = ""
    measure: str = ""
    reason: Reason = Reason.LOOP_NOT_AS_DECLARED

    @property
    def of_model(self) -> bool:
        """True for faults of mechanics or friction, False for loop or log."""
        return self.mechanical or bool(self.kin)


@dataclass(frozen=True, slots=True, eq=False)
class FaultSignature:
    """Change of the torque by one fault.

    Attributes:
        fault: that makes it.
        column: (rows,) change of the filtered torque per unit of its size: a derivative, or a secant.
        shape: the level of a limit, a Stribeck speed, a gap or a frequency; None without a shape.
        raw: (samples,) the column before the filter, if no parameter of the problem stands for the fault.
        axis: index of its axis.
        trial: the problem of the joint with it, and (free,) a start, if a law of the joint has it.
    """

    fault: Fault
    column: FloatArray
    shape: float | None = None
    raw: FloatArray | None = None
    axis: int = 0
    trial: tuple[ClosedLoopProblem, FloatArray] | None = None


@dataclass(frozen=True, slots=True)
class FaultTest:
    """Test of one fault.

    Attributes:
        fault: tested.
        alike: faults that no record of this loop can distinguish from it.
        declared: value; 0 for an undeclared one.
        size: value less the declared one; of a limit, the observed share of its cut.
        std: standard deviation of the size, autocorrelation-robust.
        p_value: adjusted for all tests of the record together.
        shape: the level of a limit in the torque's unit, or a Stribeck speed.
        axis: index of its axis.
    """

    in_json = "name statistic -fault -alike -axis"
    fault: Fault
    alike: tuple[Fault, ...]
    declared: float
    size: float
    std: float
    p_value: float
    shape: float | None = None
    axis: int = 0

    @property
    def name(self) -> str:
        """Code of the fault."""
        return self.fault.name

    @property
    def statistic(self) -> float:
        """Ratio of the size to its deviation."""
        return self.size / self.std if self.std > 0 else 0.0

    @property
    def possible(self) -> bool:
        """False for a negative total delay: no torque precedes its law."""
        return self.fault is not DELAY or self.declared + self.size + INTERVAL * self.std >= 0.0

    @property
    def strength(self) -> float:
        """Absolute statistic; at least 0 for faults that are only positive.

        A shape that is the best of many is strong by chance: the fault is as strong as a single test of its p-value.
        """
        from scipy.stats import norm

        found = max(self.statistic, 0.0) if self.fault.one_sided else abs(self.statistic)
        many = self.fault.tried and self.p_value > 0.0
        return min(found, float(norm.isf(0.5 * self.p_value))) if many else found


def name_number(name: str) -> str:
    """Number's name in words, such as "time constant of the velocity filter"."""
    *owner, last = name.replace("_", " ").split(".")
    if len(owner) == 2:  # one of several, which are counted
        return f"{last} of {owner[0].removesuffix('s')} {owner[1]}"
    return f"{last} of the {owner[0]}" if owner else last


@dataclass(frozen=True, slots=True)
class ParameterShift:
    """Change of a parameter by correcting a fault: in unit and deviations."""

    in_json = "-name -unit"
    by: float
    sigmas: float
    name: str = ""
    unit: str = ""

    def __str__(self) -> str:
        return f"{in_words(self.name)} by {number(self.by, 3, '+')} {self.unit} ({abs(self.sigmas):.1f} sigma)"


@dataclass(frozen=True, slots=True)
class OtherLaw:
    """A law that a drive may run instead of the declared one.

    Attributes:
        fault: what differs.
        words: clause on what the drive does.
        remedy: its declaration.
        controller: with that law.
        late: delay of the log under it, s.
    """

    fault: Fault
    words: str
    remedy: str
    controller: Any = None
    late: float = 0.0


@dataclass(frozen=True, slots=True)
class Finding:
    """Fault that was found.

    Attributes:
        test: of the fault, those found before it corrected.
        value: estimated, in the unit of the declaration; None without a parameter for the fault.
        rivals: tests of faults that are at most 20 times less likely.
        changes: of the joint's parameters, by name, when it is corrected.
        law: the drive's law instead of the declared one, if that is the fault.
        left: residual share of the filtered torque under that law, or with that fault corrected by a fit.
        alike: equally good laws, the likeliest first.
    """

    in_json = "-law -alike"
    test: FaultTest
    value: float | None
    rivals: tuple[FaultTest, ...]
    changes: Mapping[str, ParameterShift]
    law: OtherLaw | None = None
    left: float | None = None
    alike: tuple[OtherLaw, ...] = ()


@dataclass(frozen=True, slots=True)
class AxisFaults:
    """Faults of one axis that were found, and the tests of all.

    Attributes:
        findings: faults found, the likeliest first.
        tests: of every fault as if it were the only one, the likeliest first.
        units: of "torque" and "position".
        suspected: faults that are not named, and whose shifts the intervals hold: of the mechanics, nearly significant;
            of loop or log, excluded by the motor position; a law that would shift a parameter out of its interval.
        part: of the time in which the residual is concentrated, faults corrected; no fault is named beside it.
        explained: share of the residual's squares that the faults explain together, if they leave more than noise.
    """

    findings: tuple[Finding, ...]
    tests: tuple[FaultTest, ...]
    units: Mapping[str, str]
    suspected: tuple[Finding, ...] = ()
    part: Message | None = None
    explained: float | None = None

    @property
    def as_declared(self) -> bool:
        """True if no fault was found."""
        return not self.findings and self.part is None and self.explained is None

    @property
    def reasons(self) -> tuple[Message, ...]:
        """Messages on the faults found; one on their absence if none."""
        if self.part is not None:
            return (self.part,)
        if self.explained is not None:
            clause = "something is wrong that is none of the known faults"
            alike = " and ".join(_call(one.test.fault) for one in self.findings)
            shares = alike and f"; {alike} would explain {number(100 * self.explained, 2)} % of the residual's squares"
            remedy = "of a single joint, compare laws of friction and spring by jointid diagnose --laws"
            words = f"{clause}{shares}; {remedy}"
            return (Message(Reason.NO_CAUSE_FOUND, words, {"explained": self.explained, "remedy": remedy}, clause),)
        if self.findings:
            return tuple(map(self._describe, self.findings))
        least = min((one.p_value for one in self.tests), default=1.0)
        said = f"loop and log are as declared as far as this record shows ({len(self.tests)} faults were tested, "
        said += f"p >= {number(least, 2)})"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    def _describe(self, finding: Finding) -> Message:
        """Message on a fault: size, alternatives, shifts and remedy."""
        test = finding.test
        clause = self._state(finding)
        if test.alike:
            clause += f", or {_call(*test.alike)} is wrong, which this loop cannot distinguish"
        words = f"{clause} ({'p < 1e-6' if test.p_value < 1e-6 else f'p = {number(test.p_value, 2)}'})"
        if finding.rivals:
            words += f"; {_call(*(rival.fault for rival in finding.rivals))} would explain nearly as much"
        far = sorted(finding.changes.values(), key=lambda change: -abs(change.sigmas))[:_LISTED]
        if moved := [str(change) for change in far if abs(change.sigmas) >= _SMALLEST_SHIFT]:
            words += f"; correcting it changes {', '.join(moved)}"
        value = test.declared + test.size if finding.value is None else finding.value
        shown = f'"{number(1e3 * value, 3)} ms"' if test.fault.measure == "ms" else number(value, 4)
        remedy = test.fault.remedy.format(shape=number(test.shape, 3), name=test.name, value=shown)
        words += f"; {remedy}" * (remedy != "" and finding.law is None)  # a law is declared by its clause
        remedy = remedy if finding.law is None else f"declare {finding.law.remedy}"
        changes, alike = {name: one.by for name, one in finding.changes.items()}, [one.name for one in test.alike]
        numbers = {"size": test.size, "std": test.std, "p_value": test.p_value, "changes": changes}
        values = {"suspect": test.name, "alike": alike, "remedy": remedy, **numbers}
        return Message(test.fault.reason, words, values, clause)

    def _state(self, finding: Finding) -> str:
        """State a fault with its size, or the drive's possible laws."""
        test, fault, measure = finding.test, finding.test.fault, finding.test.fault.measure
        if finding.law is not None:
            laws = [f"{one.words}: declare {one.remedy}" for one in (finding.law, *finding.alike)]
            return "; or, as far as this record shows, ".join(laws)
        if measure == "level":
            return f"{fault.title}: {number(finding.value or test.shape, 4)} {self.units['torque']}"
        unit, factor = {"ms": ("ms", 1e3), "%": ("%", 100.0)}.get(measure, (self.units.get(measure, ""), 1.0))
        if test.declared and not measure:  # a number in percent of its declaration
            unit, factor = "% of what is declared", 100.0 / abs(test.declared)
        size = f"{number(factor * test.size, 3, '+')} ± {number(2 * factor * test.std, 2)} {unit}"
        return f"{fault.title}: {size}" if unit and 2 * test.std < abs(test.size) else fault.title


def _call(*faults: Fault) -> str:
    return " or ".join(f"the {fault.title}" for fault in faults)


# What each adds to the torque of an axis


def _push(seen: Seen) -> Columns:
    """Yield a constant force on a joint that is declared without one."""
    parameters = () if seen.loop is None else seen.loop[0].parameters
    if any(p.name == "offset" and not p.free and not p.start for p in parameters):
        yield None, seen.force(-np.ones(seen.position.size))


def _scale_injected(seen: Seen) -> Columns:
    """Yield the effect of scaling a signal injected after the limit."""
    if seen.loop is not None and np.any(seen.loop[0].axis.after_limit):
        axis = seen.loop[0].axis
        yield None, seen.force(axis.after_limit, axis.shown)


def _limit(seen: Seen) -> Columns:
    """Yield full effects of lower torque limits; size 1 is the limit."""
    levels = [share * float(np.max(np.abs(seen.asked))) for share in _LEVELS]
    if seen.loop is None:
        yield from ((one, np.sign(seen.asked) * np.maximum(np.abs(seen.asked) - one, 0.0)) for one in levels)
        return
    problem, x = seen.loop
    if hasattr(problem.loop.controller, "limit") and not any(p.name == "limit" for p in problem.free):
        for by in (one for one in levels if one < problem.axis.law.limit):
            yield by, problem.torque(x, partial(lambda by, e: replace(e, law=e.law.with_limit(by)), by)) - seen.plain


def _saturate(seen: Seen) -> Columns:
    """Yield torque lost per unit loss at the peak, by current powers."""
    current = seen.torque
    share = np.abs(current) / (float(np.max(np.abs(current), initial=0.0)) or 1.0)
    for power in _SAGS:
        yield power, seen.force(-current * share**power)


def _hang(seen: Seen) -> Columns:
    """Yield the weight of a loop's load that hangs in four directions."""
    angle = seen.turned("load")
    if angle is None or seen.loop is None or seen.loop[0].joint.gravity is not None:
        return
    sine, cosine = seen.force(np.sin(angle)), seen.force(np.cos(angle))
    yield from ((hangs, np.sin(hangs) * cosine - np.cos(hangs) * sine) for hangs in _HANGS)


def _in_turns(side: Side, seen: Seen) -> Columns:
    """Yield the torque of a position error, or an unlogged weight, per turn.

    Of the motor the law's answer to the error is the force, and is logged; of the load the weight itself is.
    """
    angle = seen.turned(side)
    if angle is None or seen.loop is None or np.ptp(angle) < _TURNED or any(seen.loop[0].log.seen):
        return
    law, waves = SeenPosition(seen.loop[0].axis), [np.sin(angle), np.cos(angle)]
    forces = [law.respond(one, 0.0 * law.axis.inputs) for one in waves] if side == "motor" else waves
    raw, basis = np.column_stack([seen.force(one, one) for one in forces]), orthonormal_basis(seen.own, _RANK)
    filtered = seen.loop[0].filter(raw)
    weights = np.linalg.lstsq(filtered - basis @ (basis.T @ filtered), seen.residual, rcond=_RANK)[0]
    yield None, raw @ weights / (float(np.linalg.norm(weights)) or 1.0)


def _follow_load(seen: Seen) -> Columns:
    """Yield a cascade's answer to a position that is the load's."""
    if seen.loop is None or not seen.is_flexible or any(seen.loop[0].log.seen):
        return
    axis, run = seen.loop[0].axis, seen.loop[0].simulate(seen.loop[1])
    cascade: Any = axis.controller
    inputs = np.zeros_like(axis.inputs)
    if getattr(cascade, "nested", False) and run.load_position is not None and run.load_position.size == len(inputs):
        inputs[:, REFERENCE] = run.motor_position - run.load_position
        law = axis.law_of(replace(cascade, velocity_feedforward=0.0))
        force = respond(law, inputs, law.known_memory(inputs))[:, law.output]
        yield None, seen.force(force, force)


def _cog(seen: Seen) -> Columns:
    """Yield the ripple, per amplitude, that explains most of a residual.

    The residual is regressed on cosine and sine of the simulated position over each period: a loop that holds its
    position against a force shows the force nearly as it is. The likeliest periods are then simulated.
    """
    travel = float(np.ptp(seen.position))
    if seen.loop is None or not seen.is_flexible or seen.loop[0].joint.stepped or not travel:
        return
    problem, basis = seen.loop[0], orthonormal_basis(seen.own, _RANK)
    position, way = seen.position[problem.log.kept], np.sign(seen.velocity[problem.log.kept])
    whiten = fit_whitener(seen.residual - basis @ (basis.T @ seen.residual))
    basis, left = orthonormal_basis(whiten(seen.own), _RANK), whiten(seen.residual)
    left = left - basis @ (basis.T @ left)

    def explain(columns: FloatArray) -> tuple[float, FloatArray]:
        """Decrease of the squared residual by columns, and their weights."""
        white = whiten(columns)
        along, goal = basis.T @ white, white.T @ left
        # The rank is that of singular values above 1e-5; even of a motion one way the least was 1e-4 of the largest.
        weights = np.linalg.lstsq(white.T @ white - along.T @ along, goal, rcond=_RANK)[0]
        return float(goal @ weights), np.asarray(weights)

    def regress(wave: float) -> float:
        # A loop responds late to a force, in the direction of motion: so each direction has coefficients of its own.
        turn = np.exp(2j * np.pi * wave / travel * position)
        return explain(np.column_stack([turn.real, turn.imag, way * turn.real, way * turn.imag]))[0]

    def simulate(wave: float) -> tuple[float, float, FloatArray]:
        turn = 2 * np.pi * wave / travel * seen.position
        raw = np.column_stack([seen.force(-each) for each in (np.cos(turn), np.sin(turn))])
        gain, weights = explain(problem.filter(raw))
        return gain, wave, raw @ weights / (float(np.linalg.norm(weights)) or 1.0)

    gains, tried = np.zeros(_WAVES_TRIED.size), np.arange(0, _WAVES_TRIED.size, 2)
    for _ in range(2):  # a wave is seen half a period beside its own
        gains[tried] = in_threads(regress, _WAVES_TRIED[tried].tolist())
        likeliest = np.argsort(-gains)[:_LIKELIEST]
        tried = np.unique(np.clip([likeliest - 1, likeliest + 1], 0, gains.size - 1))
    _, wave, raw = max(in_threads(simulate, _WAVES_TRIED[likeliest].tolist()), key=lambda one: one[0])
    yield travel / wave, raw


def _wave(seen: Seen) -> Columns:
    """Yield waves of one to four periods in the travel."""
    turns = 2.0 * np.pi * (seen.position - seen.position.min()) / (np.ptp(seen.position) or 1.0)
    for wave in range(1, _WAVES + 1) if seen.loop is None else ():
        yield float(wave), np.sin(wave * turns)
        yield -float(wave), np.cos(wave * turns)


def _at_low_speed(sign: float, seen: Seen) -> Columns:
    """Yield friction changes by ``S exp(-(v / vs)^2)``, for some vs."""
    own = [] if seen.loop is None else seen.loop[0].joint.friction.terms()
    if not any("stribeck_speed" in [name for name, *_ in term.parameters] for term in own):
        yield from ((speed, sign * column) for speed, column in seen.at_low_speeds)


def _along_travel(seen: Seen) -> Columns:
    """Yield friction that varies over the travel, linearly or by waves."""
    low, span = float(seen.position.min()), float(np.ptp(seen.position)) or 1.0
    way = 2.0 * (seen.position - low) / span - 1.0
    for shape, over in enumerate((way, np.cos(np.pi * way), np.sin(np.pi * way))):
        yield float(shape), seen.force(-np.sign(seen.velocity) * over)


def _winds_up(seen: Seen) -> Columns:
    """Yield presliding minus Coulomb friction of a flexible joint, at several distances."""
    if not seen.is_flexible or not seen.has_linear_friction:
        return
    still, moves = np.sign(seen.velocity), np.diff(seen.position, prepend=seen.position[0])
    for distance in (share * float(np.ptp(seen.position)) for share in _DISTANCES if np.any(moves)):
        keeps = zip(np.sign(moves).tolist(), np.exp(-np.abs(moves / distance)).tolist(), strict=True)
        wound = itertools.accumulate(keeps, lambda wound, one: one[0] + (wound - one[0]) * one[1], initial=0.0)
        yield distance, seen.force(still - np.array([*wound][1:]))


def _under_load(seen: Seen) -> Columns:
    """Yield friction that grows with the gear's torque: motor's, load's (shape 1)."""
    if seen.has_linear_friction:
        yield None, seen.force(-np.abs(seen.through) * np.sign(seen.velocity))
    if seen.is_plain:
        yield 1.0, seen.vary({"load_friction_per_torque": _LOSS}, _LOSS, friction=Friction("load-dependent"))


def _over_time(seen: Seen) -> Columns:
    """Yield friction that falls by one unit over the record."""
    gone = np.linspace(0.0, 1.0, seen.velocity.size)
    if seen.loop is None:
        yield VISCOUS, seen.force(gone * seen.velocity)
        yield COULOMB, seen.force(gone * np.sign(seen.velocity))
    law, duration = Friction("drifting"), seen.sample_time * seen.velocity.size
    sides = ("motor_", "load_") if seen.is_plain else ()
    still = {f"{side}{part}_drift": 0.0 for side in sides for part in PARTS}
    for part, shape in zip(PARTS if sides else (), (VISCOUS, COULOMB), strict=False):
        falls = {f"{side}{part}_drift": -_LOST * seen.values[f"{side}{part}"] / duration for side in sides}
        yield shape, seen.vary(still | falls, _LOST, friction=law)


def _other_spring(laws: Sequence[str], seen: Seen) -> Columns:
    """Yield other spring laws in place of a linear one, at starts."""
    joint: Any = seen.loop[0].joint if seen.loop else None
    values = seen.values
    if not seen.is_flexible or not joint.spring.linear or seen.windup == 0.0:
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
            else:  # stiffer at the largest wind-up than near zero
                torque = law.torque({**values, **start}, np.array([seen.windup]), np.zeros(1))
                more = float(torque[0]) / (start["stiffness"] * seen.windup) - 1.0
                yield more, seen.vary(start, more, spring=law)


# The rows

VELOCITY_FILTER = Fault("velocity_filter", "velocity filter")
TORQUE_FILTER = Fault("torque_filter", "torque filter")
_number = partial(Fault, declared=None, remedy="declare {name} = {value} if that is what the drive has")
DELAY = _number("delay", "delay of the torque", measure="ms")
REFERENCE_DELAY = _number("reference_delay", "reference delay", measure="ms")
LOG_DELAY = _number(  # of a loop its derivative is exact
    "log_delay", "delay of the log behind its time stamps", measure="ms",
    remedy='correct the time stamps of the torque or of the positions, or declare tap = "measured" of an actual value',
    columns=lambda seen: [(None, -np.gradient(seen.torque, seen.sample_time))] if seen.loop is None else [],
)  # fmt: skip
LOG_GAIN = _number("log_gain", "size of the logged torque", remedy="check its unit and the torque constant")
OFFSET = Fault("offset", "constant force that is not declared", _push, "leave the offset free", measure="torque")
LIMIT = Fault("limit", "undeclared limit of the controller's output", _limit, "set it", one_sided=True, measure="level")
_position = partial(Fault, mechanical=True, reason=Reason.FORCE_FOLLOWS_POSITION)
_turns = partial(Fault, tried=1, kin="gravity")
_low_speed = partial(Fault, one_sided=True, kin="low-speed friction", measure="torque")
_friction = partial(Fault, mechanical=True, reason=Reason.FRICTION_NOT_AS_MODELLED)
_spring = partial(Fault, mechanical=True, reason=Reason.SPRING_NOT_LINEAR, kin="spring law")
_load = partial(Fault, mechanical=True, reason=Reason.LOAD_NOT_RIGID)

_ROWS = (
    DELAY, REFERENCE_DELAY, LOG_GAIN, LOG_DELAY, _number("gain", "gain of the controller's output"),
    Fault("injected_gain", "size of the injected signal", _scale_injected, "check its unit", declared=1.0), OFFSET,
    _turns("eccentric_encoder", "encoder off its centre", partial(_in_turns, "motor"), "centre it", measure="position"),
    _turns("unlogged_gravity", "log without a load's weight", partial(_in_turns, "load"), "log it", measure="torque"),
    Fault("load_encoder", "position loop on the load", _follow_load, "take the motor's", one_sided=True, least=0.5),
    Fault(
        "torque_saturation", "torque constant that falls with the current", _saturate,
        "the joint file has one torque constant: record with half of that torque",
        mechanical=True, one_sided=True, least=_LEAST_SAG, measure="%",
    ),
    _position("gravity", "load that hangs", _hang, 'declare it: [gravity] load = "link"', measure="torque"),
    _position(
        "position_force", "force that follows the position", _wave,
        "a gear that turns unevenly, a cable or a counterbalance makes one",
    ),
    _low_speed(
        "stribeck", "friction that rises towards standstill", partial(_at_low_speed, 1.0),
        'declare friction = "stribeck", or "asymmetric-stribeck" (without "presliding"), stribeck_speed near {shape}',
    ),
    _low_speed(
        "presliding", "friction that falls towards standstill", partial(_at_low_speed, -1.0),
        'declare friction = "stribeck", stribeck_speed near {shape}, if smooth at rest (tanh), else "presliding"',
    ),
    _position("uneven_friction", "friction that differs along the travel", _along_travel, measure="torque"),
    _friction(
        "winding_friction", "friction that winds up behind each reversal", _winds_up,
        'declare friction = "presliding", or "stribeck" if smooth (tanh)', one_sided=True, kin="low-speed friction",
    ),
    _friction(
        "load_dependent_friction", "friction that grows with the load's torque", _under_load,
        'declare friction = "load-dependent"', one_sided=True, measure="%",
    ),
    _friction(
        "changing_friction", "friction that changes over the record", _over_time, 'declare friction = "drifting"'
    ),
    _friction(
        "asymmetric_friction", "friction that differs by direction",
        lambda seen: [(None, seen.force(-np.abs(seen.velocity)))] if seen.loop is None else [],
        'declare friction = "asymmetric"',
    ),
    _position(
        "cogging", "force that repeats with the motor's position", _cog, "declare it: [ripple] period = {shape}",
        tried=_WAVES_TRIED.size, one_sided=True, measure="torque",
    ),
    _spring(
        "cubic_spring", "spring that is not linear, stiffer at the largest torque than near zero",
        partial(_other_spring, ("three-piece", "cubic")), "jointid diagnose --laws names its law", measure="%",
    ),
    _spring(
        "backlash", "backlash of the transmission", partial(_other_spring, ("backlash",)),
        'declare spring = "backlash"', measure="position", one_sided=True,
    ),
    _load(
        "second_mode", "load of which a part swings on a spring of its own",
        partial(_other_spring, ("elastic-load",)), 'declare spring = "elastic-load"', measure="%", one_sided=True,
    ),
    _load(
        "compliance", "gear that bends", None,
        "declare the spring of this joint, or identify below its mode by a lower filtering.cutoff", one_sided=True,
    ),
    LIMIT,
)  # fmt: skip
FAULTS = {one.name: one for one in _ROWS}  # that can be tested, in the order of the tests


def number_fault(name: str) -> Fault:
    """Fault of a number of controller or log that differs from declared."""
    return FAULTS.get(name) or _number(name, name_number(name))


def list_signatures(seen: Seen) -> Iterator[FaultSignature]:
    """Yield each fault's unfiltered change of an axis's torque."""
    coupled = (
        Fault(
            f"coupled_{name}", f"torque that follows the motion of {name}",
            partial(lambda of, seen: enumerate((*seen.others[of], np.sign(seen.others[of][0]))), name),
            "motors or gears that are coupled make one", mechanical=True,
        )
        for name in seen.others
    )  # fmt: skip
    for fault in (*_ROWS, *coupled):
        for shape, raw in () if fault.columns is None else fault.columns(seen):
            if raw is not None:
                yield FaultSignature(fault, raw, shape, raw, trial=seen.trials.get(id(raw)))
