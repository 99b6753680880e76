"""The period of a ripple that is not known: searched for in the record, then estimated with the other parameters.

The residual of least squares has one narrow valley at each period the torque repeats with, as wide as the axis has
travelled periods. So spatial frequencies are tried in steps of a quarter of that width, from two periods on the way to
those that pass at the median speed with the filter's cut-off; the best is refined by Brent's method. From then on the
derivative of the force by the period is a column like the others, so that the period has a deviation, and the other
parameters' deviations know that it is not sure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.transmission import Side
from jointid.estimation.methods.inverse_model import InverseModel, through_window
from jointid.estimation.methods.linear import Rows
from jointid.models.disturbances import Effect, PositionHarmonics, effect_columns
from jointid.models.joints import Motion
from jointid.models.parameters import Parameter, Quantity
from jointid.records.signals.filtering import Filtering

_PERIODS = 2.0  # on the way, at least
_STEPS = 4.0  # to the width of a valley
_MOVING = 0.1  # of the top speed: slower is not moving
_FOUND = 1e-9  # relative, of the period


@dataclass(frozen=True, slots=True, eq=False)
class PeriodColumn:
    """The derivative of a ripple by its period, as one more effect; its parameter is the change of the period."""

    ripple: PositionHarmonics
    amplitudes: FloatArray

    @classmethod
    def of(cls, effect: Effect, values: Mapping[str, float]) -> PeriodColumn:
        """Return the column of a ripple with the amplitudes among `values`."""
        assert isinstance(effect, PositionHarmonics)
        return cls(effect, np.array([values[p.name] for p in effect.parameters]))

    @property
    def name(self) -> str:
        """Of its parameter."""
        return self.parameters[0].name

    @property
    def period(self) -> float:
        """The ripple's."""
        assert self.ripple.period is not None
        return self.ripple.period

    @property
    def side(self) -> Side:
        """The ripple's."""
        return self.ripple.side

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The period."""
        prefix, index = ("", "") if self.side == "motor" else ("load_", "2")
        return (Parameter(f"{prefix}period", f"period{index}", Quantity.POSITION),)

    def columns(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return the derivative, (samples, 1)."""
        return self.ripple.period_column(motion, self.amplitudes)[:, np.newaxis]


def with_periods(
    effects: Sequence[Effect], model: InverseModel, rows: Rows, filtering: Filtering, sample_time: float
) -> tuple[Effect, ...]:
    """Return effects with every period known, those that were not searched for one after the other.

    Args:
        effects: as the user gave them.
        model: of the joint and of the effects that are whole.
        rows: its regression, of the free parameters.
        filtering: as the rows were made with.
        sample_time: of the record, seconds.

    Raises:
        MethodError: the axis does not travel far enough to show any period.
    """

    def found(effect: Effect) -> Effect:
        if isinstance(effect, PositionHarmonics) and effect.period is None:
            return _searched(effect, model, rows, filtering, sample_time)
        return effect

    return tuple(found(effect) for effect in effects)


def is_searched(effect: Effect) -> bool:
    """Whether it is a ripple whose period is to be found."""
    return isinstance(effect, PositionHarmonics) and effect.period is None


def moved(
    effects: Sequence[Effect], columns: Sequence[PeriodColumn], change: Mapping[str, float]
) -> tuple[Effect, ...]:
    """Return effects with the periods of `columns` moved by what was found for them."""
    new: dict[Effect, Effect] = {
        column.ripple: replace(column.ripple, period=float(column.period + change[column.name])) for column in columns
    }
    return tuple(new.get(effect, effect) for effect in effects)


def _searched(
    effect: PositionHarmonics, model: InverseModel, rows: Rows, filtering: Filtering, sample_time: float
) -> PositionHarmonics:
    from scipy.optimize import minimize_scalar

    side = model.motor if effect.side == "motor" else model.load
    assert side is not None
    low, high, step = _range(side, effect, filtering)
    basis, _ = np.linalg.qr(rows.W / np.linalg.norm(rows.W, axis=0))
    left = rows.Y - basis @ (basis.T @ rows.Y)

    def remaining(frequency: float) -> float:
        tried = replace(effect, period=1 / frequency)
        columns = effect_columns([tried], model.motor, model.load, sample_time, rows.equations)
        seen = model.thinned(through_window(columns, filtering), filtering, sample_time)
        seen -= basis @ (basis.T @ seen)
        error = left - seen @ np.linalg.lstsq(seen, left, rcond=None)[0]
        return float(error @ error)

    tried = np.arange(low, high + step, step)
    best = tried[int(np.argmin([remaining(frequency) for frequency in tried]))]
    around = (max(best - step, 0.5 * low), best + step)
    fine = minimize_scalar(remaining, bounds=around, method="bounded", options={"xatol": _FOUND * best})
    return replace(effect, period=float(1 / fine.x))


def _range(side: Motion, effect: PositionHarmonics, filtering: Filtering) -> tuple[float, float, float]:
    """Return lowest and highest spatial frequency to try, and the step between, in periods per m or rad."""
    assert filtering.cutoff is not None
    travel, speed = float(np.ptp(side.position)), np.abs(side.velocity)
    moving = speed[speed > _MOVING * speed.max()]
    low = _PERIODS / travel if travel > 0 else np.inf
    high = filtering.cutoff / float(np.median(moving)) / effect.harmonics if moving.size else 0.0
    if not low < high:
        raise MethodError(
            f"No period can be searched for: at this record's speed the filter's cut-off of {filtering.cutoff:g} Hz "
            f"leaves none that fits {_PERIODS:g} times into its travel; give the period, or a record that travels "
            "farther."
        )
    return low, high, 1 / (_STEPS * effect.harmonics * travel)
