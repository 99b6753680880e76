"""Controllers: named laws of signals, filters and limits, lowered to one sampled law.

To add a law, write its class in `laws` and its name in `LAWS`: the joint file's keys, checks and documentation derive
from its settings.
"""

from __future__ import annotations

from jointid.models.controllers.filters import (
    FILTERS,
    DigitalFilter,
    Filter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    as_filter,
)
from jointid.models.controllers.laws import (
    LAWS,
    PD,
    PID,
    Cascade,
    StateSpaceController,
    shift_start,
    with_present_sample,
)
from jointid.models.controllers.sampled import (
    CONSTANT,
    DIRECTION,
    INJECTED,
    INPUTS,
    LIMIT,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    LawRun,
    SampledLaw,
    invert,
    law_inputs,
    refer,
    respond,
    run,
    scale,
)
from jointid.models.controllers.servo_base import (
    CONTROLLER_UNITS,
    LONGEST_DELAY,
    Controller,
    DiagramController,
    Interpolation,
    ServoController,
    declared_unit,
    number,
    numbers_of,
    unit_of_number,
    with_numbers,
)

__all__ = [
    "CONSTANT", "CONTROLLER_UNITS", "DIRECTION", "FILTERS", "INJECTED", "INPUTS", "LAWS", "LIMIT", "LONGEST_DELAY",
    "PD", "PID",
    "POSITION", "REFERENCE", "REFERENCE_VELOCITY",
    "Cascade", "Controller", "DiagramController", "DigitalFilter", "Filter", "FirstOrder", "Interpolation",
    "LawRun", "MovingAverage", "Notch", "SampledLaw", "SecondOrder", "ServoController", "StateSpaceController",
    "as_filter", "declared_unit", "invert", "law_inputs", "number", "numbers_of", "refer", "respond",
    "run", "scale", "shift_start", "unit_of_number", "with_numbers", "with_present_sample",
]  # fmt: skip
