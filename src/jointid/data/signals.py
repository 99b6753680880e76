"""Signals: zero-phase filters, derivatives, decimation, and torque brought to the instants of the positions.

Everything that is compared or regressed goes through the same `Filtering`, torque and every column alike, so that
what the filter takes from one side it takes from the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.errors import MethodError, RecordError
from jointid.data.record import Channel, FloatArray, Timing

if TYPE_CHECKING:
    from typing import Self

_POSITION = 0.1  # default position cut-off, as a fraction of the sampling frequency
_DECIMATION = 0.04  # default cut-off of the decimation filter, likewise: one sample in ten is kept
_ROOM = 0.8  # of the new Nyquist frequency is left to the pass band
_RIPPLE = 0.05  # dB of the decimation filter
_ORDER = 8  # of the decimation filter


@dataclass(frozen=True, slots=True)
class Filtering:
    """How measured and simulated signals are filtered before they are compared.

    Attributes:
        position_cutoff: Hz, of the Butterworth low-pass on measured positions (IDIM only), at least 5 times the
            highest mode to be seen; a tenth of the sampling frequency when None.
        cutoff: Hz, edge of the decimation filter on torque and columns; 4 % of the sampling frequency when None.
            A rigid model of a flexible joint needs an edge below a fifth of the first mode.
        decimation: keep one sample in so many; the most that leaves `cutoff` within 80 % of the new Nyquist
            frequency when None. A larger one aliases, and is refused unless it is a documented preset.
        borders: samples dropped at the start and at the end of the filtered, differentiated positions.
        timing: "respected" brings a held or averaged torque to the positions' instants; "as_sampled" reads it as
            sampled, half a period early, as the EMPS benchmark's authors did.
    """

    position_cutoff: float | None = None
    cutoff: float | None = None
    decimation: int | None = None
    borders: tuple[int, int] = (50, 50)
    timing: str = "respected"

    def __post_init__(self) -> None:
        cutoffs = (self.position_cutoff, self.cutoff)
        if any(value is not None and not (math.isfinite(value) and value > 0) for value in cutoffs):
            raise MethodError(f"Cut-off frequencies are positive numbers of Hz; received {cutoffs}.")
        if self.decimation is not None and self.decimation < 1:
            raise MethodError(f"Decimation keeps one sample in 1 or more; received {self.decimation}.")
        if min(self.borders) < 0:
            raise MethodError(f"The borders are numbers of samples, 0 or more; received {self.borders}.")
        if self.timing not in ("respected", "as_sampled"):
            raise MethodError(f'Timing is "respected" or "as_sampled"; received "{self.timing}".')

    @classmethod
    def published(cls) -> Self:
        """Return the filtering of the EMPS benchmark report, to every digit of its results.

        Butterworth at 100 Hz; the first 49 samples dropped; Chebyshev at 40 Hz, one sample in ten; torque read as
        sampled.
        """
        return cls(position_cutoff=100.0, cutoff=40.0, decimation=10, borders=(49, 0), timing="as_sampled")

    def resolved(self, sample_time: float) -> Filtering:
        """Return this filtering with every default filled in for signals of that sample time.

        Raises:
            MethodError: a cut-off is at or above the Nyquist frequency, or the decimation would alias.
        """
        nyquist = 0.5 / sample_time
        position = self.position_cutoff or _POSITION / sample_time
        cutoff = self.cutoff or _DECIMATION / sample_time
        for name, value in (("position_cutoff", position), ("cutoff", cutoff)):
            if value >= nyquist:
                raise MethodError(
                    f"{name} = {value:g} Hz is not below the Nyquist frequency of {nyquist:g} Hz; lower it."
                )
        most = max(math.floor(_ROOM * nyquist / cutoff + 1e-9), 1)
        if self.decimation is not None and self.decimation > most:
            raise MethodError(
                f"Keeping one sample in {self.decimation} puts the new Nyquist frequency at "
                f"{nyquist / self.decimation:.4g} Hz, too close to the cut-off of {cutoff:g} Hz: keep at least one "
                f"in {most}, or lower the cut-off."
            )
        return Filtering(position, cutoff, self.decimation or most, self.borders, self.timing)


def lowpass(values: FloatArray, cutoff: float, sample_time: float, order: int = 4) -> FloatArray:
    """Return `values` through a Butterworth filter forwards and backwards: no phase, twice the attenuation.

    Args:
        values: (samples,) or (samples, columns).
        cutoff: Hz.
        sample_time: seconds.
        order: of the filter; for IDIM the highest derivative plus 2.

    Ends are padded by 3 x order samples, reflected about the end point. Raises `RecordError` on a shorter signal.
    """
    from scipy.signal import butter

    return _both_ways(butter(order, 2 * cutoff * sample_time, output="sos"), values, order)


def _both_ways(sections: FloatArray, values: FloatArray, order: int) -> FloatArray:
    from scipy.signal import sosfiltfilt

    padding = 3 * order
    if len(values) <= padding:
        raise RecordError(
            f"A record of {len(values)} samples is too short to filter: more than {padding} are needed; "
            "use a longer record."
        )
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=padding))


def derivative(values: FloatArray, sample_time: float) -> FloatArray:
    """Return central differences, one-sided at the two ends; along the first axis."""
    return np.asarray(np.gradient(values, sample_time, axis=0))


def decimate(values: FloatArray, filtering: Filtering, sample_time: float) -> FloatArray:
    """Return `values` low-passed both ways and thinned; `filtering` must be `resolved`.

    Chebyshev type I of order 8 and 0.05 dB. Forwards and backwards it passes a constant at 0.9886, so it must be
    applied to both sides of an equation. The last sample is always kept, and every so many before it.
    """
    from scipy.signal import cheby1

    assert filtering.cutoff is not None
    assert filtering.decimation is not None
    sections = cheby1(_ORDER, _RIPPLE, 2 * filtering.cutoff * sample_time, output="sos")
    smooth = _both_ways(sections, values, _ORDER)
    keep, n = filtering.decimation, len(values)
    first = keep - (keep * math.ceil(n / keep) - n) - 1
    return smooth[first::keep]


def centred(channel: Channel, delay: float = 0.0) -> FloatArray:
    """Return the mean of a torque over one sample time on each side of every instant, shape (samples,).

    This is what a held or averaged torque must be compared with at the positions' instants: a torque held from t to
    t + T acts, on average, half a period after t. A sampled torque is returned as it is, unless it is delayed.

    Args:
        channel: the torque; its timing decides.
        delay: seconds between the logged value and the torque that acts.
    """
    values = channel.values
    if channel.timing is Timing.SAMPLED and delay == 0.0:
        return values.copy()
    time = np.arange(values.size + 1) * channel.sample_time
    integral = np.concatenate([np.zeros(1), np.cumsum(values) * channel.sample_time])
    if channel.timing is Timing.AVERAGED:  # the mean over the period before the instant
        time = time - channel.sample_time
    elif channel.timing is Timing.SAMPLED:
        time = time - 0.5 * channel.sample_time
    low = np.clip(channel.time - channel.sample_time - delay, time[0], time[-1])
    high = np.clip(channel.time + channel.sample_time - delay, time[0], time[-1])
    span = high - low
    mean = (np.interp(high, time, integral) - np.interp(low, time, integral)) / np.where(span > 0, span, 1.0)
    return np.asarray(np.where(span > 0, mean, values[0]))
