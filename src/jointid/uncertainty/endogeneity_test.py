"""Whether IDIM's regressors are correlated with its errors: the test of Durbin, Wu and Hausman.

Least squares is right where the columns W know nothing of the error, instruments Z are right in any case. In the
augmented regression ``Y = W x + V c``, V being what of W the instruments do not explain, x are the values by
instruments (two-stage least squares) and ``d = (W'W)^-1 W'V c`` is how far least squares is away from them. The test
asks whether the shift d is more than chance, with covariances that an autocorrelated residual does not deceive.

On a good encoder V is so small that the test would see, truly but to no purpose, a correlation that shifts nothing:
quantisation alone made 15 to 40 % alarms on the paper's axis, with shifts below 0.05 deviations. So d must stand out
from its own covariance and from a tenth of the deviations of least squares together,
``T = d' (cov(d) + 0.01 cov(x))^-1 d``: it never says more than chi-square would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.uncertainty.covariance import Covariance, sandwich

_MATTERS = 0.1  # deviations of least squares: a smaller shift is none
_SAME = 1e-9  # of a column: what instruments leave of it is then rounding
_RANK = 1e-3  # of the largest: directions of V that are less are not counted
_LEVEL = 0.05


@dataclass(frozen=True, slots=True)
class ChiSquareTest:
    """A statistical test.

    Attributes:
        name: what it is called.
        statistic: its value; degrees: of freedom of its chi-square distribution.
        p_value: how likely so large a statistic is if nothing is wrong.
        rejected: whether the hypothesis that nothing is wrong is rejected, at 5 %.
        sentence: what that means.
    """

    name: str
    statistic: float
    degrees: int
    p_value: float
    rejected: bool
    sentence: str


def durbin_wu_hausman(W: FloatArray, Y: FloatArray, Z: FloatArray, equations: int = 1) -> ChiSquareTest:
    """Test whether columns are correlated with the error of their least squares (see the module).

    Args:
        W: (rows, parameters) the columns.
        Y: (rows,) the torque.
        Z: (rows, parameters) the instruments.
        equations: rows hold so many equations one after the other.
    """
    W, Z = W / np.linalg.norm(W, axis=0), Z / np.linalg.norm(Z, axis=0)
    V = W - Z @ np.linalg.lstsq(Z, W, rcond=None)[0]
    U, sizes, _ = np.linalg.svd(V[:, np.linalg.norm(V, axis=0) > _SAME], full_matrices=False)
    degrees = int(np.sum(sizes > _RANK * sizes[0])) if sizes.size else 0
    if degrees == 0:
        return _result(0.0, 0)
    V = U[:, :degrees]
    both = np.column_stack([W, V])
    found, *_ = np.linalg.lstsq(both, Y, rcond=None)
    of_c = _matrix(sandwich(both, both, Y - both @ found, equations))[-degrees:, -degrees:]
    x, *_ = np.linalg.lstsq(W, Y, rcond=None)
    of_x = _matrix(sandwich(W, W, Y - W @ x, equations))
    per_c, *_ = np.linalg.lstsq(W, V, rcond=None)
    shift = per_c @ found[-degrees:]
    statistic = float(shift @ np.linalg.pinv(per_c @ of_c @ per_c.T + _MATTERS**2 * of_x, hermitian=True) @ shift)
    return _result(statistic, degrees)


def _matrix(covariance: Covariance) -> FloatArray:
    return np.asarray(covariance.correlation * np.outer(covariance.std, covariance.std))


def _result(statistic: float, degrees: int) -> ChiSquareTest:
    from scipy.special import chdtrc

    p = float(chdtrc(degrees, statistic)) if degrees else 1.0
    rejected = p < _LEVEL
    if rejected:
        sentence = (
            f"IDIM's regressors are correlated with its errors (p = {p:.2g}): its least-squares values are biased; use "
            "IV or DIDIM"
        )
    else:
        sentence = f"nothing speaks against least squares (p = {p:.2g}): its values agree with those by instruments"
    return ChiSquareTest("Durbin-Wu-Hausman", statistic, degrees, p, rejected, sentence)
