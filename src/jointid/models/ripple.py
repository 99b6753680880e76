"""Ripple: a force that comes back with the position, of a motor's slots, a screw's pitch or a gear's teeth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.transmission import Side
from jointid.models.motion import Motion


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class PositionHarmonics:
    """``sum over k of a_k cos(2 pi k q / period) + b_k sin(2 pi k q / period)``: ripple of a screw, gear or motor.

    A sum of n harmonics of any period lowers the residual of the record it is fitted to; judge it by a cross test.
    """

    period: float | None = setting(
        None,
        "of the first harmonic, such as the pitch of a screw; without it searched for in the record, and refined",
        unit="m or rad",
        above=0,
    )
    harmonics: int = setting(1, "how many, from the first", at_least=1)
    side: Side = setting("motor", "whose position it follows and on which side it acts")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Amplitude of cosine and sine of each harmonic, in the unit of the torque."""
        prefix, index = ("", "") if self.side == "motor" else ("load_", "2")
        return tuple(
            Parameter(f"{prefix}harmonic_{k}_{word}", f"{letter}{index}_{k}", Quantity.FORCE)
            for k in range(1, self.harmonics + 1)
            for word, letter in (("cosine", "a"), ("sine", "b"))
        )

    def columns(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return cosine and sine of each harmonic, (samples, 2 harmonics)."""
        return self.columns_at(motion.position)

    def columns_at(self, position: FloatArray) -> FloatArray:
        """Return the columns at positions, (samples,)."""
        phases = self._phases(position)
        return np.stack([np.cos(phases), np.sin(phases)], axis=2).reshape(len(phases), -1)

    def require(self, model: str) -> None:
        """Raise a `MethodError` if a joint of that model cannot be simulated with it."""
        if self.period is None:
            raise MethodError(
                "A joint with a ripple is simulated, which needs its period; received none: give it, or find it with "
                "the harmonics of IDIM, which searches for it."
            )
        if model == "rigid" and self.side == "load":
            raise MethodError('A rigid joint has no load side of its own; use side = "motor".')

    def places(self, values: Mapping[str, float]) -> FloatArray:
        """Return it as forces that follow a position, (harmonics, 5), for the simulation in steps."""
        assert self.period is not None
        amplitudes = np.array([values[p.name] for p in self.parameters]).reshape(-1, 2)
        waves = 2 * math.pi / self.period * np.arange(1, self.harmonics + 1)
        side = np.full(self.harmonics, float(self.side == "load"))
        return np.column_stack([amplitudes, np.zeros(self.harmonics), waves, side])

    def period_column(self, motion: Motion, amplitudes: FloatArray) -> FloatArray:
        """Return the derivative of the force by the period, (samples,), at amplitudes in the order of `parameters`."""
        assert self.period is not None
        phases = self._phases(motion.position)
        by_phase = -amplitudes[::2] * np.sin(phases) + amplitudes[1::2] * np.cos(phases)
        return np.asarray((-phases / self.period * by_phase).sum(axis=1))

    def _phases(self, position: FloatArray) -> FloatArray:
        assert self.period is not None, "a period that is searched for has no columns yet"
        return np.outer(position, 2 * math.pi / self.period * np.arange(1, self.harmonics + 1))
