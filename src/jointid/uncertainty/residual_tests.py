"""What a model leaves of the torque: how much, at which frequencies, and whether it is only noise.

**Whiteness.** The low-pass before the decimation correlates even white noise from row to row, so that the usual test
calls every residual coloured. Its pass band alone is looked at: the residual's spectrum between 0 and 95 % of the
cut-off is read as that of a signal sampled at twice that frequency, which is white where the noise is. Of that signal
the autocorrelations c_h at lags 1 to 20 are tested together::

    Q = sum_h (sum_t e_t e_t-h)^2 / (sum_t e_t^2 e_t-h^2)        chi-square with 20 degrees of freedom

which is Ljung and Box's with variances that do not take the rows for equally accurate (Diebold 1986; Lobato, Nankervis
and Savin 2001): the residual of a joint is louder at reversals.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import aligned, number
from jointid.uncertainty.position_dependent_error import Repeatable

_INSIDE = 0.95  # of the cut-off: the filter is flat up to there
_LAGS = 20
_ROWS_PER_LAG = 4  # at least
_OCTAVES = 6  # below the cut-off; what lies further down is one band
_LEVEL = 0.05
_ROUNDING = 1e-12  # of the torque's: a band with less in it holds nothing to compare with


@dataclass(frozen=True, slots=True)
class Band:
    """The residual between two frequencies.

    Attributes:
        low, high: Hz.
        error: norm of the residual over that of the torque, both in the band; None where the torque has nothing there.
        share: of the residual's energy.
    """

    low: float
    high: float
    error: float | None
    share: float


@dataclass(frozen=True, slots=True)
class Whiteness:
    """A test of the residual's autocorrelation within the filter's pass band.

    Attributes:
        statistic: Q of the module.
        lags: that were tested together.
        p_value: how often white noise gives as much.
    """

    statistic: float
    lags: int
    p_value: float

    @property
    def white(self) -> bool:
        """Whether nothing speaks against white noise, at 5 %."""
        return self.p_value > _LEVEL

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        verdict = "is white as far as this record tells" if self.white else "is not white"
        how = f"Q = {self.statistic:.1f} of {self.lags} lags, p = {self.p_value:.2g}"
        return f"within the pass band the residual {verdict} ({how})"


@dataclass(frozen=True, slots=True)
class ResidualReport:
    """What a model leaves of the torque.

    Attributes:
        relative: norm of the residual over that of the torque, both filtered; a ratio.
        centred: the same with the mean taken from both: a constant the torque stands on does not flatter it.
        rms: of the residual, in its unit.
        mean: of the residual, in its unit.
        unit: of the torque.
        bands: from low to high frequencies.
        against_rigid: norm of the residual over that of a rigid model's; None where none was given.
        whiteness: within the pass band; None where the record is too short.
        repeatable: what of it repeats with the motion; None where the motion was not given.
    """

    relative: float
    centred: float
    rms: float
    mean: float
    unit: str
    bands: tuple[Band, ...]
    against_rigid: float | None
    whiteness: Whiteness | None
    repeatable: Repeatable | None

    def __str__(self) -> str:
        """Return the report."""
        lines = [
            f"residual {number(self.rms, 3)} {self.unit} rms: {100 * self.relative:.2f} % of the torque, "
            f"{100 * self.centred:.2f} % with the means taken off (mean {number(self.mean, 2)} {self.unit})"
        ]
        if self.against_rigid is not None:
            lines.append(f"{100 * self.against_rigid:.1f} % of what a rigid model leaves")
        table = aligned(("band, Hz", "error %", "of the residual %"), [_row(band) for band in self.bands], (True,) * 3)
        lines += ["", table, ""]
        lines += [str(said) for said in (self.whiteness, self.repeatable) if said is not None]
        return "\n".join(lines)


def residual_report(
    error: FloatArray,
    measured: FloatArray,
    sample_time: float,
    cutoff: float,
    unit: str = "N",
    *,
    edges: Sequence[float] | None = None,
    rigid_error: FloatArray | None = None,
    repeatable: Repeatable | None = None,
) -> ResidualReport:
    """Return what a model leaves of a record's torque.

    Args:
        error: (rows,) measured less predicted torque, filtered and decimated.
        measured: (rows,) the torque itself, likewise.
        sample_time: seconds between rows.
        cutoff: Hz, of the filter both went through.
        unit: of the torque.
        edges: Hz, in increasing order, between the bands; octaves below the cut-off when None, and what the filter
            lets through above it. The loop's bandwidth and the joint's modes are good ones.
        rigid_error: (rows,) what a rigid model leaves, filtered alike.
        repeatable: what of the residual repeats, from `jointid.uncertainty.position_dependent_error`.

    Raises:
        MethodError: the edges do not increase, or the arrays do not belong together.
    """
    sizes = {error.size, measured.size, error.size if rigid_error is None else rigid_error.size}
    if len(sizes) > 1:
        raise MethodError(
            f"Residual and torque have the same rows; received {', '.join(map(str, sorted(sizes)))}: filter and "
            "decimate them alike."
        )
    chosen = _octaves(cutoff, 0.5 / sample_time) if edges is None else [float(edge) for edge in edges]
    if len(chosen) < 2 or chosen[0] < 0 or np.any(np.diff(chosen) <= 0):
        raise MethodError(f"The edges of bands are increasing frequencies, two or more; received {chosen}.")
    centred = error - error.mean()
    return ResidualReport(
        relative=_ratio(error, measured),
        centred=_ratio(centred, measured - measured.mean()),
        rms=float(np.sqrt(np.mean(error**2))),
        mean=float(error.mean()),
        unit=unit,
        bands=_bands(error, measured, sample_time, chosen),
        against_rigid=None if rigid_error is None else _ratio(error, rigid_error),
        whiteness=whiteness(error, sample_time, cutoff),
        repeatable=repeatable,
    )


def whiteness(error: FloatArray, sample_time: float, cutoff: float, lags: int = _LAGS) -> Whiteness | None:
    """Return the test of a residual's autocorrelation (see the module); None where there are too few rows.

    Args:
        error: (rows,) filtered and decimated residual.
        sample_time: seconds between rows.
        cutoff: Hz, of the filter.
        lags: to be tested together, at twice the cut-off.
    """
    from scipy.stats import chi2

    e = _within(error, sample_time, cutoff)
    if e.size < _ROWS_PER_LAG * lags or not np.any(e):
        return None
    products = [e[lag:] * e[:-lag] for lag in range(1, lags + 1)]
    statistic = float(sum(np.sum(p) ** 2 / np.sum(p**2) for p in products))
    return Whiteness(statistic, lags, float(chi2.sf(statistic, lags)))


def _within(error: FloatArray, sample_time: float, cutoff: float) -> FloatArray:
    """Return the part of a residual within the pass band, sampled at twice its width."""
    spectrum = np.fft.rfft(error - error.mean())
    highest = min(_INSIDE * cutoff, 0.5 / sample_time)
    # The last frequency is left out, which at half the sampling frequency has no phase.
    kept = min(math.floor(highest * error.size * sample_time), spectrum.size - 2)
    if kept < 1:
        return np.zeros(0)
    return np.asarray(np.fft.irfft(spectrum[: kept + 1], 2 * kept + 1))


def _octaves(cutoff: float, nyquist: float) -> list[float]:
    highest = min(cutoff, nyquist)
    octaves = [highest / 2**i for i in range(_OCTAVES, -1, -1)]
    return [0.0, *octaves, *([nyquist] if nyquist > cutoff else [])]


def _bands(error: FloatArray, measured: FloatArray, sample_time: float, edges: Sequence[float]) -> tuple[Band, ...]:
    window = np.hanning(error.size)  # or the ends, which do not meet, would spread the lowest band over all
    residual, torque = (np.abs(np.fft.rfft(window * signal)) ** 2 for signal in (error, measured))
    frequency = np.fft.rfftfreq(error.size, sample_time)
    total, whole = float(residual.sum()) or 1.0, float(torque.sum())
    found = []
    for low, high in itertools.pairwise(edges):
        inside = (frequency >= low) & ((frequency < high) | (high == edges[-1]) & (frequency <= high * (1 + 1e-12)))
        left, there = float(residual[inside].sum()), float(torque[inside].sum())
        error_there = math.sqrt(left / there) if there > _ROUNDING**2 * whole else None
        found.append(Band(low, high, error_there, left / total))
    return tuple(found)


def _ratio(error: FloatArray, signal: FloatArray) -> float:
    size = float(np.linalg.norm(signal))
    return float(np.linalg.norm(error)) / size if size > 0 else math.inf


def _row(band: Band) -> tuple[str, str, str]:
    error = "-" if band.error is None else f"{100 * band.error:.2f}"
    return f"{number(band.low, 3)} - {number(band.high, 3)}", error, f"{100 * band.share:.1f}"
