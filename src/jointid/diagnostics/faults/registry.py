"""Every fault that can be tested or corrected, in the order of the tests and of the hypotheses."""

from __future__ import annotations

from collections.abc import Iterator

from jointid.diagnostics.faults import forces, friction, loop_gain, numbers, other_laws, record, springs
from jointid.diagnostics.faults.fault import FaultSignature
from jointid.diagnostics.seen import Seen

FAULTS = (
    *record.FAULTS, *loop_gain.FAULTS, *numbers.FAULTS, *other_laws.FAULTS, *forces.FAULTS, *friction.FAULTS,
    forces.COGGING, *springs.FAULTS, forces.LIMIT,
)  # fmt: skip
"""To add a fault, write a `Fault` and name it in the `FAULTS` of its file."""


def list_signatures(seen: Seen) -> Iterator[FaultSignature]:
    """Yield what each fault adds to the torque of an axis, as it is before the filter."""
    for fault in (*FAULTS, *map(forces.couple, seen.others)):
        for shape, raw in () if fault.columns is None else fault.columns(seen):
            if raw is not None:
                yield FaultSignature(fault, raw, shape, raw)
