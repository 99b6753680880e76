"""Controllers: laws by name, drawn of signals, filters and limits, each lowered to one sampled law and run.

The simulation runs a law in its loop; here it is run, and turned round, on signals that are given.
"""

from __future__ import annotations

from jointid.models.controllers.block_diagram import LONGEST_DELAY
from jointid.models.controllers.controller_parameters import number, numbers_of, with_numbers
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
from jointid.models.controllers.laws import PD, PID, Cascade, shift_start
from jointid.models.controllers.registry import LAWS
from jointid.models.controllers.running import LawRun, invert, respond, run
from jointid.models.controllers.sampled import (
    CONSTANT,
    DIRECTION,
    INJECTED,
    INPUTS,
    LIMIT,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    SampledLaw,
    referred,
    scaled,
)
from jointid.models.controllers.servo_base import Controller, DiagramController, Interpolation, ServoController
from jointid.models.controllers.state_space import StateSpaceController

__all__ = [
    "CONSTANT", "DIRECTION", "FILTERS", "INJECTED", "INPUTS", "LAWS", "LIMIT", "LONGEST_DELAY", "PD", "PID",
    "POSITION", "REFERENCE", "REFERENCE_VELOCITY",
    "Cascade", "Controller", "DiagramController", "DigitalFilter", "Filter", "FirstOrder", "Interpolation",
    "LawRun", "MovingAverage", "Notch", "SampledLaw", "SecondOrder", "ServoController", "StateSpaceController",
    "as_filter", "invert", "number", "numbers_of", "referred", "respond", "run", "scaled", "shift_start",
    "with_numbers",
]  # fmt: skip
