"""Intervals wide enough for what a model lacks: where a second solution of the same equations lies elsewhere.

Least squares, ``J' e = 0``, and the solution by instruments, ``Z' e = 0``, have the same answer where the model is
true, but for noise; what a model lacks moves them apart, because they weigh it otherwise. From where least squares
ended the other is a step away,

    d = (Z' J)^-1 Z' e

Both solutions answer to the same noise n, so that what it makes of the step is the difference of their answers
(Hausman 1978), with the Bartlett kernel over neighbouring rows or by the residual's spectrum, whichever says more::

    d = ((Z' J)^-1 Z' - (J' J)^-1 J') n

It may be a third of what noise makes of either solution. Where a parameter's d is more than two of its deviations,
noise did not make it, and it is added to the parameter's deviation, as one of its own size: the interval of 2 sigma
then holds both solutions. Elsewhere nothing is added.

On the EMPS axis, whose friction is no Coulomb's, the masses that two records give lie 1.3 kg apart by least squares and
0.4 kg by instruments; d is 0.5 and 0.4 kg, of which the first is no noise. An error of the model that moves both
solutions alike is not seen.
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
    """Return how far the solution by instruments is from least squares, and what noise makes of that, (parameters,).

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
    """Return what is known by least squares, wide enough for the solution by instruments (see the module).

    Args:
        known: of least squares.
        Z: (rows, parameters), the instruments.
        J: (rows, parameters), the sensitivities of the prediction.
        error: (rows,) the residual of least squares.
        inside: (parameters,) which do not stand at a bound; the others are held there.
    """
    shift, noise = np.zeros(inside.size), np.zeros(inside.size)
    shift[inside], noise[inside] = second_solution(Z[:, inside], J[:, inside], error)
    beyond = np.abs(shift) > _NOISE * noise
    if not np.any(beyond):
        return known
    why = "how far the solution by the regressor lies away, which noise does not explain"
    return known.widened_by(np.where(beyond, shift, 0.0), why)
