"""One joint from several records, or a joint or robot from windows of a long log.

**Several records.** Each is identified by itself, which gives the start, and its own estimate. Least squares over the
rows of all follows, those of a record divided by the level of its residual, so that it is weighted by its accuracy.

Errors of different records are independent in time, but equal at the same place, if they repeat with the motion
(`position_dependent_error`). If the records disagree by more than their intervals allow, the answer says so, and the
intervals of shared parameters are widened (`result.agreement`). A systematic shift of a record's own solution
(`widen_for_force`, `widened_to_second`) widens the common one by the record's weight in it.

A parameter of a record is shared by all, or shared plus a known number, or its own, called ``name@number``
with the number of the record, from 1. The motor's first state is always a record's own; so is a number of the
controller that the records declare differently.

**Windows of a long log.** An identification of one window gives the start. A pass reads every window once and keeps its
`Sums`. A window begins in the middle of a motion, with the speeds of the references; a joint at the motor position that
the inverted law gives for the logged torque, a robot on its references. The loop forgets an initial error within the
settling time, which is excluded at either end, since the filter has zero phase. Neighbouring windows overlap by twice
that time.

Errors that repeat at a place are not averaged away by a longer record: sums are kept of each place, too. The deviations
are the larger ones, in every direction, of leaving out windows and of leaving out places.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, zip_longest
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.messages import Detail, Progress, follow
from jointid.common.parameters import Bounds, Parameter, Quantity, find_active_bounds
from jointid.common.text import join
from jointid.estimation.parameters import adjust_parameters, of_law
from jointid.estimation.problems.simulated import ClosedLoopProblem, Simulated, beginning_position, loop_log
from jointid.estimation.result.agreement import Alone, Window, compare_records, drift
from jointid.estimation.result.estimate import (
    Estimate,
    Windows,
    build_estimate,
    build_rows,
    warn_of_limit,
)
from jointid.estimation.robots.simulated import at_estimate
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import RobotLoop
from jointid.records.chunks import Chunk, LongRecord
from jointid.records.record import Channel, Record
from jointid.records.resampling import period_ratio
from jointid.simulation.simulate import Outcome
from jointid.simulation.start import INITIAL
from jointid.solvers.solve import LevenbergMarquardt, Solution, Status, damped_step, solve
from jointid.uncertainty.covariance import Covariance, Influence, Sums, covariance_of, larger, left_out, rows_of, total
from jointid.uncertainty.identifiability import find_separable, identifiability
from jointid.uncertainty.position_dependent_error import RESTING, cells, uncertainty

FitRecord: TypeAlias = Callable[..., Estimate]
"""From a record, its loop and ``parameters``, which are changes to those, to the estimate of the record by itself."""

FitWindow: TypeAlias = Callable[[Sequence[Record], bool], Estimate]
"""From the records of a window, one of each joint, and whether it is not the first, to its own estimate."""

# Several records

GAIN = "drive_gain"  # the torque that acts, over the torque in the log; one record does not show it


class Layout(NamedTuple):
    """How several records belong together, one entry for each.

    Attributes:
        loops: the joint, of one model, under the controller of each.
        added: inertia that is known to come on top of the joint's, kg or kg m2.
        own: names of the parameters that the others do not share.
        free: names of identified numbers around the joint.
    """

    loops: tuple[ClosedLoop, ...]
    added: tuple[float, ...]
    own: tuple[Sequence[str], ...]
    free: tuple[str, ...] = ()

    @property
    def scales(self) -> bool:
        """True if the drive's gain is free; records then scale per log."""
        return GAIN in self.free

    def changes(self, known: Mapping[str, Parameter], number: int) -> Mapping[str, Parameter]:
        """Adapt parameter changes to one record by itself, with its added inertia.

        If the gain of the drive is unknown, these are per torque of its log, and no bound can be moved.
        """
        own, more = _inertia(self.loops[0].joint), self.added[number]
        if not more:
            return known
        given, room = known.get(own.name, own), 0.0 if self.scales else more
        start = None if given.start is None else given.start + more
        return {**known, own.name: replace(given, start=start, lower=given.lower + room, upper=given.upper + room)}


