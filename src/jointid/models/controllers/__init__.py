"""Controllers: laws by name, drawn of signals, filters and limits, each lowered to one sampled law and run.

The simulation runs a law in its loop; here it is run, and turned round, on signals that are given.

A law is added by its own file and its line in `LAWS`: its keys in the joint file, their checks and their documentation
are made from the settings that it declares.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jointid.models.controllers.block_diagram import LONGEST_DELAY
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
from jointid.models.controllers.laws import PD, PID, Cascade, StateSpaceController, shift_start
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
    referred,
    respond,
    run,
    scaled,
)
from jointid.models.controllers.servo_base import (
    Controller,
    DiagramController,
    Interpolation,
    ServoController,
    number,
    numbers_of,
    with_numbers,
)

__all__ = [
    "CONSTANT", "DIRECTION", "FILTERS", "INJECTED", "INPUTS", "LAWS", "LIMIT", "LONGEST_DELAY", "PD", "PID",
    "POSITION", "REFERENCE", "REFERENCE_VELOCITY",
    "Cascade", "Controller", "DiagramController", "DigitalFilter", "Filter", "FirstOrder", "Interpolation",
    "LawRun", "MovingAverage", "Notch", "SampledLaw", "SecondOrder", "ServoController", "StateSpaceController",
    "as_filter", "invert", "law_inputs", "number", "numbers_of", "referred", "respond", "run", "scaled", "shift_start",
    "with_numbers",
]  # fmt: skip

LAWS: Mapping[str, type[Any]] = {"cascade": Cascade, "pd": PD, "pid": PID, "state_space": StateSpaceController}
"""The class of each law, by the word for it in a joint file."""
