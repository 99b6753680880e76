"""Controllers of a joint, and the filters on their torque: `ji.controller.Cascade(...)`."""

from jointid.models.controllers.filters import DigitalFilter, FirstOrder, MovingAverage, Notch, SecondOrder
from jointid.models.controllers.laws import PD, PID, Cascade, StateSpaceController

__all__ = [
    "PD", "PID", "Cascade", "DigitalFilter", "FirstOrder", "MovingAverage", "Notch", "SecondOrder",
    "StateSpaceController",
]  # fmt: skip