def lay_out(
    count: int, loops: ClosedLoop | Sequence[ClosedLoop], free: Sequence[str], several: Mapping[str, Any]
) -> Layout:
    """Relations of records, from `several` of `jointid.identify`.

    Raises:
        MethodError: a list is not as long as the records; an added inertia is impossible; the joints are not of one
            model; or a name of `own` is not one of its parameters.
    """
    asked: dict[str, Any] = {"added_inertia": [0.0] * count, "own": [()] * count, "free": ()}
    names = {*asked}
    asked |= {key: value for key, value in several.items() if value is not None}
    each: Any = [loops] * count if isinstance(loops, ClosedLoop) else loops
    listed: list[Any] = [each, asked["added_inertia"], asked["own"]]
    long = all(hasattr(one, "__len__") and len(one) == count for one in listed)
    lists = [asked["free"], *asked["own"], *asked["added_inertia"]] if long else []
    if count < 2 or asked.keys() != names or not long or any(isinstance(one, str) for one in lists):
        raise MethodError(
            "Several records are two or more, with one loop for all or one for each, and `several` has an "
            "added_inertia and an own, a list of names, for each of them, and free, a list of names; received "
            f"{count} records and {dict(several)!r}: correct it."
        )
    found = Layout(
        tuple(each),
        tuple(map(float, asked["added_inertia"])),
        tuple(asked["own"]),
        tuple(dict.fromkeys((*asked["free"], *free))),
    )
    if not all(math.isfinite(more) and more >= 0.0 for more in found.added):
        raise MethodError(f"An added inertia is 0 or more; received {found.added}: subtract the smallest from all.")
    joint = found.loops[0].joint
    if joint.torque_unit and any(found.added) and not found.scales:
        raise MethodError(
            f"An added inertia is in SI units, but the joint's are per {joint.torque_unit}; free drive_gain, which "
            "the added inertia shows, or give the torque in SI units."
        )
    known = {p.name for p in joint.parameters} | {*found.free} - {GAIN}
    pairs = [(known - {_inertia(joint).name} if more else known, mine) for more, mine in zip(*found[1:3], strict=True)]
    wrong = [name for may, mine in pairs for name in mine if name not in may]
    if wrong or len({(loop.joint.kind, *(p.name for p in loop.joint.parameters)) for loop in each}) > 1:
        raise MethodError(
            "Records that are fitted together have one model of joint, and their own are parameters that are free "
            f"and have nothing added; received {join(wrong) or 'several models'}: correct it."
        )
    return found


