"""Controllers of a joint, and the filters on their torque: `ji.controller.Cascade(...)`."""

from jointid.models.controllers import (
    PD,
    PID,
    Cascade,
    DigitalFilter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    StateSpaceController,
)

__all__ = [
    "PD", "PID", "Cascade", "DigitalFilter", "FirstOrder", "MovingAverage", "Notch", "SecondOrder",
    "StateSpaceController",
]  # fmt: skip
