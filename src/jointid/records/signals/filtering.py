"""Zero-phase filters, derivatives, decimation and torque windows.

Torque and regressor columns pass the same `Filtering`, so that both sides of the equation are distorted equally.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from jointid.common.arrays import FloatArray, Room
from jointid.common.errors import MethodError, RecordError
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.text import number
from jointid.records.record import Channel, Timing

if TYPE_CHECKING:
    from typing import Self

# Default cut-offs of positions and of the decimation, as fractions of the sampling frequency: at 1 kHz 100 and 40 Hz
# for a rigid joint, and for a flexible one 150 and 60 Hz, five times and twice the mode of the paper's axis.
_CUTOFFS = {"rigid": (0.1, 0.04), "flexible": (0.15, 0.06)}
_SLOWEST = 1e-5  # of the Nyquist frequency: a lower cut-off is an input error
_ROOM = 0.8  # share of the new Nyquist frequency for the pass band
_RIPPLE = 0.05  # dB of the decimation filter
_ORDER = 8  # of the decimation filter
_BUFFER = Room()
_AT_REST = 1e-8  # of the top speed: less is rounding, whose sign is meaningless
_BEGINS = {Timing.HELD: 0.0, Timing.SAMPLED: -0.5, Timing.AVERAGED: -1.0}  # samples from the stamp to a torque's action
_POSITION_ORDER = 4  # of the position filter: for IDIM the highest derivative plus 2
_PULL = 1e-4  # largest share of noise in the acceleration's power, and thereby bias of an inertia
_SEEN = 10.0  # smallest ratio of acceleration to noise in an octave with motion
_MARGIN = 2.0  # ratio of the lowest noise limit to the highest frequency of the motion
_NOISE = 0.1  # of the sampling frequency: above it noise is measured, since no default cut-off passes motion
_PARTS = 4  # parts of the record whose spectra are averaged
_FEWEST = 256  # fewest samples for an averaged spectrum


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Filtering:
    """Filters for measured and simulated signals."""

    position_cutoff: float | None = setting(
        None,
        "cut-off of the Butterworth low-pass on measured positions, which only IDIM needs; at least five times the "
        "highest mode to be seen; without it 10 % of the sampling frequency, for a flexible joint 15 %; of a "
        "rigid joint less where noise of the positions lowers the default of cutoff",
        unit="Hz",
        above=0,
    )
    cutoff: float | None = setting(
        None,
        "cut-off of the decimation filter on torque and columns; for a rigid model below a fifth of the first mode, "
        "for a flexible one above the mode; without it 4 % of the sampling frequency, for a flexible joint 6 %; "
        "of a rigid joint whose measured positions are differentiated at most what their noise allows",
        unit="Hz",
        above=0,
    )
    decimation: int | None = setting(
        None,
        "one sample is kept in so many; without it as many as leave the cut-off within 80 % of the new Nyquist "
        "frequency",
        at_least=1,
    )
    borders: tuple[int, int] = setting((50, 50), "samples dropped at start and end; of a short record half at most")
    timing: Literal["respected", "as_sampled"] = setting(
        "respected",
        "whether a held or averaged torque is brought to the instants of the positions, or read half a period early, "
        "as published results were",
    )

    def __post_init__(self) -> None:
        check_settings(self)

    @classmethod
    def published(cls) -> Self:
        """Filtering of the EMPS benchmark report, which reproduces all its digits.

        Butterworth at 100 Hz; the first 49 samples dropped; Chebyshev at 40 Hz, one sample in ten; torque read as
        sampled.
        """
        return cls(position_cutoff=100.0, cutoff=40.0, decimation=10, borders=(49, 0), timing="as_sampled")

    def resolve(self, sample_time: float, model: str = "rigid", limit: float = math.inf) -> Filtering:
        """Fill in the defaults for a sample time and a joint's model.

        Args:
            sample_time: s.
            model: "rigid" or "flexible".
            limit: upper bound on the defaults of `cutoff` and `position_cutoff` [Hz]; see
                `find_noise_limit`. It is ignored for a flexible joint, whose cut-off is above its mode.

        Raises:
            MethodError: a cut-off is at or above the Nyquist frequency, or the decimation would alias.
        """
        nyquist = 0.5 / sample_time
        widest, by_rate = (share / sample_time for share in _CUTOFFS[model])
        allowed = by_rate if model == "flexible" else min(by_rate, limit)
        cutoff = self.cutoff or allowed
        position = self.position_cutoff or widest * min(max(cutoff, allowed) / by_rate, 1.0)
        most = max(math.floor(_ROOM * nyquist / cutoff + 1e-9), 1)
        slow = min(position, cutoff) < _SLOWEST * nyquist
        if slow or max(position, cutoff) >= nyquist or (self.decimation or 1) > most:
            raise MethodError(
                f"Cut-offs are below the Nyquist frequency, {nyquist:g} Hz, and above {_SLOWEST * nyquist:g} Hz; the "
                f"decimation is at most {most} for this cut-off; got position_cutoff = {position:g} Hz, cutoff = "
                f"{cutoff:g} Hz and decimation = {self.decimation}: choose others."
            )
        return replace(self, position_cutoff=position, cutoff=cutoff, decimation=self.decimation or most)

    def inside(self, samples: int) -> slice:
        """Return the samples between the borders.

        Raises:
            RecordError: too few of them remain for the filter.
        """
        share = min(1.0, samples / (2 * max(sum(self.borders), 1)))
        first, last = (int(share * one) for one in self.borders)
        _require_samples(max(samples - first - last, 0), 3 * _ORDER)
        return slice(first, samples - last)

    @np.errstate(over="ignore", invalid="ignore")  # the derivatives of a diverging loop may overflow
    def decimate(self, values: FloatArray, sample_time: float) -> FloatArray:
        """Low-pass forwards and backwards, and decimate; needs a resolved filtering.

        Chebyshev type I of order 8 and 0.05 dB. Its gain at 0 Hz, applied twice, is 0.9886, so it must be applied to
        both sides of an equation. The last sample is always kept. See `resolve`.

        Args:
            values: (samples,) or (samples, columns).
            sample_time: of the values, s.

        Examples:
            >>> import numpy as np, jointid as ji
            >>> filtering = ji.Filtering(cutoff=60.0).resolve(1e-3)
            >>> filtering.decimation, len(filtering.decimate(np.ones(3001), 1e-3))
            (6, 501)
        """
        from jointid.records.signals.sections import LANES, STEPS, filter_reversed

        assert self.cutoff is not None and self.decimation is not None
        samples, padding, columns = len(values), 3 * _ORDER, values.reshape(len(values), -1)
        _require_samples(samples, padding)
        sections, initial = _design_decimation(2 * self.cutoff * sample_time)
        total = samples + 2 * padding
        more = -total % STEPS  # rows behind the signal, whose values are of no use
        rows = _BUFFER.array("rows", (total + more, LANES))
        back = _BUFFER.array("back", (total + 2 * more, LANES))
        at = np.arange((samples - 1) % self.decimation, samples, self.decimation) + padding
        kept = np.empty((at.size, columns.shape[1]), order="F")
        for first in range(0, columns.shape[1], LANES):
            width = min(columns.shape[1] - first, LANES)
            inside, lanes = rows[padding : padding + samples], 1 if width == 1 else LANES
            inside[:, :width], inside[:, width:lanes] = columns[:, first : first + width], 0.0
            rows[:padding] = 2 * inside[0] - inside[padding:0:-1]
            rows[padding + samples : total] = 2 * inside[-1] - inside[-2 : -2 - padding : -1]
            for here, there in ((rows, back), (back[more:], rows)):
                state = np.multiply.outer(initial, here[0]).ravel()
                filter_reversed(sections, state, here.ravel(), there[: total + more].ravel(), lanes)
            kept[:, first : first + width] = rows[at + more, :width]
        return kept.reshape(len(kept), *values.shape[1:])


def lowpass(values: FloatArray, cutoff: float, sample_time: float) -> FloatArray:
    """Filter signals, (samples, ...), by a zero-phase Butterworth filter of order 4.

    The cut-off is in Hz; from half the rate on nothing is filtered. Ends are padded by 3 x order reflected samples.
    """
    if 2 * cutoff * sample_time >= 1:
        return values
    from scipy.signal import butter, sosfiltfilt

    padding, sections = 3 * _POSITION_ORDER, butter(_POSITION_ORDER, 2 * cutoff * sample_time, output="sos")
    _require_samples(len(values), padding)
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=padding))


def _require_samples(samples: int, padding: int) -> None:
    if samples <= padding:
        raise RecordError(
            f"A record of {samples} samples, without its borders, is too short to filter: more than {padding} are "
            "needed; log faster or longer, or give smaller filtering.borders."
        )


def thin_channel(channel: Channel, sample_time: float) -> Channel:
    """Decimate a sampled channel to a slower clock, without a filter.

    Other channels are unchanged. A position has no content near the torque's Nyquist frequency; its noise aliases.
    """
    ratio = sample_time / channel.sample_time
    every = round(ratio)
    if channel.timing is not Timing.SAMPLED or every < 2 or abs(ratio / every - 1) > 1e-9:
        return channel
    return replace(channel, values=channel.values[::every], sample_time=sample_time)


@lru_cache(maxsize=64)
def _design_decimation(cutoff: float) -> tuple[FloatArray, FloatArray]:
    """Return second-order sections of the decimation filter, and their unit-step state."""
    from scipy.signal import cheby1, sosfilt_zi

    sections = cheby1(_ORDER, _RIPPLE, cutoff, output="sos")
    return np.asarray(sections), sosfilt_zi(sections).ravel()


def differentiate_twice(values: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
    """First and second derivatives along the first axis, of fourth order.

    Ends are reflected about the end point, so two samples at each end have lower order.
    """
    p = np.pad(values, [(2, 2)] + [(0, 0)] * (values.ndim - 1), mode="reflect", reflect_type="odd")
    first = (p[:-4] - 8 * p[1:-3] + 8 * p[3:-1] - p[4:]) / (12 * sample_time)
    second = (-p[:-4] + 16 * p[1:-3] - 30 * p[2:-2] + 16 * p[3:-1] - p[4:]) / (12 * sample_time**2)
    return np.asarray(first), np.asarray(second)


def settle(velocity: FloatArray) -> FloatArray:
    """Replace the rounding of a filtered velocity at rest by 0.

    Along the first axis. The sign of the rounding differs between processors, and friction would depend on it.
    """
    speed = np.abs(velocity)
    return np.where(speed <= _AT_REST * np.max(speed, axis=0), 0.0, velocity)


def apply_window(columns: FloatArray) -> FloatArray:
    """Apply the window of `window_torque` to signals, (samples, ...), by Simpson's rule."""
    for _ in range(2):
        ends = np.concatenate([columns[:1], columns, columns[-1:]])
        columns = (ends[:-2] + 4 * ends[1:-1] + ends[2:]) / 6
    return columns


