"""How several records of one joint belong together: under which loops, with what added, and what is free."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jointid.common.errors import MethodError
from jointid.models.joints import Joint
from jointid.models.parameters import TORQUE_UNIT, Parameter, Quantity, unit_of
from jointid.simulation.loop_input import ClosedLoop


@dataclass(frozen=True, slots=True)
class Arrangement:
    """What several records share and what is known to differ, checked and of one length.

    Attributes:
        loops: one for each record.
        added: for each record, what is known to come on top of the shared parameters, by name.
        free: names of what surrounds the joint and is identified too.
    """

    loops: tuple[ClosedLoop, ...]
    added: tuple[dict[str, float], ...]
    free: tuple[str, ...]

    @classmethod
    def of(
        cls,
        count: int,
        loops: ClosedLoop | Sequence[ClosedLoop],
        added: Sequence[float] | None,
        own: Sequence[Sequence[str]] | None,
        free: Sequence[str],
    ) -> Arrangement:
        """Return the arrangement of so many records; see `together.identify_together` for the arguments.

        Raises:
            MethodError: a list is not as long as the records, or an added inertia is impossible.
        """
        if count < 2:
            raise MethodError(f"Two or more records are identified together; received {count}: use identify for one.")
        each = (loops,) * count if isinstance(loops, ClosedLoop) else tuple(loops)
        more = tuple(map(float, added or [0.0] * count))
        for name, given in (("loops", each), ("added_inertia", more), ("own", own or [()] * count)):
            if len(given) != count or any(isinstance(one, str) for one in given):
                raise MethodError(
                    f"{name} has one entry for each of the {count} records (a list of names, of what is a record's "
                    f"own); received {given!r}."
                )
        if any("drive_gain" in mine for mine in own or ()):
            raise MethodError("The gain of the drive is one for all records; leave drive_gain out of own.")
        if not all(math.isfinite(m) and m >= 0.0 for m in more):
            raise MethodError(f"An added inertia is 0 or more; received {more}: subtract the smallest from all.")
        joint = each[0].joint
        if joint.torque_unit and any(more) and "drive_gain" not in free:
            raise MethodError(
                f"An added inertia is in SI units, but the joint's are per {joint.torque_unit}; free drive_gain, which "
                "the added inertia tells, or give the torque in SI units."
            )
        name = next(p.name for p in reversed(joint.parameters) if p.quantity is Quantity.INERTIA)
        return cls(each, tuple({name: m} if m else {} for m in more), tuple(free))

    @property
    def joint(self) -> Joint:
        """The joint; they are of one model."""
        return self.loops[0].joint

    @property
    def torque_unit(self) -> str:
        """In which the parameters come."""
        own = None if "drive_gain" in self.free else self.joint.torque_unit
        return own or TORQUE_UNIT[self.joint.kind]

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
            start = None if p.start is None else p.start + more
            moved = more if acting or "drive_gain" not in self.free else 0.0
            found[name] = replace(p, start=start, lower=p.lower + moved, upper=p.upper + moved)
        return found
