"""Every fault that can be tested or corrected, in the order of the tests and of the hypotheses."""

from __future__ import annotations

from jointid.diagnostics.faults import forces, friction, loop_gain, numbers, other_laws, record, springs

FAULTS = (
    *record.FAULTS, *loop_gain.FAULTS, *numbers.FAULTS, *other_laws.FAULTS, *forces.FAULTS, *friction.FAULTS,
    forces.COGGING, *springs.FAULTS, forces.LIMIT,
)  # fmt: skip
"""To add a fault, write a `Fault` and name it in the `FAULTS` of its file."""