def window_torque(channel: Channel, delay: float = 0.0) -> FloatArray:
    """Average a torque with a triangular window of +-2 samples, (samples,).

    A held torque acts half a period after its stamp, in steps, while positions are smooth. This window, exact for a
    held torque (weights 1, 3, 3, 1 over 8), makes both comparable at each instant; see `apply_window`.

    Args:
        channel: the torque; held, averaged, or sampled.
        delay: seconds between the logged value and the acting torque.

    Raises:
        RecordError: the delay is longer than the record.
    """
    period, values = channel.sample_time, channel.values
    if not abs(delay) <= period * len(values):
        raise RecordError(
            f"The torque acts {delay:g} s after its sample, and the record has {period * len(values):g} s; give "
            "another delay, or the estimate that identify wrote."
        )
    late = _BEGINS[channel.timing] + delay / period
    return window_parts(values[:, np.newaxis], 1, late)[: values.size, 0]


def window_parts(columns: FloatArray, parts: int, late: float, order: int = 0, *, curved: bool = False) -> FloatArray:
    """Apply the window of `window_torque` to piecewise constant signals.

    Args:
        columns: (parts of all samples, columns); none after the last sample.
        parts: number per sample.
        late: lag in samples, not necessarily whole or positive.
        order: of the derivative with respect to `late`, 0 or 1.
        curved: whether to correct the bias of means over each part for a curved signal.

    Returns:
        The signals, or their derivatives, (samples, columns), each contiguous; exact, and smooth in `late`.
    """
    first, last = math.floor(parts * (-2.0 - late)), math.ceil(parts * (2.0 - late))
    edges = np.arange(first, last + 1) / parts + late
    inside = np.clip(edges, -2.0, 2.0)
    before_edges = (
        0.5 + inside / 2.0 - inside * np.abs(inside) / 8.0,  # the share of the window
        (2.0 - np.abs(inside)) / 4.0,
    )
    weights = np.diff(before_edges[order])
    if curved:
        weights, first = np.convolve(weights, (-1 / 12, 7 / 6, -1 / 12)), first - 1
    cells, before, behind = len(columns), max(-first, 0), max(first + weights.size, 0)
    padded = np.empty((columns.shape[1], before + cells + behind))
    padded[:, before : before + cells] = columns.T
    padded[:, :before], padded[:, before + cells :] = columns[:1].T, columns[-1:].T
    seen = np.empty((columns.shape[1], cells // parts + 1))
    for row, out in zip(padded[:, first + before :], seen, strict=True):
        each = (np.correlate(row[k::parts], weights[k::parts], "valid")[: out.size] for k in range(parts))
        out[:] = sum(each)
    return seen.T


def find_noise_limit(positions: Iterable[FloatArray], sample_time: float, derivative: int = 2) -> float:
    """Highest cut-off that the noise of positions allows, Hz; infinite without noise.

    At the limit, noise contributes 1e-4 of the power of a derivative; the lowest limit of all positions counts. The
    limit for the acceleration is at least twice the highest octave in which any acceleration is ten times its
    noise. The share of noise grows with the fifth power of the cut-off, and least squares underestimates the inertia
    by that share: at 5 kHz, with steps of 1e-4 rad, a cut-off of 4 % of the rate lost a third.

    Args:
        positions: (samples,) each, raw, with one clock.
        sample_time: s.
        derivative: of the position with respect to time, 2 or more.
    """
    from scipy.signal import welch

    allowed, needed = math.inf, 0.0
    for position in positions:
        if position.size < _FEWEST:
            continue
        size = (position.size - 2) // _PARTS
        frequency, power = welch(np.diff(position, 2) / sample_time**2, 1 / sample_time, nperseg=size)
        frequency, power = frequency[1:], power[1:]
        shape = (2 * np.sin(np.pi * frequency * sample_time) / sample_time) ** 4
        above = frequency >= _NOISE / sample_time
        noise = float(np.median(power[above] / shape[above])) * shape
        power, noise = power * shape ** (derivative / 2 - 1), noise * shape ** (derivative / 2 - 1)
        sums = np.cumsum(np.column_stack([np.zeros((2, 1)), [power, noise]]), axis=1)
        low, high = (np.searchsorted(frequency, frequency * factor) for factor in (0.5**0.5, 2**0.5))
        octave, octave_noise = sums[:, high] - sums[:, low]
        clear = octave > _SEEN * octave_noise
        top = int(np.argmax(octave / np.maximum(octave_noise, 1e-300)))
        lost = np.flatnonzero(~clear[top:])
        last = top + (int(lost[0]) if lost.size else power.size - top)
        if last == top:  # hardly any motion
            continue
        needed = max(needed, _MARGIN * float(frequency[last - 1]))
        motion = float(sums[0, last] - sums[1, last])
        share = np.flatnonzero(sums[1, 1:] > _PULL * motion)
        allowed = min(allowed, float(frequency[share[0]]) if share.size else math.inf)
    return max(allowed, needed) if derivative == 2 else allowed


def describe_noise_limit(filtering: Filtering, limit: float, sample_time: float, model: str) -> tuple[str, ...]:
    """Return a sentence if the stated cut-off exceeds the noise limit."""
    default, cutoff = _CUTOFFS[model][1] / sample_time, filtering.cutoff or math.inf
    if cutoff <= limit * (1 + 1e-9) or limit >= default:
        return ()
    why = f"noise or steps of the positions above {number(limit, 3)} Hz bias an inertia"
    return (f"filtering.cutoff is {number(cutoff, 3)} Hz, and {why}: lower filtering.cutoff to that",)