def _inertia(joint: Joint) -> Parameter:
    """The inertia to which others are added: that of the load."""
    return next(p for p in reversed(joint.parameters) if p.quantity is Quantity.INERTIA)


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """The torques of several records against one joint: a problem of `solvers.solve`.

    A record's own parameters are per torque of its log: the common ones plus known additions, over the drive's gain.

    Attributes:
        problems: one for each record.
        parameters: in the order of the table, fixed ones too.
        free: identified parameters: first the shared ones, then those of each record.
        labels: for each record, the names of its parameters among the free ones, (its free,); empty for a known one.
        known: for each record, the value of a known one, and known additions to the others, (its free,).
        sigma: (records,) levels of the residuals, by which their rows are divided.
        last: the rows of the last candidate, not divided.
    """

    problems: tuple[ClosedLoopProblem, ...]
    parameters: tuple[Parameter, ...]
    free: tuple[Parameter, ...]
    labels: tuple[Sequence[str], ...]
    known: tuple[FloatArray, ...]
    sigma: FloatArray
    last: dict[bytes, list[tuple[FloatArray, FloatArray]]] = field(default_factory=dict)

    @property
    def of_gain(self) -> list[int]:
        """Index of the drive's gain among free parameters; empty if fixed."""
        return [i for i, p in enumerate(self.free) if p.name == GAIN]

    def gain(self, x: FloatArray) -> float:
        """Return the gain of the drive, 1 where it is not free."""
        return float(np.prod(x[self.of_gain]))

    @property
    def maps(self) -> list[FloatArray]:
        """Selection matrix of each record's parameters, (its free, free)."""
        return [np.array([[float(p.name == label) for p in self.free] for label in own]) for own in self.labels]

    def join(self, found: Sequence[FloatArray], gain: float) -> FloatArray:
        """Combine records' parameters: means of shared ones, clipped to bounds."""
        total, count = np.zeros(len(self.free)), np.zeros(len(self.free))
        total[self.of_gain], count[self.of_gain] = gain, 1.0
        for problem, among, known, own in zip(self.problems, self.maps, self.known, found, strict=True):
            total += among.T @ (own * _scale(problem, gain) - known)
            count += among.sum(axis=0)
        return Bounds.of(self.free).clip(total / count)

    def split(self, x: FloatArray) -> list[FloatArray]:
        """Parameters of each record, (its free,), from the free ones."""
        each, gain = zip(self.problems, self.maps, self.known, strict=True), self.gain(x)
        return [(among @ x + known) / _scale(problem, gain) for problem, among, known in each]

    def rows(self, x: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Residual of each record, (rows,), and derivatives, (rows, free)."""
        if (key := x.tobytes()) not in self.last:
            self.last.clear()
            self.last[key], gain = [], self.gain(x)
            for problem, among, own in zip(self.problems, self.maps, self.split(x), strict=True):
                error, slopes = problem.linearise(own)
                J, joint = slopes / _scale(problem, gain) @ among, len(problem.free_joint)
                J[:, self.of_gain] = -(slopes[:, :joint] @ own[:joint] / gain)[:, np.newaxis]
                self.last[key].append((error, J))
        return self.last[key]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residual, (rows,), and its derivatives, (rows, free)."""
        pairs = list(zip(self.rows(x), self.sigma, strict=True))
        return np.concatenate([e / s for (e, _), s in pairs]), np.concatenate([J / s for (_, J), s in pairs])

    def weigh(self, x: FloatArray) -> Records:
        """Weight the problem by the levels of the residuals at a candidate."""
        least = 1e-6 * max(problem.size for problem in self.problems)  # no residual is taken for smaller
        levels = [max(float(np.linalg.norm(error)), least) / math.sqrt(error.size) for error, _ in self.rows(x)]
        return replace(self, sigma=np.array(levels))


def share_parameters(problems: Sequence[ClosedLoopProblem], layout: Layout, known: Mapping[str, Parameter]) -> Records:
    """Pose the problem of several records, with changes to their joint's parameters."""
    joint, labels, found, free = problems[0].joint, list[list[str]](), list[FloatArray](), dict[str, Parameter]()
    stated, inertia = {p.name: p for p in adjust_parameters(joint.parameters, known)}, _inertia(joint).name
    if layout.scales:  # one that is known is per torque of the log, too
        every = {p.name: replace(p, free=True) for p in joint.parameters}
        problems = [one.replace_parameters(every) for one in problems]
    for k, (problem, mine, more) in enumerate(
        zip(problems, _apart(problems, layout.own), layout.added, strict=True), 1
    ):
        each = [stated.get(p.name, p) for p in problem.free]
        ends = [f"@{k}" if p.name in mine else "" for p in each]
        labels.append([p.name + end if p.free else "" for p, end in zip(each, ends, strict=True)])
        found.append(np.array([more * (p.name == inertia) + (0.0 if p.free else p.start or 0.0) for p in each]))
        for p, end, label in zip(each, ends, labels[-1], strict=True):
            if label:
                free.setdefault(label, replace(p, name=label, symbol=p.symbol + end))
    if layout.scales:
        free[GAIN] = Parameter(GAIN, "g", Quantity.RATIO, start=1.0, lower=1e-3)
    order = sorted(free, key=lambda name: int(name.partition("@")[2] or 0))  # what is shared comes first
    shared = {
        p.name: free.get(p.name) or p.fix(p.start or 0.0)
        for p in (stated.get(p.name, p) for p in problems[0].parameters)
        if p.name in free or not (p.free or p.name in INITIAL)
    }
    free = {name: free[name] for name in order}
    parameters, ones = tuple((shared | free).values()), np.ones(len(problems))
    return Records(tuple(problems), parameters, tuple(free.values()), tuple(labels), tuple(found), ones)


def _scale(problem: ClosedLoopProblem, gain: float) -> FloatArray:
    """Factor per parameter, (free,): the gain for joint parameters, else 1."""
    return np.where(np.arange(len(problem.free)) < len(problem.free_joint), gain, 1.0)


def _apart(problems: Sequence[ClosedLoopProblem], own: Sequence[Sequence[str]]) -> list[set[str]]:
    """Names of each record's free parameters that no other record shares."""
    around = {(p.name, p.start) for one in problems for p in one.free if p in one.around and of_law(p.name)}
    differing = {name for name, starts in Counter(name for name, _ in around).items() if starts > 1}
    apart = [{*mine, *INITIAL, *differing} for mine in own]
    pairs = zip(problems, apart, strict=True)
    shared = Counter(p.name for one, mine in pairs for p in one.free if p.name not in mine)
    return [mine | {name for name, records in shared.items() if records == 1} for mine in apart]


def identify_records(
    records: Sequence[Record],
    layout: Layout,
    known: Mapping[str, Parameter],
    fit: FitRecord,
    progress: Progress,
) -> Estimate:
    """Fit one joint to several records; see `jointid.identify`.

    Raises:
        MethodError: no record determines a parameter, or nothing determines the drive's gain.
    """
    fits = list[Estimate]()
    for k, (record, loop) in enumerate(zip(records, layout.loops, strict=True)):
        progress(f"record {k + 1}, {record.name}, by itself")
        fits.append(fit(record, loop, parameters=layout.changes(known, k)))
    problems, gain = [_require_solution(one)[0] for one in fits], 1.0
    identified = [{row.name: row.value for row in one.rows if row.value is not None} for one in fits]
    starts = fill_starts(identified, [p.name for p in problems[0].parameters])
    together = share_parameters(problems, layout, known)
    if layout.scales and any(layout.added):  # the slope of what is added over the inertias that were found
        change = np.array([start[_inertia(problems[0].joint).name] for start in starts])
        change -= change.mean()
        slope = float(change @ layout.added) / (float(change @ change) or 1.0)
        gain = slope if slope > 0 else 1.0
    progress(f"{len(records)} records together, {len(together.free)} parameters")
    own = [one.vector(start) for one, start in zip(together.problems, starts, strict=True)]
    solution, together, made = _search(together, together.join(own, gain))
    progress(Detail(solution.message))
    return _judge(together, layout, solution, records, fits, made)


def _search(together: Records, x: FloatArray) -> tuple[Solution, Records, int]:
    """Solve from a start, (free,); return solution, reweighted problem and evaluations."""
    together, made = together.weigh(x), 1
    J = together.linearise(x)[1]
    if not all(find_separable(J)[together.of_gain]):
        raise MethodError(
            "The drive's gain cannot be distinguished from the scale of the joint's parameters, because no two records "
            "differ by a known inertia; give the inertia added to the load in one of them, or keep the gain fixed."
        )
    # Of a row's noise, squared: a step worth less moves no parameter by a hundredth deviation.
    solver = LevenbergMarquardt(worth=1e-4 / len(J), enough=1e-3 * math.sqrt(len(J)))
    for _ in range(4):  # searches with new levels of the residuals, at most
        solution = solve(together, solver, x)
        x, made = solution.x, made + solution.evaluations
        weighed = together.weigh(x)
        if np.all(np.abs(np.log(weighed.sigma / together.sigma)) < 0.01):
            break
        together = weighed
    else:
        solution = replace(solution, status=Status.EVALUATION_LIMIT, message="not converged: weights still change")
    return solution, together, made * len(together.problems)


def _require_solution(fit: Estimate) -> tuple[ClosedLoopProblem, FloatArray]:
    assert fit.problem is not None and fit.x is not None
    return fit.problem, fit.x


def fill_starts(each: Sequence[Mapping[str, float]], names: Sequence[str]) -> list[dict[str, float]]:
    """Start values of each record; missing ones are taken from other records.

    Raises:
        MethodError: no record determines one of these names.
    """
    anywhere = {name: value for values in reversed(each) for name, value in values.items()}
    if lost := [name for name in names if name not in anywhere]:
        raise MethodError(
            f"No record by itself shows {', '.join(lost)}, so nothing is known to start from; "
            "identify the joint as rigid, or record a motion that shows it."
        )
    return [{**anywhere, **values} for values in each]


def _judge(
    together: Records,
    layout: Layout,
    solution: Solution,
    records: Sequence[Record],
    fits: Sequence[Estimate],
    made: int,
) -> Estimate:
    """Joint fit of all records, and each alone; `made` counts evaluations."""
    x, names, problems = solution.x, [p.name for p in together.free], together.problems
    joint, gain, at = problems[0].joint, together.gain(x), [problem.log.kept for problem in problems]
    values = {p.name: float(p.start or 0.0) for p in together.parameters} | dict(zip(names, map(float, x), strict=True))
    runs = [problem.simulate(own) for problem, own in zip(problems, together.split(x), strict=True)]
    shown = [(run.motor_position[k], run.motor_velocity[k]) for k, run in zip(at, runs, strict=True)]
    influence = Influence(solution.jacobian, solution.residual, series=[rows.size for rows in at])
    found = uncertainty(influence, cells(*map(np.concatenate, zip(*shown, strict=True))))
    found = found.widened_by(_compute_shift(together, influence, fits, gain))
    left = [p.filtered_error(error) for p, (error, _) in zip(problems, together.rows(x), strict=True)]
    alone = [
        replace(_describe_record(fit, together, k, gain), name=records[k].name, filtered_error=left[k])
        for k, fit in enumerate(fits)
    ]
    acting = replace(joint, torque_unit=None) if layout.scales else joint
    units = {p.name: acting.unit(p) for p in together.parameters}
    if GAIN in units and joint.torque_unit:
        units[GAIN] = f"{acting.force_unit}/{joint.torque_unit}"
    # The inertia that determines the gain is not compared.
    tells = _inertia(joint).name if layout.scales and any(layout.added) else ""
    compared = compare_records(alone, {name: unit for name, unit in units.items() if name != tells})
    more = {p.name: p.widening for p in compared.parameters}  # beyond their noise
    covariance = covariance_of(found.covariance.matrix + np.diag([more.get(name, 0.0) for name in names]))
    std = dict(zip(names, map(float, covariance.std), strict=True))
    held = find_active_bounds(together.free, x, solution.residual, solution.jacobian)
    loop = problems[0].loop_at(together.split(x)[0])
    repeats = [str(found.repeatable)] if found.repeatable.significant else []
    said = [f"record {k}: {one}" for k, fit in enumerate(fits, 1) for one in fit.warnings]
    sizes = np.array([problem.size for problem in problems])
    own = {p.name for p in joint.parameters}
    rows = build_rows(together.parameters, values, std, lambda p: units[p.name], own, held)
    order = [names.index(row.name) for row in rows if row.free]
    made_of = build_estimate(
        records,
        rows,
        covariance.correlation[np.ix_(order, order)],
        (np.concatenate([p.measured for p in problems]), np.concatenate([run.torque for run in runs])),
        float(np.linalg.norm(left * sizes) / np.linalg.norm(sizes)),
        sum(rows.size for rows in at),
        (solution.message, solution.status.converged),
        sum(fit.fit.simulations for fit in fits) + made,
        replace(fits[0].settings, loop=loop, delay=loop.controller.law(problems[0].sample_time).delay),
        [name for one in layout.loops for name in one.channels],
        agreement=compared,
        warnings=(*map(str, found.warnings), *repeats, *said),
    )
    return replace(made_of, data=replace(made_of.data, torque_unit=acting.force_unit))


def _compute_shift(together: Records, influence: Influence, fits: Sequence[Estimate], gain: float) -> FloatArray:
    """Propagate the systematic shifts of the records' solutions to the common one."""
    moved, first = np.zeros(len(together.free)), 0
    for problem, among, fit in zip(together.problems, together.maps, fits, strict=True):
        rows = slice(first, first := first + problem.log.kept.size)
        answer = influence.matrix[:, rows] @ influence.J[rows] @ among.T * _scale(problem, gain)
        each = [dict(zip((p.name for p in _require_solution(fit)[0].free), shift, strict=True)) for shift in fit.shifts]
        squares = [(answer @ [by.get(p.name, 0.0) for p in problem.free]) ** 2 for by in each]
        moved += np.sqrt(np.sum(squares, axis=0))  # records may err alike
    return moved


def _describe_record(fit: Estimate, together: Records, number: int, gain: float) -> Alone:
    """Fit of one record, numbered from 0, in terms of acting torque."""
    (problem, x), known = _require_solution(fit), fit.parameters
    separable = dict(zip(fit.free, find_separable(problem.linearise(x)[1]), strict=True))
    names, values, std = list[str](), dict[str, float](), list[float]()
    shared = zip(together.problems[number].free, together.labels[number], together.known[number], strict=True)
    for p, label, more in shared:
        row = known.get(p.name)
        if row is None or row.value is None or not row.stderr or row.at_bound is not None or not separable[p.name]:
            continue
        scale = gain if row.of_joint else 1.0
        names.append(p.name)
        values[label] = scale * row.value - float(more)
        # Where a torque is reproduced to rounding, records differ by rounding, which no deviation knows.
        std.append(max(scale * row.stderr, 1e-8 * abs(scale * row.value)))
    return Alone(values, Covariance(np.array(std), fit.covariance_of(names).correlation))


# Windows of a long log

_PLACES = 6  # stretches of the travel: what a place errs, its neighbourhood errs alike (`position_dependent_error`)
_AROUND = 64  # stretches after which places are taken to come again: an axis may turn for ever

NO_MOTION = "In no window of this record does the axis move; give another record."
ONE_LENGTH = "The log of a joint ends before those of other joints: cut the logs of a robot to one length."

Places: TypeAlias = Callable[[FloatArray, FloatArray], NDArray[np.intp]]
"""From positions and velocities, (rows,) each, to the number of each row's stretch of the travel, (rows,)."""


def places_of(position: FloatArray, velocity: FloatArray) -> Places:
    """Function that labels stretches of travel by direction and speed class."""
    speeds = cells(position, velocity).speeds
    origin, width = float(position.min()), (float(np.ptp(position)) or 1.0) / _PLACES
    resting = RESTING * float(np.max(np.abs(velocity)))

    def label(position: FloatArray, velocity: FloatArray) -> NDArray[np.intp]:
        moving = np.abs(velocity) > resting
        kind = np.argmin(np.abs(np.abs(velocity)[:, np.newaxis] - speeds), axis=1)
        family = np.where(moving, np.sign(velocity), 0.0).astype(np.intp) + 1
        place = np.floor((position - origin) / width).astype(np.intp) % _AROUND
        return np.asarray((family * speeds.size + np.where(moving, kind, 0)) * _AROUND + place, dtype=np.intp)

    return label


def travel(records: Sequence[Record]) -> float:
    """Total variation of the references, or of the injections, in a window."""
    asked: list[Channel | None] = [record.injected.channel for record in records if record.injected is not None]
    asked = asked or [record.motor_position if record.reference is None else record.reference for record in records]
    return float(sum(np.sum(np.abs(np.diff(one.values))) for one in asked if one is not None))


def moves(records: Sequence[Record]) -> bool:
    """Test for a window with motion or injection, and a nonzero torque."""
    braked = all(one.torque is not None and not np.any(one.torque.values) for one in records)
    return not braked and (travel(records) > 0 or any(one.injected is not None for one in records))


def begin_window(like: Any, loop: ClosedLoop | RobotLoop, records: Sequence[Record], wrong: float = 0.0) -> Any:
    """Problem of a window like another one's, that begins in the middle of a motion.

    Its initial state may be wrong on purpose, by a share of the window's torque and speed.
    """
    log = loop_log(loop, records, "rigid", like.filtering)  # which is resolved, for any model
    experiment, problem = log.experiment, replace(like, logs=(log,))
    speeds = wrong * np.std(np.diff(log.poses, axis=0), axis=0) / log.sample_time
    if log.tree is not None:
        v, a = np.array([axis.reference_motion for axis in experiment.axes]).T
        return problem.with_log(experiment=replace(experiment, speeds=v + speeds, accelerations=a.copy()))
    ((record,), axis) = records, experiment.axis
    assert record.torque is not None
    measured = record.torque.values[: len(log.measured)]
    torque = float(like.filtering.decimate(measured, like.sample_time)[0])  # a single sample has all of the noise
    velocity = float(axis.inputs[1, REFERENCE] - axis.inputs[0, REFERENCE]) / axis.law.period + float(speeds[0])
    torque += wrong * float(np.std(measured))
    position = beginning_position(problem, velocity, torque)
    # What an integral holds is one constant along the log, and no window's own.
    problem = problem.with_log(seen=(None,), measured=measured[:, np.newaxis]) if axis.law.integrates else problem
    return problem.keeping({"initial_position": position, "initial_velocity": velocity, "initial_torque": torque})


def settling(like: Simulated, other: Simulated, x: FloatArray) -> int:
    """Return how many samples a window takes to forget how it began.

    The other one's beginning has an error of the window's whole torque and speed, larger than in any window. It must
    affect no later sample of a torque by more than a hundredth, filter included.
    """
    first, second = (one.predict(one.run(x, keep=False)) for one in (like, other))
    apart = np.any(np.abs(first - second) > 0.01 * np.std(like.log.measured, axis=0), axis=1)
    remembers = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    assert like.filtering.cutoff is not None
    return remembers + math.ceil(10.0 / (like.filtering.cutoff * like.sample_time))  # the filter rings


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """Sums of one pass over the windows.

    Attributes:
        windows: in the order of time. places: over all of them, by joint and place.
        still: windows without commanded motion, which are left out.
        stopped: why the simulation of a window stopped, in a sentence; empty if none did.
    """

    windows: tuple[Window, ...]
    places: Mapping[tuple[int, int], Sums]
    still: int
    stopped: str

    @property
    def sums(self) -> Sums:
        """Over all windows."""
        return total([w.sums for w in self.windows])

    @property
    def errors(self) -> FloatArray:
        """Residual share of each joint's filtered torque, (n,)."""
        joints = sorted({joint for joint, _ in self.places})
        each = ([sums for (of, _), sums in self.places.items() if of == joint] for joint in joints)
        return np.array([total(own).relative_error for own in each])

    def shift(self, step: FloatArray) -> Pass:
        """The pass after a small parameter step, to first order."""
        windows = tuple(replace(w, sums=w.sums.shift(step)) for w in self.windows)
        return replace(self, windows=windows, places={at: sums.shift(step) for at, sums in self.places.items()})

    def covariance(self) -> Covariance:
        """Covariance: the larger of leaving out windows and leaving out places.

        Raises:
            MethodError: one window does not determine the scatter of windows.
        """
        if len(self.windows) < 2:
            raise MethodError(
                "A long record has two windows or more, in which the axis moves; this one has "
                f"{len(self.windows)}: give a shorter window, or leave windows out."
            )
        found = left_out([w.sums for w in self.windows])
        return larger(found, left_out([*self.places.values()])) if len(self.places) > 1 else found


@dataclass(frozen=True, slots=True, eq=False)
class WindowsOfLog:
    """Windows of a log against a joint's or robot's loop, with fewest equivalent rows.

    Attributes:
        like: the problem of the window that the search starts from.
        loop: that is simulated.
        logs: the long log of each joint.
        places: of each joint, labels of repeating places.
        length: samples that count in a window.
        settling: samples at either end of a window that are simulated and not counted.
        progress: receives the progress of a pass.
        passes: completed passes, by their candidates.
    """

    like: Simulated
    loop: ClosedLoop | RobotLoop
    logs: tuple[LongRecord, ...]
    places: Sequence[Places]
    length: int
    settling: int
    progress: Progress
    passes: dict[bytes, Pass] = field(default_factory=dict)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return self.like.free

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows equivalent to all windows: residual, (rows,), and derivatives, (rows, free)."""
        return rows_of(self.pass_over(x).sums)

    def pass_over(self, x: FloatArray) -> Pass:
        """Return the sums at a candidate, from a pass over all windows.

        Raises:
            MethodError: in no window does the axis move.
        """
        if (key := x.tobytes()) in self.passes:
            return self.passes[key]
        windows, places, still, stopped = list[Window](), dict[tuple[int, int], Sums](), 0, ""
        chunks = chunks_of(self.logs, self.length, 2 * self.settling)
        for first, records in follow(chunks, self.progress, "passing over the log", math.inf, "windows"):
            if not moves(records):
                still += 1
                continue
            try:
                problem = begin_window(self.like, self.loop, records).with_log(ends=2 * (self.settling,))
                error, J, run = problem.rows(problem.log, x)
            except RecordError:
                if not (first.number and first.last):  # a last one may be too short for filters
                    raise
                continue
            if not (at := problem.log.kept).size:
                continue
            if run.outcome is not Outcome.FINISHED:
                begin = f"The window that begins at {first.record.begin:.0f} s"
                stopped = f"{begin} cannot be simulated, {run.outcome.value}"
            rows, keep = [problem.weigh(one) for one in (error, J, problem.filtered_torque)], problem.step
            moved = zip(self.places, *(one[at].T for one in _commanded(problem)), strict=True)
            labels = [label(*each) for label, *each in moved]
            for joint, label in enumerate(labels):
                own = [one[joint * at.size : (joint + 1) * at.size] for one in rows]
                for place in map(int, np.unique(label)):
                    sums, of = Sums.of(*(one[label == place] for one in own)), (joint, place)
                    places[of] = places[of] + sums if of in places else sums
            begin, end = (first.record.begin + one * problem.sample_time for one in (at[0], at[-1] + keep))
            windows.append(Window(begin, end, Sums.of(*rows), run.at_limit))
        if not windows:
            raise MethodError(NO_MOTION)
        self.passes[key] = Pass(tuple(windows), places, still, stopped)
        return self.passes[key]


def chunks_of(logs: Sequence[LongRecord], length: int, overlap: int) -> Iterator[tuple[Chunk, list[Record]]]:
    """Chunks of joints' logs: the first joint's, and all records."""
    for each in zip_longest(*(log.chunks(length, overlap) for log in logs)):
        if None in each:
            raise MethodError(ONE_LENGTH)
        yield each[0], [chunk.record for chunk in each]


def _commanded(problem: Simulated) -> tuple[FloatArray, FloatArray]:
    """Return the references of a window and their velocities, (samples, n) each."""
    position: FloatArray = problem.log.poses
    return position, np.gradient(position, problem.sample_time, axis=0)


def identify_windows(
    logs: Sequence[LongRecord], loop: Any, fit: FitWindow, window: float, progress: Progress
) -> Estimate:
    """Estimate a joint or a robot from a long log in windows; see `jointid.identify`.

    Args:
        logs: of the joint, or of each joint of the robot.
        loop: that is simulated.
        fit: of one window.
        window: its length, s.
        progress: receives the passes.

    Raises:
        RecordError, MethodError: no window by itself identifies the joint, or one cannot be simulated.
    """
    sample_time, spans = logs[0].sample_time, [log.record.duration for log in logs if hasattr(log, "record")]
    if spans and max(spans) - min(spans) > 1.5 * sample_time:  # of files it shows at the end of the first pass
        raise MethodError(ONE_LENGTH)
    # Whole rows, so that all windows keep the same samples, and whole periods of controllers that are slower than the
    # log: the first of a law is at a window's first sample.
    laws = [one.controller.law(sample_time) for one in loop.loops]
    period = math.lcm(*(period_ratio(law.period, sample_time, "the log")[0] for law in laws))

    def samples(seconds: float, unit: int) -> int:
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    began, first = _start(logs, (samples(window, period), 2 * samples(window / 20, period)), fit, progress)
    if began.robot is None:
        of_window, x = _require_solution(began)
        like = begin_window(of_window, loop, first)
        x = like.vector(of_window.values(x))
    else:
        of_robot: Any = began.solved
        like = replace(of_robot.problem, parameters=of_robot.parameters.without_logarithms())
        x = like.parameters.to_search_variables(began.robot.values)
        like = like.reweight(like.error(of_robot.runs), x.size)
    keep, needed = like.step, settling(like, begin_window(like, loop, first, wrong=1.0), x)
    length, needed = samples(window, math.lcm(keep, period)), keep * -(-needed // keep)
    settled = min(needed, length // (2 * keep) * keep)
    forgets = f"a window forgets how it began in {needed * sample_time:g} s"
    progress(Detail(forgets))
    moved = zip(*(one.T for one in _commanded(like)), strict=True)
    problem = WindowsOfLog(like, loop, tuple(logs), [places_of(*one) for one in moved], length, settled, progress)
    sums = problem.pass_over(x).sums

    def watch(norm: float) -> None:
        progress(Detail(f"pass {len(problem.passes)}: torque error {100 * norm / math.sqrt(sums.size):.4f} %"))

    enough = 1e-6 * math.sqrt(sums.size)  # of the torque: a residual as good as none
    # Of a row's noise, squared: a step worth less moves no parameter by a third of a deviation.
    solution = solve(problem, LevenbergMarquardt(1e-8, 12, worth=0.1 / sums.rows, enough=enough), x, watch)
    found, x = problem.pass_over(solution.x), solution.x
    if found.stopped:
        raise MethodError(f"{found.stopped}: check the controller and the start, or begin from another window.")
    # What the last step promises is taken without another pass.
    step = damped_step(solution.residual, solution.jacobian, Bounds.of(problem.free).shift_to(x))
    found, x = found.shift(step), x + step
    covariance, sums, settings, part = found.covariance(), found.sums, began.settings, began.robot
    settings = replace(settings, variant=f"{settings.variant}, in windows")
    if part is None:
        settings = replace(settings, loop=(at := like.loop_at(x)), delay=at.controller.law(sample_time).delay)
    else:
        own = like.parameters.values(x)
        part = replace(part, setup=at_estimate(loop, like.parameters, own), values=own)
    units, values = {row.name: row.unit for row in began.rows}, like.values(x)
    held = find_active_bounds(like.free, x, solution.residual, solution.jacobian)
    std = {p.name: float(one) for p, one in zip(like.free, covariance.std, strict=True)}
    rows = tuple(  # without those of its own record
        replace(row, value=values[row.name], stderr=std.get(row.name), at_bound=held.get(row.name), lack_of_fit=0.0)
        for row in began.rows
        if row.of_joint or row.name in std
    )
    too_short = [f"{forgets}; give longer windows"] if needed > settled else []
    read = [log.record for log in logs if hasattr(log, "record")] or first
    made = build_estimate(
        read, rows, covariance.correlation, 2 * (np.zeros((0, len(logs))),), found.errors, sums.rows,
        (solution.message, solution.status.converged),
        began.fit.simulations + len(problem.passes) * len(found.windows), settings, began.data.channels,
        robot=part, window=began, agreement=drift(found.windows, x, problem.free, units),
        known=began.known and identifiability(problem.free, units, x, solution.jacobian, covariance),
        warnings=(*too_short, *warn_of_limit(float(np.mean([w.at_limit for w in found.windows])))),
    )  # fmt: skip
    span = Windows(
        length=length * sample_time,
        settling=settled * sample_time,
        count=len(found.windows),
        still=found.still,
        duration=found.windows[-1].end - found.windows[0].begin,
    )
    data = replace(made.data, resampled=None, windows=span)
    return replace(made, fit=replace(made.fit, passes=len(problem.passes)), data=data, records=())


def _start(
    logs: Sequence[LongRecord], cut: tuple[int, int], fit: FitWindow, progress: Progress
) -> tuple[Estimate, list[Record]]:
    """Estimate from the first window that identifies the joint or robot, and its records.

    Raises:
        RecordError, MethodError: none of the first does; the error of the last one.
    """
    refusal: RecordError | MethodError = MethodError(NO_MOTION)
    first = list(islice((each for each in chunks_of(logs, *cut) if moves(each[1])), 5))
    enough = 0.5 * max((travel(records) for _, records in first), default=0.0)  # windows with less are tried last
    for chunk, records in sorted(first, key=lambda one: travel(one[1]) < enough):
        progress(f"starting from the window that begins at {records[0].begin:g} s")
        try:
            found = fit(records, chunk.number > 0)
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        if not (lost := [row.name for row in found.rows if row.of_joint and row.value is None]):
            return found, records
        refusal = MethodError(
            f"A window does not show {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal
