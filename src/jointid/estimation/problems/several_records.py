"""The parameters of several records, which are one or belong to one.

The motor's first state is always a record's own; so is a number of the controller that the records declare differently.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT, Bounds, Parameter, Quantity, unit_of
from jointid.common.text import join
from jointid.estimation.problems.base import INITIAL, of_law
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.build_result import build_rows
from jointid.estimation.result.parts import Params
from jointid.models.joints import ClosedLoop, Joint
from jointid.uncertainty.covariance import Covariance


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
            MethodError: a list is not as long as the records, or an added inertia is impossible.
        """
        settings: dict[str, Any] = {"added_inertia": [0.0] * count, "own": [()] * count, "free": ()}
        if unknown := several.keys() - settings.keys():
            raise MethodError(f"Of several records there is no {join(sorted(unknown))}; expected {join([*settings])}.")
        if count < 2:
            raise MethodError(f"Two or more records are identified together; received {count}: use identify for one.")
        settings |= {key: value for key, value in several.items() if value is not None}
        each = (loops,) * count if isinstance(loops, ClosedLoop) else tuple(loops)
        for name, given in {"loops": each, **settings}.items():
            named, what = name == "free", f"one entry for each of the {count} records (of own, a list of names)"
            listed = bool(np.iterable(given))
            texts = listed and any(isinstance(one, str) for one in ([given] if named else given))
            if not listed or texts or (not named and len(given) != count):
                raise MethodError(f"{name} is {given!r}; expected {'a list of names' if named else what}: correct it.")
        own, more = tuple(settings["own"]), tuple(map(float, settings["added_inertia"]))
        names, joint = tuple(dict.fromkeys((*settings["free"], *free))), each[0].joint
        if any("drive_gain" in mine for mine in own):
            raise MethodError("The gain of the drive is one for all records; leave drive_gain out of own.")
        if not all(math.isfinite(m) and m >= 0.0 for m in more):
            raise MethodError(f"An added inertia is 0 or more; received {more}: subtract the smallest from all.")
        if joint.torque_unit and any(more) and "drive_gain" not in names:
            raise MethodError(
                f"An added inertia is in SI units, but the joint's are per {joint.torque_unit}; free drive_gain, which "
                "the added inertia tells, or give the torque in SI units."
            )
        name = next(p.name for p in reversed(joint.parameters) if p.quantity is Quantity.INERTIA)
        return cls(each, tuple({name: m} if m else {} for m in more), own, names)

    @property
    def joint(self) -> Joint:
        """The joint; they are of one model."""
        return self.loops[0].joint

    @property
    def scales(self) -> bool:
        """True if the gain of the drive is free: a record by itself has parameters per torque of its log."""
        return "drive_gain" in self.free

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
        if parameter.name.startswith("drive_gain") and self.joint.torque_unit:
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
class SharedParameters:
    """The parameters of several records.

    A parameter of a record is one that all share, or that plus a number that is known, or its own, called
    ``name@number`` with the number of the record, from 1.

    Attributes:
        layout: how they belong together.
        parameters: in the order of the table, fixed ones too.
        free: those that are identified: first those that are shared, then those of each record.
        places: for each record, where each of its free parameters stands among those, (its free,).
        added: for each record, what is known to come on top of each, (its free,).
    """

    layout: RecordLayout
    parameters: tuple[Parameter, ...]
    free: tuple[Parameter, ...]
    places: tuple[NDArray[np.intp], ...]
    added: tuple[FloatArray, ...]

    def join(self, found: Sequence[FloatArray]) -> FloatArray:
        """Return the parameters that the records' own come from: means of those that are shared, within bounds."""
        total, count = np.zeros(len(self.free)), np.zeros(len(self.free))
        for place, added, own in zip(self.places, self.added, found, strict=True):
            np.add.at(total, place, own - added)
            np.add.at(count, place, 1.0)
        return Bounds.of(self.free).clip(total / count)

    def table(self, x: FloatArray, covariance: Covariance, held: Mapping[str, float]) -> Params:
        """Return the table of the answer.

        Args:
            x: (free,) values.
            covariance: of their errors.
            held: the bounds of those at one, by name.
        """
        names = tuple(p.name for p in self.free)
        values = {p.name: float(p.start or 0.0) for p in self.parameters} | dict(zip(names, map(float, x), strict=True))
        std, own = (
            dict(zip(names, map(float, covariance.std), strict=True)),
            {p.name for p in self.layout.joint.parameters},
        )
        return Params(
            build_rows(self.parameters, values, std, self.layout.unit, own, held), names, covariance.correlation
        )


def share_parameters(problems: Sequence[ClosedLoopProblem], layout: RecordLayout) -> SharedParameters:
    """Return the parameters of several records.

    Args:
        problems: one for each record, of one model of joint.
        layout: how they belong together.

    Raises:
        MethodError: the joints are not of one model; a name is not one of a record's parameters; a parameter is its
            record's own and has something known added; or nothing tells the drive's gain.
    """
    _require_names(problems, layout)
    _require_scale(problems, layout)
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
    return SharedParameters(layout, tuple((shared | free).values()), tuple(free.values()), places, tuple(added))


def _shift(parameter: Parameter, by: float) -> Parameter:
    """Return a parameter with start and bounds that much higher."""
    start = None if parameter.start is None else parameter.start + by
    return replace(parameter, start=start, lower=parameter.lower + by, upper=parameter.upper + by)


def _require_names(problems: Sequence[ClosedLoopProblem], layout: RecordLayout) -> None:
    models = {(problem.joint.kind, *(p.name for p in problem.joint.parameters)) for problem in problems}
    if len(models) != 1:
        raise MethodError("Records that are fitted together have one model of joint, of one kind; give them the same.")
    for number, (problem, own, added) in enumerate(zip(problems, layout.own, layout.added, strict=True), 1):
        known = [p.name for p in problem.parameters]
        for name in (*own, *added):
            if name not in known or (name in own and name in added):
                raise MethodError(
                    f"Record {number} has {name} as its own, or with something added; expected one of both, and one of "
                    f"its parameters, {', '.join(known)}."
                )


def _require_scale(problems: Sequence[ClosedLoopProblem], layout: RecordLayout) -> None:
    """Refuse a free drive gain that all parameters of the joint can compensate."""
    if not any(p.name == "drive_gain" for problem in problems for p in problem.free):
        return
    joint = {p.name for p in layout.joint.parameters}
    known = any(p.start for problem in problems for p in problem.parameters if not p.free and p.name in joint)
    for name in layout.gaining:
        sharing = [m.get(name, 0.0) for m, mine in zip(layout.added, layout.own, strict=True) if name not in mine]
        known = known or len(set(sharing)) > 1
    if not known:
        raise MethodError(
            "The drive's gain cannot be distinguished from the scale of the joint's parameters, because no two records "
            "differ by a known inertia; give the inertia added to the load in one of them, or keep the gain fixed."
        )


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
