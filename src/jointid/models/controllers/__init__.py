"""Controllers: laws of signals, filters and limits, lowered to a sampled law.

To add a law, write its class in `laws` and its name in `LAWS`: the joint file's keys, checks and documentation derive
from its settings.
"""

from __future__ import annotations

from jointid.models.controllers.filters import (
    FILTERS,
    Filter,
    FirstOrder,
    Notch,
    SecondOrder,
)
from jointid.models.controllers.laws import (
    LAWS,
    PD,
    PID,
    Cascade,
    shift_start,
    with_present_sample,
)
from jointid.models.controllers.sampled import (
    DIRECTION,
    INJECTED,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    SampledLaw,
    invert,
    law_inputs,
    respond,
    run,
)
from jointid.models.controllers.servo_base import (
    CONTROLLER_UNITS,
    LONGEST_DELAY,
    Controller,
    Interpolation,
    ServoController,
    declared_unit,
    number,
    numbers_of,
    unit_of_number,
    with_numbers,
)

__all__ = [
    "CONTROLLER_UNITS", "DIRECTION", "FILTERS", "INJECTED", "LAWS", "LONGEST_DELAY", "PD", "PID", "POSITION",
    "REFERENCE", "REFERENCE_VELOCITY", "Cascade", "Controller", "Filter", "FirstOrder", "Interpolation", "Notch",
    "SampledLaw", "SecondOrder", "ServoController", "declared_unit", "invert", "law_inputs", "number", "numbers_of",
    "respond", "run", "shift_start", "unit_of_number", "with_numbers", "with_present_sample",
]  # fmt: skip
