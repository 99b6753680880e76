"""Controllers: laws by name, drawn of signals, filters and limits, each lowered to one sampled law and run.

The simulation runs a law in its loop; here it is run, and turned round, on signals that are given.
"""

from __future__ import annotations

from jointid.model.controllers.diagram import LONGEST_DELAY
from jointid.model.controllers.drawn import Controller, Drawn, Interpolation, Timed
from jointid.model.controllers.filters import (
    DigitalFilter,
    Filter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    as_filter,
)
from jointid.model.controllers.laws import PD, PID, Cascade, begun_later
from jointid.model.controllers.numbers import number, numbers_of, with_numbers
from jointid.model.controllers.running import Ran, invert, respond, run
from jointid.model.controllers.sampled import (
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
from jointid.model.controllers.state_space import StateSpaceController

__all__ = [
    "CONSTANT", "DIRECTION", "INJECTED", "INPUTS", "LIMIT", "LONGEST_DELAY", "PD", "PID", "POSITION", "REFERENCE",
    "REFERENCE_VELOCITY",
    "Cascade", "Controller", "DigitalFilter", "Drawn", "Filter", "FirstOrder", "Interpolation", "MovingAverage",
    "Notch", "Ran", "SampledLaw", "SecondOrder", "StateSpaceController", "Timed", "as_filter", "begun_later", "invert",
    "number", "numbers_of", "referred", "respond", "run", "scaled", "with_numbers",
]  # fmt: skip
