"""Controllers of a joint, the filters on their torque, and that torque: `ji.controller.Cascade(...)`."""

from jointid.models.controllers.filters import DigitalFilter, FirstOrder, MovingAverage, Notch, SecondOrder
from jointid.models.controllers.laws import PD, PID, Cascade, StateSpaceController
from jointid.simulation.controller_torque import compute_controller_torque

__all__ = [
    "PD", "PID", "Cascade", "DigitalFilter", "FirstOrder", "MovingAverage", "Notch", "SecondOrder",
    "StateSpaceController", "compute_controller_torque",
]  # fmt: skip
