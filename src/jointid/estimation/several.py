"""Several records of a joint in one fit.

Each is identified by itself, which gives the start, and what the record says alone. Least squares over the rows of all
follows, those of a record divided by the level of its residual, so that it counts for what it is worth.

Rows of different records do not err together in time; a place errs alike in all of them, where anything repeats with
the motion (`position_dependent_error`). Where the records disagree by more than their intervals allow, the answer says
so and widens what they share (`result.agreement`). What moves a record's own solution, beside noise
(`uncertainty_of_least_error`), moves the common one as far as the record weighs in it, and widens that.

A parameter of a record is one that all share, or that plus a number that is known, or its own, called ``name@number``
with the number of the record, from 1. The motor's first state is always a record's own; so is a number of the
controller that the records declare differently.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import TORQUE_UNIT, Bounds, Parameter, Quantity, unit_of
from jointid.common.text import join
from jointid.estimation.parameters import INITIAL, adjust_parameters, of_law
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.agreement import Alone, compare_records
from jointid.estimation.result.estimate import Estimate, build_estimate, build_rows, find_active_bounds
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Record
from jointid.solvers.solve import LevenbergMarquardt, Solution, solve
from jointid.uncertainty.covariance import Covariance, Influence
from jointid.uncertainty.identifiability import find_separable
from jointid.uncertainty.position_dependent_error import cells, uncertainty

_GAIN = "drive_gain"
_ROUNDING = 1e-8  # of a value
_QUIETEST = 1e-6  # of the largest torque: no record's residual is taken for smaller
_WORTH = 1e-4  # of the noise of a row, squared: a step that promises less moves no parameter by a hundredth deviation
_ROUNDED = 1e-3  # of the level: a residual that is as good as none
_TURNS = 4  # searches with new levels of the residuals, at most
_STEADY = 0.01  # a change of the levels that asks for no other

FitRecord: TypeAlias = Callable[[ClosedLoop, Record, Mapping[str, Parameter]], Estimate]
"""From a loop, a record and changes to the parameters to the estimate of the record by itself."""


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Shared and own parameters of several records, validated.

    Attributes:
        loops: one for each record.
        added: for each record, what is known to come on top of the shared parameters, by name.
        own: for each record, names of its parameters that the others do not share.
        free: names of what surrounds the joint and is identified too.
    """

    loops: tuple[ClosedLoop, ...]
    added: tuple[Mapping[str, float], ...]
    own: tuple[Sequence[str], ...]
    free: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, count: int, loops: ClosedLoop | Sequence[ClosedLoop], free: Sequence[str], several: Mapping[str, Any]
    ) -> RecordLayout:
        """Return the layout of so many records.

        Args:
            count: of records.
            loops: one for all, or one for each.
            free: what the method identifies around the joint.
            several: what `jointid.identify` has under this name.

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
        more, joint = tuple(map(float, asked["added_inertia"])), each[0].joint
        if not all(math.isfinite(m) and m >= 0.0 for m in more):
            raise MethodError(f"An added inertia is 0 or more; received {more}: subtract the smallest from all.")
        every = tuple(dict.fromkeys((*asked["free"], *free)))
        if joint.torque_unit and any(more) and _GAIN not in every:
            raise MethodError(
                f"An added inertia is in SI units, but the joint's are per {joint.torque_unit}; free drive_gain, which "
                "the added inertia tells, or give the torque in SI units."
            )
        name = next(p.name for p in reversed(joint.parameters) if p.quantity is Quantity.INERTIA)
        added, own = tuple({name: m} if m else {} for m in more), tuple(asked["own"])
        known = {p.name for p in joint.parameters} | {*every} - {_GAIN}
        wrong = [one for mine, has in zip(own, added, strict=True) for one in mine if one not in known or one in has]
        if wrong or len({(loop.joint.kind, *(p.name for p in loop.joint.parameters)) for loop in each}) > 1:
            raise MethodError(
                "Records that are fitted together have one model of joint, and their own are parameters that are free "
                f"and have nothing added; received {join(wrong) or 'several models'}: correct it."
            )
        return cls(tuple(each), added, own, every)

    @property
    def joint(self) -> Joint:
        """The joint; they are of one model."""
        return self.loops[0].joint

    @property
    def scales(self) -> bool:
        """True if the gain of the drive is free: a record by itself has parameters per torque of its log."""
        return _GAIN in self.free

    @property
    def gaining(self) -> set[str]:
        """Names of the parameters that are added to in one of the records."""
        return {name for more in self.added for name in more}

    @property
    def torque_unit(self) -> str:
        """In which the parameters come."""
        return TORQUE_UNIT[self.joint.kind] if self.scales else self.joint.force_unit

    def unit(self, parameter: Parameter) -> str:
        """Return the unit of a parameter of the answer."""
        if parameter.name == _GAIN and self.joint.torque_unit:
            return f"{self.torque_unit}/{self.joint.torque_unit}"
        return unit_of(parameter.quantity, self.joint.kind, self.torque_unit)

    def changes(self, parameters: Mapping[str, Parameter], number: int, *, acting: bool) -> dict[str, Parameter]:
        """Return the changes to the parameters of one record: what was added is in its starts, values and bounds.

        Where the gain of the drive is not known, a record by itself has them per torque of its log, not per torque
        that is `acting`, and no bound can be moved.
        """
        found = dict(parameters)
        for name, more in self.added[number].items():
            p = found.get(name) or next(q for q in self.joint.parameters if q.name == name)
            moved = _shift(p, more)
            found[name] = moved if acting or not self.scales else replace(p, start=moved.start)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class SeveralRecords:
    """The torques of several records against one joint: a problem of `solvers.solve`.

    Attributes:
        problems: one for each record.
        parameters: in the order of the table, fixed ones too.
        free: those that are identified: first those that are shared, then those of each record.
        places: for each record, where each of its free parameters stands among those, (its free,).
        added: for each record, what is known to come on top of each, (its free,).
        sigma: (records,) levels of the residuals, by which their rows are divided.
        last: the rows of the last candidate, not divided.
    """

    problems: tuple[ClosedLoopProblem, ...]
    parameters: tuple[Parameter, ...]
    free: tuple[Parameter, ...]
    places: tuple[NDArray[np.intp], ...]
    added: tuple[FloatArray, ...]
    sigma: FloatArray
    last: dict[bytes, list[tuple[FloatArray, FloatArray]]] = field(default_factory=dict)

    def join(self, found: Sequence[FloatArray]) -> FloatArray:
        """Return the parameters that the records' own come from: means of those that are shared, within bounds."""
        total, count = np.zeros(len(self.free)), np.zeros(len(self.free))
        for place, added, own in zip(self.places, self.added, found, strict=True):
            np.add.at(total, place, own - added)
            np.add.at(count, place, 1.0)
        return Bounds.of(self.free).clip(total / count)

    def split(self, x: FloatArray) -> list[FloatArray]:
        """Return the parameters of each record, (its free,), from those of all."""
        return [x[place] + added for place, added in zip(self.places, self.added, strict=True)]

    def rows(self, x: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the residual of each record, (rows,), and its derivatives by all parameters, (rows, free)."""
        if (key := x.tobytes()) not in self.last:
            self.last.clear()
            self.last[key] = []
            for problem, place, own in zip(self.problems, self.places, self.split(x), strict=True):
                error, slopes = problem.linearise(own)
                J = np.zeros((error.size, x.size))
                J[:, place] = slopes
                self.last[key].append((error, J))
        return self.last[key]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residual, (rows,), and its derivatives, (rows, free)."""
        errors, slopes = zip(*self.rows(x), strict=True)
        weights = np.repeat(1.0 / self.sigma, [error.size for error in errors])
        return np.concatenate(errors) * weights, np.concatenate(slopes) * weights[:, np.newaxis]

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual, (rows,)."""
        return self.linearise(x)[0]

    def weigh(self, x: FloatArray) -> SeveralRecords:
        """Return the problem weighted by the levels of the residuals at a candidate."""
        least = _QUIETEST * max(problem.size for problem in self.problems)
        levels = [max(float(np.linalg.norm(error)), least) / math.sqrt(error.size) for error, _ in self.rows(x)]
        return replace(self, sigma=np.array(levels))


def share_parameters(problems: Sequence[ClosedLoopProblem], layout: RecordLayout) -> SeveralRecords:
    """Return the problem of several records.

    Args:
        problems: one for each record, of one model of joint.
        layout: how they belong together.
    """
    members, labels, added = dict[str, list[Parameter]](), list[list[str]](), list[FloatArray]()
    for k, (problem, mine) in enumerate(zip(problems, _apart(problems, layout.own), strict=True)):
        labels.append([f"{p.name}@{k + 1}" if p.name in mine else p.name for p in problem.free])
        added.append(np.array([layout.added[k].get(p.name, 0.0) for p in problem.free]))
        for p, label, more in zip(problem.free, labels[k], added[k], strict=True):
            members.setdefault(label, []).append(_shift(p, -float(more)))
    order = sorted(members, key=lambda name: int(name.partition("@")[2] or 0))  # what is shared comes first
    free = {
        label: replace(
            each[0],
            name=label,
            symbol=each[0].symbol + label.removeprefix(each[0].name),
            lower=max(p.lower for p in each),  # within the bounds of all of them
            upper=min(p.upper for p in each),
        )
        for label in order
        for each in [members[label]]
    }
    shared = {
        p.name: free.get(p.name) or p.fix((p.start or 0.0) - layout.added[0].get(p.name, 0.0))
        for p in problems[0].parameters
        if p.name in free or not (p.free or p.name in INITIAL)
    }
    places = tuple(np.array([order.index(label) for label in each], dtype=np.intp) for each in labels)
    parameters = tuple((shared | free).values())
    return SeveralRecords(tuple(problems), parameters, tuple(free.values()), places, tuple(added), np.ones(len(places)))


def _shift(parameter: Parameter, by: float) -> Parameter:
    """Return a parameter with start and bounds that much higher."""
    start = None if parameter.start is None else parameter.start + by
    return replace(parameter, start=start, lower=parameter.lower + by, upper=parameter.upper + by)


def _apart(problems: Sequence[ClosedLoopProblem], own: Sequence[Sequence[str]]) -> list[set[str]]:
    """Return, for each record, the names of its free parameters that it shares with no other."""
    joint, starts = {p.name for p in problems[0].joint.parameters}, dict[str, set[float | None]]()
    for p in (p for problem in problems for p in problem.free if p.name not in joint and of_law(p.name)):
        starts.setdefault(p.name, set()).add(p.start)
    differing = {name for name, values in starts.items() if len(values) > 1}
    apart = [set(mine) | set(INITIAL) | differing for mine in own]
    for name in {p.name for problem in problems for p in problem.free}:
        sharing = [k for k, q in enumerate(problems) if name not in apart[k] and name in {p.name for p in q.free}]
        if len(sharing) == 1 < len(problems):
            apart[sharing[0]].add(name)
    return apart


def identify_records(
    records: Sequence[Record],
    layout: RecordLayout,
    known: Mapping[str, Parameter],
    fit: FitRecord,
    progress: Progress,
) -> Estimate:
    """Return the fit of one joint to several records in one fit; see `jointid.identify`.

    Args:
        records: of the joint.
        layout: how they belong together.
        known: changes to its parameters.
        fit: what identifies a record by itself.
        progress: receives the steps.

    Raises:
        MethodError: no record tells a parameter, or nothing tells the drive's gain.
    """
    fits, acting = list[Estimate](), list[ClosedLoopProblem]()
    for k, (record, loop) in enumerate(zip(records, layout.loops, strict=True)):
        progress(f"record {k + 1}, {record.name}, by itself")
        fits.append(fit(loop, record, layout.changes(known, k, acting=False)))
        problem, joint = _solved(fits[k])[0], loop.joint.parameters
        shared = adjust_parameters(joint, layout.changes(known, k, acting=True))
        moved = replace(problem, parameters=(*shared, *problem.around))
        acting.append(moved.freeing(*layout.free))
    starts = fill_starts([_told(one) for one in fits], [p.name for p in _solved(fits[0])[0].parameters])
    gain, together = _gain(layout, starts), share_parameters(acting, layout)
    progress(f"{len(records)} records together, {len(together.free)} parameters")
    own = [one.vector(_act(start, layout, gain)) for one, start in zip(acting, starts, strict=True)]
    solution, together, made = _search(together, together.join(own))
    progress(Detail(solution.message))
    return _judge(together, layout, solution, records, fits, gain, made)


def _search(together: SeveralRecords, x: FloatArray) -> tuple[Solution, SeveralRecords, int]:
    """Return the solution from a start, (free,), the problem as it is weighted there, and the evaluations of it."""
    together, names, made = together.weigh(x), [p.name for p in together.free], 1
    J = together.linearise(x)[1]
    if _GAIN in names and not find_separable(J)[names.index(_GAIN)]:
        raise MethodError(
            "The drive's gain cannot be distinguished from the scale of the joint's parameters, because no two records "
            "differ by a known inertia; give the inertia added to the load in one of them, or keep the gain fixed."
        )
    for _ in range(_TURNS):
        solver = LevenbergMarquardt(worth=_WORTH / len(J), enough=_ROUNDED * math.sqrt(len(J)))
        solution = solve(together, solver, x)
        x, made = solution.x, made + solution.evaluations
        weighed = together.weigh(x)
        if np.all(np.abs(np.log(weighed.sigma / together.sigma)) < _STEADY):
            break
        together = weighed
    return solution, together, made * len(together.problems)


def _solved(fit: Estimate) -> tuple[ClosedLoopProblem, FloatArray]:
    assert fit.problem is not None and fit.x is not None
    return fit.problem, fit.x


def _told(fit: Estimate) -> dict[str, float]:
    """Return every parameter that a record tells by itself, by name, the fixed ones too."""
    (problem, x), told = _solved(fit), {p.name for p in fit.rows if p.value is not None}
    return {name: value for name, value in problem.values(x).items() if name in told}


def fill_starts(each: Sequence[Mapping[str, float]], names: Sequence[str]) -> list[dict[str, float]]:
    """Return the values each record starts from, by name; one that it does not tell is another record's.

    Raises:
        MethodError: no record tells one of these names.
    """
    anywhere = {name: value for values in reversed(each) for name, value in values.items()}
    if lost := [name for name in names if name not in anywhere]:
        raise MethodError(
            f"No record by itself tells {', '.join(lost)}, so nothing is known to start from; "
            "identify the joint as rigid, or record a motion that shows it."
        )
    return [{**anywhere, **values} for values in each]


def _act(values: Mapping[str, float], layout: RecordLayout, gain: float) -> dict[str, float]:
    """Return values in terms of the acting torque, `gain` times the logged one."""
    own = {p.name for p in layout.joint.parameters}
    return {n: gain * v if n in own else v for n, v in values.items()} | {_GAIN: gain}


def _gain(layout: RecordLayout, starts: Sequence[Mapping[str, float]]) -> float:
    """Return a start of the drive gain: the slope of the added values over those of separate fits."""
    name = next(iter(layout.gaining), None)
    if not layout.scales or name is None:
        return 1.0
    added = np.array([more.get(name, 0.0) for more in layout.added])
    found = np.array([values[name] for values in starts])
    change = found - found.mean()
    slope = float(change @ added) / (float(change @ change) or 1.0)
    return slope if slope > 0 else 1.0


def _judge(
    together: SeveralRecords,
    layout: RecordLayout,
    solution: Solution,
    records: Sequence[Record],
    fits: Sequence[Estimate],
    gain: float,
    made: int,
) -> Estimate:
    """Return the fit of all records, with what each says alone.

    Args:
        together: the problem.
        layout: how the records belong together.
        solution: of the problem.
        records: of the joint.
        fits: each record by itself.
        gain: of the drive, where it is not free.
        made: evaluations of the records for the solution.
    """
    x, names, count = (
        solution.x,
        [p.name for p in together.free],
        [error.size for error, _ in together.rows(solution.x)],
    )
    values = {p.name: float(p.start or 0.0) for p in together.parameters} | dict(zip(names, map(float, x), strict=True))
    gain = values.get(_GAIN, gain)
    runs = [problem.simulate(own) for problem, own in zip(together.problems, together.split(x), strict=True)]
    kept = [problem.kept for problem in together.problems]
    motion = [(run.motor_position[at], run.motor_velocity[at]) for run, at in zip(runs, kept, strict=True)]
    influence = Influence(solution.jacobian, solution.residual, series=count)
    found = uncertainty(influence, cells(*map(np.concatenate, zip(*motion, strict=True))))
    found = found.widened_by(_moved(together, layout, influence, fits, gain))
    pairs = zip(together.problems, together.rows(x), strict=True)
    left = [problem.filtered_error(error) for problem, (error, _) in pairs]
    alone = [
        replace(_describe_alone(fit, together, layout, k, gain), name=records[k].name, filtered_error=left[k])
        for k, fit in enumerate(fits)
    ]
    # The inertia that tells the gain is not compared.
    gained = layout.gaining if layout.scales else set()
    units = {p.name: layout.unit(p) for p in together.parameters if p.name not in gained}
    compared = compare_records(alone, units)
    covariance = compared.widen(found.covariance, names)
    std = dict(zip(names, map(float, covariance.std), strict=True))
    held = find_active_bounds(together.free, x, solution.residual, solution.jacobian)
    own = {p.name for p in layout.joint.parameters}
    loop = together.problems[0].loop_at(together.split(x)[0])
    repeats = [str(found.repeatable)] if found.repeatable.significant else []
    said = [f"record {k}: {one}" for k, fit in enumerate(fits, 1) for one in fit.warnings]
    sizes = np.array([problem.size for problem in together.problems])
    delay = loop.controller.law(together.problems[0].sample_time).delay
    rows = build_rows(together.parameters, values, std, layout.unit, own, held)
    order = [names.index(row.name) for row in rows if row.free]
    made_of = build_estimate(
        records,
        rows,
        covariance.correlation[np.ix_(order, order)],
        (np.concatenate([p.measured for p in together.problems]), np.concatenate([run.torque for run in runs])),
        float(np.linalg.norm(left * sizes) / np.linalg.norm(sizes)),
        sum(count),
        (solution.message, solution.converged),
        sum(fit.fit.simulations for fit in fits) + made + 2 * len(runs),
        replace(fits[0].settings, loop=loop, delay=delay),
        [name for one in layout.loops for name in one.channels],
        agreement=compared,
        warnings=(*map(str, found.warnings), *repeats, *said),
    )
    return replace(made_of, data=replace(made_of.data, torque_unit=layout.torque_unit))


def _moved(
    together: SeveralRecords, layout: RecordLayout, influence: Influence, fits: Sequence[Estimate], gain: float
) -> FloatArray:
    """Return by how much the common solution moves, (free,), where what is no noise moves those of the records."""
    moved, first = np.zeros(len(together.free)), 0
    for problem, place, fit in zip(together.problems, together.places, fits, strict=True):
        rows = problem.kept.size
        answer, slopes = influence.matrix[:, first : first + rows], influence.J[first : first + rows, place]
        squares = np.zeros(moved.size)
        for shift in fit.shifts:
            by = _act(dict(zip([p.name for p in _solved(fit)[0].free], shift, strict=True)), layout, gain)
            step = np.array([by.get(p.name, 0.0) * (p.name != _GAIN) for p in problem.free])
            squares += (answer @ slopes @ step) ** 2
        moved += np.sqrt(squares)  # records may err alike
        first += rows
    return moved


def _describe_alone(fit: Estimate, together: SeveralRecords, layout: RecordLayout, number: int, gain: float) -> Alone:
    """Return the fit of one record, numbered from 0, in terms of the acting torque."""
    (problem, x), known = _solved(fit), fit.parameters
    separable = dict(zip(fit.free, find_separable(problem.linearise(x)[1]), strict=True))
    names, values, std = list[str](), dict[str, float](), list[float]()
    shared = zip(together.problems[number].free, together.places[number], together.added[number], strict=True)
    for p, place, more in shared:
        row, scale = known.get(p.name), 1.0
        if row is None or row.value is None or not row.stderr or row.at_bound is not None or not separable[p.name]:
            continue
        if row.of_joint:
            scale = gain
        names.append(p.name)
        values[together.free[place].name] = scale * row.value - float(more)
        # Where a torque is reproduced to rounding, records differ by rounding, which no deviation knows.
        std.append(max(scale * row.stderr, _ROUNDING * abs(scale * row.value)))
    return Alone(values, Covariance(np.array(std), fit.covariance_of(names).correlation))
