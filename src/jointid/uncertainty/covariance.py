"""Covariances of an estimate from its residual (docs/how-it-works.md, Intervals).

An estimate that solves ``Z' e(x) = 0``, with the sensitivities J = -de/dx of the prediction, errs by ``A n``::

    A = (Z' J)^-1 Z'          cov = A E(n n') A'

Z = J is least squares, Z = W the instruments of IV. `Influence` holds these equations. Its methods estimate the
covariance of coloured noise n from the residual e, under different assumptions. Sums over time are formed within each
record.

**By time** (Newey and West 1987): the scores ``Z_t e_t`` are summed with the Bartlett kernel over `bandwidth` rows on
each side. Influential rows have residuals smaller than the noise, so every block of a bandwidth's length gets its
leave-out residual, ``(I - J_b (Z' J)^-1 Z_b')^-1 e_b``. A residual that grows with the frequency is made white before
(`Influence.prewhiten`).

**By spectrum**: the noise is stationary with the power s_b in a band b. With the projection E_b on the band, which has
w_b degrees of freedom, and ``e = (I - J A) n``::

    cov = sum_b s_b A E_b A'
    E (e' E_a e) = sum_b M_ab s_b,      M_ab = (w_a - 2 tr A E_a J) [a = b] + tr (J' E_a J) (A E_b A')

Solving the second line for s_b >= 0 corrects for the degrees of freedom of the fit in each band (restricted likelihood,
Patterson and Thompson 1971). Bands are narrow: four frequencies, then a quarter of the frequency, at most sqrt(rows).
The power of a band is chi-square with M_bb degrees of freedom, so a deviation has those of Satterthwaite (1946)::

    nu = 2 (h' s)^2 / var (h' s),      h_b = (A E_b A')_ii

Half of Student's quantile then scales the deviation, so that two deviations have the coverage of 2 sigma.

**Robust** is the larger of both in every direction: with a loop that rings at 10 Hz, 91 % of the 2-sigma intervals of
the twin's viscous frictions hold the truth by time alone, 94-98 % by both.

**By groups** of rows, correlated within and independent of each other. A Gauss-Newton step needs only J'J, J'e and e'e
of each (`Sums`), and the jackknife leaves out one after the other::

    d_g = -(A - A_g)^-1 (b - b_g)        V = (G - 1) / G  sum_g (d_g - mean)(d_g - mean)'

with A = sum_g J_g'J_g and b = sum_g J_g'e_g, 0 at the estimate. It is conservative for few groups. Directions that a
single group determines, and those after the first G - 1, get the intervals of a white residual.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.parallel import in_threads

INTERVAL, COVERED = 2.0, 0.9544997361036416  # deviations: half an interval; and how often it holds the truth
LEVEL = 0.05  # of a test: how often it fails where nothing is wrong
SHOWN = 4.0  # deviations from 0 of a significant value
ROUNDING = 1e-9  # of the largest singular value of columns of norm 1: one that is rounding

_BANDS = 8  # of frequency, whose scores are compared
_FEWEST = 4  # frequencies of a band: eight degrees of freedom
_LEFT = 1.0  # degrees of freedom that the fit leaves in a band, at least
_SINGULAR = 1e-12  # of the largest: a direction whose variance, or information, is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """Covariance of the errors of an estimate.

    Attributes:
        std: (parameters,) standard deviations.
        correlation: (parameters, parameters).
    """

    std: FloatArray
    correlation: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """The covariances themselves, (parameters, parameters)."""
        return np.asarray(np.outer(self.std, self.std) * self.correlation)

    def std_of(self, weights: FloatArray) -> float:
        """Standard deviation of a weighted sum of the parameters, weights (parameters,)."""
        weighted = np.asarray(weights) * self.std
        return math.sqrt(max(float(weighted @ self.correlation @ weighted), 0.0))

    def append_constants(self, count: int) -> Covariance:
        """Append `count` fixed parameters, without deviation or correlation."""
        size = self.std.size
        correlation = np.eye(size + count)
        correlation[:size, :size] = self.correlation
        return Covariance(np.append(self.std, np.zeros(count)), correlation)


def covariance_of(matrix: FloatArray, scale: FloatArray | float = 1.0) -> Covariance:
    """Build a `Covariance` from a matrix, (parameters, parameters).

    Args:
        matrix: of the parameters, or of the scaled ones.
        scale: (parameters,) factors that the matrix includes.
    """
    std = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    positive = np.where(std > 0, std, 1.0)
    return Covariance(std / scale, matrix / np.outer(positive, positive))


def white(J: FloatArray, error: FloatArray) -> Covariance:
    """Covariance for a white residual, the textbook's ``s^2 (J' J)^-1``.

    Args:
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual; ``s^2 = ||error||^2 / (rows - parameters)``.
    """
    norms = column_norms(J)
    variance = float(error @ error) / max(error.size - J.shape[1], 1)
    R = np.linalg.qr(J / norms, mode="r")  # of J' J only the square of its condition number would be left
    inverse = np.linalg.pinv(R)
    return covariance_of(variance * inverse @ inverse.T, norms)


def larger(first: Covariance, second: Covariance) -> Covariance:
    """Return the smallest covariance above both.

    In the parameters in which the first is the identity and the second diagonal, take the larger diagonal.
    """
    std = np.where(first.std > 0, first.std, 1.0)
    values, vectors = np.linalg.eigh(0.5 * (first.correlation + first.correlation.T))
    kept = values > _SINGULAR * np.max(values, initial=0.0)
    root = vectors[:, kept] * np.sqrt(values[kept])
    whiten = vectors[:, kept] / np.sqrt(values[kept])
    other = whiten.T @ (second.matrix / np.outer(std, std)) @ whiten
    sizes, directions = np.linalg.eigh(0.5 * (other + other.T))
    factor = root @ directions * np.sqrt(np.maximum(sizes, 1.0))
    found = covariance_of(factor @ factor.T)
    return Covariance(found.std * std, found.correlation)


@dataclass(frozen=True, eq=False)
class Influence:
    """Equations ``Z' e = 0`` of an estimate, and covariances from residuals.

    Attributes:
        J: (rows, parameters), the sensitivities of the prediction, or of the residual with Z of the same sign.
        error: (rows,) the residual, in the order of time.
        instruments: (rows, parameters), Z; J when None.
        equations: number of simultaneous equations, stacked.
        series: rows of each record in one equation, one record after the other; one record when empty.
    """

    J: FloatArray
    error: FloatArray
    instruments: FloatArray | None = None
    equations: int = 1
    series: Sequence[int] = ()

    @cached_property
    def norms(self) -> FloatArray:
        """Norms of the instruments, (parameters,), by which both sides are scaled."""
        return column_norms(self.J if self.instruments is None else self.instruments)

    @cached_property
    def columns(self) -> FloatArray:
        """Scaled instruments, (rows, parameters)."""
        return (self.J if self.instruments is None else self.instruments) / self.norms

    @cached_property
    def slopes(self) -> FloatArray:
        """Scaled sensitivities, (rows, parameters); the scaled instruments in least squares."""
        return self.columns if self.instruments is None else self.J / self.norms

    @cached_property
    def spread(self) -> FloatArray:
        """Inverse of Z' J, scaled, (parameters, parameters)."""
        return np.asarray(np.linalg.pinv(self.columns.T @ self.slopes), dtype=np.float64)

    @property
    def matrix(self) -> FloatArray:
        """Influence of each row on each parameter, ``(Z' J)^-1 Z'``, (parameters, rows)."""
        return np.asarray(self.spread @ self.columns.T) / self.norms[:, np.newaxis]

    @property
    def lengths(self) -> Sequence[int]:
        """Number of instants of each record."""
        return self.series or (len(self.error) // self.equations,)

    @property
    def parts(self) -> list[slice]:
        """Rows of each equation of each record."""
        sizes = [*self.lengths] * self.equations
        return [slice(int(end) - rows, int(end)) for end, rows in zip(np.cumsum(sizes), sizes, strict=True)]

    def covariance(self, meat: FloatArray) -> Covariance:
        """Covariance from S of the scaled scores: ``(Z' J)^-1 S (J' Z)^-1``."""
        return covariance_of(self.spread @ meat @ self.spread.T, self.norms)

    def by_time(self) -> Covariance:
        """Covariance robust to autocorrelation, by sums over neighbouring rows."""
        lags = [min(bandwidth(count), count - 1) for count in self.lengths]
        blocks, first = list[NDArray[np.intp]](), 0
        for count, wide in zip(self.lengths, lags, strict=True):
            blocks.append(first + np.arange(count) // max(wide, 1))
            first = int(blocks[-1][-1]) + 1
        left = self.residual_left_out(np.tile(np.concatenate(blocks), self.equations))
        each, found = self._by_record(self.columns * left[:, np.newaxis]), np.zeros_like(self.spread)
        for own, wide in zip(each, lags, strict=True):
            found += bartlett_sum(np.sum(own, axis=0), wide)
        return self.covariance(found)

    def residual_left_out(self, block: NDArray[np.intp]) -> FloatArray:
        """Leave-out residual, (rows,), of each block; `block` has the index per row.

        ``(I - J_b S Z_b')^-1 = I + J_b (I - S Z_b' J_b)^-1 S Z_b'`` needs small inverses only.
        """
        sorts = bool(np.any(block[1:] < block[:-1]))
        order: NDArray[np.intp] | slice = np.argsort(block, kind="stable") if sorts else slice(None)
        Z, slopes, before, block = self.columns[order], self.slopes[order], self.error[order], block[order]
        first = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
        scores, rows = np.add.reduceat(Z * before[:, np.newaxis], first), np.diff(first, append=len(block))
        unit, norm, moved = np.eye(len(self.spread)), partial(np.linalg.norm, axis=(1, 2)), np.empty_like(scores)
        for some in np.array_split(np.arange(first.size), min(first.size * unit.size // 250_000 + 1, first.size)):
            others = unit - self.spread @ _products(Z, slopes, first[some], rows[some])
            inverse = np.linalg.inv(others + 1e-15 * np.max(np.abs(others)) * unit)  # hardly ever singular
            lost = ~(norm(others) * norm(inverse) < 1e6)
            inverse[lost] = np.linalg.pinv(others[lost], 1e-6)
            moved[some] = (inverse @ (self.spread @ scores[some, :, np.newaxis]))[..., 0]
        after = before + np.einsum("ij,ij->i", slopes, np.repeat(moved, rows, axis=0))
        # A block that a parameter rests on alone, as the first does for the initial state, cannot be left out.
        kept = np.add.reduceat(after**2, first) <= 2.0**2 * np.add.reduceat(before**2, first)
        found = np.empty_like(self.error)
        found[order] = np.where(np.repeat(kept, rows), after, before)
        return found

    def by_spectrum(self, asked: FloatArray | None = None) -> Covariance:
        """Covariance for stationary noise, by its spectrum; the deviations include Student's factor.

        Args:
            asked: (quantities, rows), influences of the same noise on other quantities than the parameters.
        """
        from scipy.special import stdtrit

        wanted = None if asked is None else asked.T
        bands = [self._bands(part, wanted) for part in self.parts]
        H, sought, K, left, power = (np.concatenate(each) for each in zip(*bands, strict=True))
        i, j = np.triu_indices(self.J.shape[1])
        M = (K * np.where(i == j, 1.0, 2.0)) @ H.T + np.diag(left)
        freedom = np.maximum(np.diag(M), 1e-3)
        inverse = np.linalg.pinv(M, rcond=1e-13)  # of the largest: a singular value that is none
        level = _solve_levels(inverse, M, power, freedom)
        size = self.J.shape[1] if asked is None else len(asked)
        (i, j), matrix = np.triu_indices(size), np.empty((size, size))
        matrix[i, j] = matrix[j, i] = level @ sought
        answers = inverse.T @ sought[:, i == j]  # of each deviation squared, to the power of each band
        variance = 2.0 * (level**2 * freedom) @ answers**2
        known = variance > 0
        degrees = 2.0 * np.diag(matrix) ** 2 / np.where(known, variance, 1.0)
        factor = np.where(known, np.asarray(stdtrit(np.maximum(degrees, 1.0), 0.5 + 0.5 * COVERED) / INTERVAL), 1.0)
        return covariance_of(matrix * np.outer(factor, factor), self.norms if asked is None else 1.0)

    def _bands(self, part: slice, asked: FloatArray | None) -> tuple[FloatArray, ...]:
        """Quantities of one record by frequency band; symmetric matrices as upper triangles.

        These are A E_b A' and the same for `asked`, J' E_b J, all (bands, triangle), the degrees of freedom less twice
        those of the fit, (bands,), and the power of the residual, (bands,).
        """
        rows = len(self.error[part])
        both = np.full(rows // 2 + 1, 2.0)  # half a spectrum holds a frequency for two, but the first and an even last
        both[0] = 1.0
        both[-1] = 2.0 if rows % 2 else 1.0
        weight = np.sqrt(both / rows)

        def transform(signals: FloatArray) -> FloatArray:
            """Half-spectra of signals, (signals, 2 frequencies), real and imaginary parts interleaved."""
            columns = np.ascontiguousarray(signals[part].reshape(rows, -1).T)
            return np.asarray((weight * np.fft.rfft(columns)).view(np.float64))

        slopes, left = transform(self.slopes), transform(self.error)
        A = self.spread @ (slopes if self.instruments is None else transform(self.columns))
        taken = np.einsum("cf,cf->f", A, slopes).reshape(-1, 2).sum(axis=1)
        first = _borders(both - taken, rows)
        bands = [slice(*pair) for pair in zip(2 * first, [*(2 * first[1:]), A.shape[1]], strict=True)]

        def each(spectra: FloatArray) -> FloatArray:
            i, j = np.triu_indices(len(spectra))
            return np.array([spectra[:, band] @ spectra[:, band].T for band in bands])[:, i, j]

        own = each(A)
        degrees = np.add.reduceat(both - 2.0 * taken, first)
        wanted = own if asked is None else each(transform(asked))
        return own, wanted, each(slopes), degrees, np.add.reduceat(left[0] ** 2, 2 * first)

    def robust(self) -> Covariance:
        """Larger of the covariances by time and by spectrum in every direction.

        Each equation of one record has its own spectrum; sums over time cover their correlation.
        """
        ways: tuple[Callable[[], Covariance], ...] = lambda: self.prewhiten().by_time(), self.by_spectrum
        return larger(*in_threads(lambda way: way(), ways))

    def prewhiten(self) -> Influence:
        """Whiten a residual that grows with frequency; the estimate stays the same.

        With the autoregression F of a record's rows, ``(F^-T Z)' (F e) = Z' e``, and likewise with J: the sums of
        scores are the same, and scores nearly independent (Andrews and Monahan 1992). F has the order `bandwidth`.
        """
        from scipy import linalg, signal

        found = self
        for part in self.parts:
            own, rows = self.error[part], part.stop - part.start
            lagged = np.array([own[: rows - lag] @ own[lag:] for lag in range(min(bandwidth(rows), rows - 1) + 1)])
            if lagged.size > 1 and lagged[1] < -0.1 * lagged[0]:  # it grows with the frequency
                law = np.concatenate([[1.0], -linalg.solve_toeplitz(lagged[:-1], lagged[1:])])
                J, error = found.J.copy(), found.error.copy()
                Z = J.copy() if found.instruments is None else found.instruments.copy()
                Z[part] = signal.lfilter([1.0], law, Z[part][::-1], axis=0)[::-1]
                J[part], error[part] = signal.lfilter(law, [1.0], J[part], axis=0), signal.lfilter(law, [1.0], own)
                found = replace(found, J=J, error=error, instruments=Z)
        return found

    def stationary(self) -> Covariance:
        """Covariance of given equations under the error's smoothed spectrum, without fit correction."""
        used = int(np.sum(np.any(self.columns != 0.0, axis=0)))
        spectrum, both = smoothed_spectrum(self.error, max(len(self.columns) - used, 1))
        weights = np.concatenate([spectrum[:1], both * spectrum])
        spectra = np.fft.rfft(self.columns, axis=0)
        meat = np.real((weights[:, np.newaxis] * spectra.conj()).T @ spectra)
        return self.covariance(np.asarray(meat) / len(self.columns))

    def by_frequency(self) -> FloatArray:
        """Change of the estimate by each frequency's residual, (frequencies, parameters)."""
        size, scores = max(self.lengths), np.zeros((1, len(self.spread)))
        for columns, error in zip(self._by_record(self.columns), self._by_record(self.error), strict=True):
            spectra = 2.0 / size * np.fft.rfft(error, size, axis=1)[..., np.newaxis]
            scores = scores + np.sum(np.real(np.conj(np.fft.rfft(columns, size, axis=1)) * spectra), axis=0)
        return np.asarray(scores @ self.spread.T / self.norms)

    def _by_record(self, rows: FloatArray) -> list[FloatArray]:
        """Rows of each record, (equations, instants, ...)."""
        every = rows.reshape(self.equations, -1, *rows.shape[1:])
        return np.split(every, np.cumsum(self.lengths)[:-1], axis=1)

    def widen_for_bands(self, covariance: Covariance) -> Covariance:
        """Raise the deviations to the estimate's spread over the choice of band.

        A model error changes with frequency: scores are summed over bands with equal shares of the residual.
        """
        spectra = [np.fft.rfft(one, max(self.lengths), axis=1) for one in self._by_record(self.error)]
        energy = np.cumsum(np.sum(np.abs(np.concatenate(spectra)) ** 2, axis=0))
        edges = np.searchsorted(energy, energy[-1] * np.arange(1, _BANDS) / _BANDS)
        # A line of the spectrum may fill several bands, of which all but one are then empty.
        sums = np.add.reduceat(self.by_frequency(), np.unique(np.append(0, edges)), axis=0)
        # The sum over all bands is what the estimate made 0, so one of them is not free.
        std = np.sqrt(_BANDS / (_BANDS - 1) * np.sum(sums**2, axis=0))
        return replace(covariance, std=np.maximum(covariance.std, std))

    def widen_for_motion(self, covariance: Covariance) -> Covariance:
        """Widen the deviations for a force in the loop along measured motion.

        The bias is of the size of the largest partial sum of the influences over frequency (docs/how-it-works.md, T17).
        Noise on the log alone widens the deviations by a factor of 1.35 on the average.
        """
        bias = np.max(np.abs(np.cumsum(self.by_frequency(), axis=0)), axis=0)
        return replace(covariance, std=np.hypot(covariance.std, bias))


def bandwidth(rows: int) -> int:
    """Number of correlated neighbouring rows, ``ceil(4 (n / 100)^(2/9))``."""
    return math.ceil(4.0 * math.pow(rows / 100, 2 / 9))


def bartlett_sum(scores: FloatArray, lags: int) -> FloatArray:
    """Covariance, (parameters, parameters), of a sum of autocorrelated scores.

    Args:
        scores: (neighbours, parameters), or (neighbours, families, parameters) of independent families.
        lags: correlated neighbours on each side, with Bartlett's weights.
    """
    families, count = math.prod(scores.shape[1:-1]), scores.shape[-1]
    rows, found = scores.reshape(len(scores) * families, count), np.zeros((count, count))
    for lag in range(lags + 1):
        apart = lag * families
        together = rows[apart:].T @ rows[: len(rows) - apart]
        found += together if lag == 0 else (1 - lag / (lags + 1)) * (together + together.T)
    return found


def _products(Z: FloatArray, J: FloatArray, first: NDArray[np.intp], lengths: NDArray[np.intp]) -> FloatArray:
    """Products ``Z_b' J_b``, (blocks, parameters, parameters), batched over blocks of equal length."""
    found = np.empty((len(first), Z.shape[1], J.shape[1]))
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        rows = first[same][:, np.newaxis] + np.arange(length)
        found[same] = Z[rows].transpose(0, 2, 1) @ J[rows]
    return found


def smoothed_spectrum(signal: FloatArray, degrees: int, rows: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Smoothed spectrum per degree of freedom, summed over columns, and multiplicities.

    Both are (rows // 2,), without the mean; zeros extend the signal to `rows`. The periodogram is averaged over
    sqrt(rows) neighbours.
    """
    from scipy.fft import rfft  # of columns, and of a length with large prime factors, in half of NumPy's time

    rows = rows or len(signal)
    periodogram = np.sum(np.abs(rfft(signal.reshape(len(signal), -1), rows, axis=0)[1:]) ** 2, axis=1) / degrees
    half = min(max(math.isqrt(rows) // 2, 1), periodogram.size - 1)
    padded = np.pad(periodogram, half, "reflect")
    both = np.full(periodogram.size, 2.0)
    both[-1] = 2.0 if rows % 2 else 1.0
    return np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid"), both


def _borders(left: FloatArray, rows: int) -> NDArray[np.intp]:
    """First frequency of each band of sufficient residual degrees of freedom."""
    total, first = np.concatenate([[0.0], np.cumsum(left)]), [0]
    while True:
        k = first[-1]
        wide = max(_FEWEST, min(int(0.25 * k), math.isqrt(rows)))  # of its frequency, that a band is wide
        after = min(k + wide, left.size)
        if total[after] < total[k] + _LEFT:
            after = max(after, int(total.searchsorted(total[k] + _LEFT)))
        if after + _FEWEST > left.size:  # what is left is the last band's
            return np.array(first)
        first.append(after)


def _solve_levels(inverse: FloatArray, M: FloatArray, power: FloatArray, freedom: FloatArray) -> FloatArray:
    """Solve for non-negative band levels, weighted by degrees of freedom."""
    from scipy.optimize import nnls

    found = inverse @ power
    if np.all(found >= 0.0):
        return np.asarray(found)
    scale = np.sqrt(freedom)
    unit = float(np.max(power)) or 1.0  # the solver has tolerances of its own
    try:
        found, _ = nnls(M / scale[:, np.newaxis], power / (unit * scale))
    except RuntimeError:  # too many iterations
        return power / freedom
    return np.asarray(unit * found)


# Sums over groups of rows


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Sums over rows for a least-squares estimate.

    Attributes:
        A: (free, free) J'J. b: (free,) J'e. square: e'e. size: y'y of the filtered torque that e is left of.
    """

    A: FloatArray
    b: FloatArray
    square: float
    size: float
    rows: int

    @classmethod
    def of(cls, error: FloatArray, J: FloatArray, measured: FloatArray) -> Sums:
        """Sum rows: residual, (rows,), derivatives, (rows, free), and measured, (rows,)."""
        return cls(J.T @ J, J.T @ error, float(error @ error), float(measured @ measured), error.size)

    @property
    def relative_error(self) -> float:
        """Norm of the residual relative to the measured signal; 0 without one."""
        return float(np.sqrt(self.square / self.size)) if self.size > 0 else 0.0

    def __add__(self, other: Sums) -> Sums:
        """Sums over the rows of both."""
        square, size, rows = self.square + other.square, self.size + other.size, self.rows + other.rows
        return Sums(self.A + other.A, self.b + other.b, square, size, rows)

    def shift(self, step: FloatArray) -> Sums:
        """Update the sums for a step of the parameters, to first order."""
        square = self.square + float(2 * self.b @ step + step @ self.A @ step)
        return Sums(self.A, self.b + self.A @ step, max(square, 0.0), self.size, self.rows)


def total(groups: Sequence[Sums]) -> Sums:
    """Add the sums of all groups."""
    return sum(groups[1:], start=groups[0])


def rows_of(sums: Sums) -> tuple[FloatArray, FloatArray]:
    """Fewest rows with these sums: residual, (rows,), and derivatives, (rows, free)."""
    scale, sizes, vectors = determine(sums.A)
    J = (vectors * np.sqrt(sizes)).T * scale
    error = vectors.T @ (sums.b / scale) / np.sqrt(sizes)
    rest = math.sqrt(max(sums.square - float(error @ error), 0.0))
    return np.append(error, rest), np.vstack([J, np.zeros(scale.size)])


def left_out(groups: Sequence[Sums]) -> Covariance:
    """Jackknife covariance over two or more groups."""
    whole = total(groups)
    scale, sizes, vectors = determine(whole.A)
    outer = np.outer(scale, scale)
    steps = np.array(
        [-np.linalg.pinv((whole.A - g.A) / outer, hermitian=True) @ ((whole.b - g.b) / scale) for g in groups]
    )
    apart = steps - steps.mean(axis=0)
    found = covariance_of((len(groups) - 1) / len(groups) * apart.T @ apart)
    back = vectors / np.sqrt(sizes)
    most = max(float(np.linalg.eigvalsh(back.T @ (g.A / outer) @ back)[-1]) for g in groups)
    if most > 0.9 or len(groups) <= scale.size:  # of the information in a direction: the group is as good as alone
        white = covariance_of(whole.square / max(whole.rows - scale.size, 1) * back @ back.T)
        found = larger(white, found)
    return Covariance(found.std / scale, found.correlation)


def determine(A: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Norms of J's columns (1 if zero); significant eigenpairs of scaled ``J'J``."""
    norms = np.sqrt(np.diag(A))
    scale = np.where(norms > 0, norms, 1.0)
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    kept = values > _SINGULAR * values[-1]
    return scale, values[kept], vectors[:, kept]
