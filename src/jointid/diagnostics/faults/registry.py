"""Every fault that can be tested or corrected, in the order of the tests and of the hypotheses."""

from __future__ import annotations

from jointid.diagnostics.faults import cogging, forces, friction, loop_gain, numbers, other_laws, record, springs

FAULTS = (
    *record.FAULTS, *loop_gain.FAULTS, *numbers.FAULTS, *other_laws.FAULTS, *forces.FAULTS, *friction.FAULTS,
    *cogging.FAULTS, *springs.FAULTS,
)  # fmt: skip
"""To add a fault, write a `Fault` and name it in the `FAULTS` of its file."""
