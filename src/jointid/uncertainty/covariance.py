"""Covariance of an estimate's errors: standard deviations and correlations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray, column_norms

_SINGULAR = 1e-10  # of the largest: a direction whose variance is rounding


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
        """Return the covariance with `count` more parameters that are fixed: without deviation or correlation."""
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
