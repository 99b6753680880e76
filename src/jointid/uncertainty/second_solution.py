"""Intervals that cover model error, by a second solution of the same equations.

Least squares, ``J' e = 0``, and instruments, ``Z' e = 0``, agree for a true model except for noise; a model error
separates them. From the least-squares estimate the other solution is a step away,

    d = (Z' J)^-1 Z' e

The effect of the common noise n on the step (Hausman 1978) is estimated with the Bartlett kernel or by spectrum,
whichever is larger::

    d = ((Z' J)^-1 Z' - (J' J)^-1 J') n

Where a parameter's d exceeds two of its deviations, d is added to the parameter's deviation, so that 2 sigma covers
both solutions.

On the EMPS axis, whose friction is not Coulomb's, the masses from two records differ by 1.3 kg by least squares and
0.4 kg by instruments; d is 0.5 and 0.4 kg, the first significant. A model error that moves both solutions alike is not
detected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.solvers.regression import projection
from jointid.uncertainty.covariance import bandwidth, bartlett_sum
from jointid.uncertainty.position_dependent_error import Uncertainty
from jointid.uncertainty.spectral import spectral_covariance

_NOISE = 2.0  # deviations: a solution that is further away is so by what the model lacks


def second_solution(Z: FloatArray, J: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shift from least squares to instruments, and its deviation, (parameters,).

    Args:
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual of least squares.
    """
    least, norms = projection(J, J), column_norms(J)
    between = projection(Z, J) - least
    near = np.diag(bartlett_sum((between * error).T, bandwidth(error.size)))
    scale = norms[:, np.newaxis]  # the parameters' units differ by powers of ten
    whole = [slice(0, error.size)]
    spread, factor = spectral_covariance((scale * least).T, J / norms, error, whole, (scale * between).T)
    noise = np.maximum(np.sqrt(np.maximum(near, 0.0)), factor * np.sqrt(np.diag(spread)) / norms)
    return between @ error, noise


def widened_to_second(
    known: Uncertainty, Z: FloatArray, J: FloatArray, error: FloatArray, inside: NDArray[np.bool_]
) -> Uncertainty:
    """Widen an uncertainty to cover the solution by instruments (see the module).

    Args:
        known: of least squares.
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual of least squares.
        inside: (parameters,) which are not at a bound; the others stay.
    """
    shift, noise = np.zeros(inside.size), np.zeros(inside.size)
    shift[inside], noise[inside] = second_solution(Z[:, inside], J[:, inside], error)
    significant = np.abs(shift) > _NOISE * noise
    if not np.any(significant):
        return known
    why = "how far the solution by the regressor lies away, which noise does not explain"
    return known.widened_by(np.where(significant, shift, 0.0), why)
