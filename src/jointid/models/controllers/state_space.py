"""A controller that has no name: any discrete linear law with a limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.errors import MethodError
from jointid.models.controllers.sampled import (
    INJECTED,
    INPUTS,
    LIMIT,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    SampledLaw,
    referred,
)
from jointid.models.controllers.servo_base import ServoController


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpaceController(ServoController):
    """Any discrete linear law with a limit, in controller units.

    It is::

        u = C z + D inputs,  z+ = A z + B (inputs, excess),  out = clip(u, -limit, limit),  excess = out - u

    Attributes:
        A: (nz, nz). C: (nz,).
        B: name of an input to its column (nz,); inputs are "reference", "reference_velocity", "position", "excess".
        D: name of an input to its direct gain; "position" feeds back negatively, so its gain is usually < 0.
        gain, limit, period, delay, interpolation, ratio: see `ServoController`.
    """

    A: ArrayLike
    B: dict[str, ArrayLike]
    C: ArrayLike
    D: dict[str, float]

    def __post_init__(self) -> None:
        ServoController.__post_init__(self)
        order = np.size(self.C)
        shapes = {"A": np.shape(self.A), **{f"B.{name}": np.shape(column) for name, column in self.B.items()}}
        wrong = [
            f"{name} {shape}"
            for name, shape in shapes.items()
            if shape != ((order, order) if name == "A" else (order,)) and not (order == 0 and np.prod(shape) == 0)
        ]
        unknown = (set(self.B) - {*_COLUMNS, "excess"}) | (set(self.D) - set(_COLUMNS))
        if wrong or unknown:
            raise MethodError(
                f"A state-space law with {order} states (the length of C) needs A ({order}, {order}) and each column "
                f"of B ({order},), for the inputs {', '.join(_COLUMNS)}, excess; received "
                f"{', '.join([*wrong, *unknown])}."
            )
        if self.reference_delay:
            raise MethodError("A state-space law has the delay of its reference in its matrices; leave it out.")

    @property
    def channels(self) -> tuple[str, ...]:
        """The reference, and its velocity when the law uses it."""
        uses = "reference_velocity" in self.B or "reference_velocity" in self.D
        return ("reference", "reference_velocity") if uses else ("reference",)

    def law(self, sample_time: float) -> SampledLaw:
        """Return the state-space form."""
        order = np.size(self.C)
        B, D = np.zeros((1, order, INPUTS)), np.zeros((1, 1, INPUTS))
        for name, at in _COLUMNS.items():
            B[0, :, at] = np.asarray(self.B.get(name, 0.0), dtype=np.float64)
            D[0, 0, at] = self.D.get(name, 0.0) * self.gain
        D[0, 0, INJECTED] = 1.0
        C = np.reshape(np.array(self.C, dtype=np.float64), (1, 1, order)) * self.gain
        # What the limit cut off is fed back in controller units.
        F = np.reshape(np.array(self.B.get("excess", np.zeros(order)), dtype=np.float64), (1, order, 1)) / self.gain
        law = SampledLaw(
            np.reshape(np.array(self.A, dtype=np.float64), (1, order, order)), B, C, D, np.zeros((1, 1, 1)), F,
            np.array([self.limit * self.gain]), np.array([LIMIT]), np.array([True]), 0, 0,
            self.period or sample_time, self.delay,
        )  # fmt: skip
        return referred(law, self.ratio)


_COLUMNS = {"reference": REFERENCE, "reference_velocity": REFERENCE_VELOCITY, "position": POSITION}
