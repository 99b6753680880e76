"""Ten inertial parameters of a link: mass properties and pseudo-inertia.

The parameters ``m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz`` are about the origin of the link's frame. The
pseudo-inertia gathers the same numbers in one matrix of second moments of the mass::

    P = | S   h |      S = tr(I) / 2 - I = integral of r r' dm,    h = m c
        | h'  m |

which is positive definite for every body that there can be, and only for those [Wensing, Kim and Slotine 2018]. Its
matrix ``exp(alpha) U U'``, U upper triangular with exponentials on its diagonal, has ten free numbers: the
log-Cholesky parameters of Rucker and Wensing 2022.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError

SYMBOLS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
UNITS = ("kg", "kg m", "kg m", "kg m", *6 * ("kg m2",))

_ROUNDING = 1e-10  # of the largest second moment: below 0 by less than this is a thin body
_UPPER = np.triu_indices(3)
_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # of U, beside its scale


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties:
    """Mass, centre and inertia of a body, as in drawings.

    Attributes:
        mass: kg.
        centre: (3,) of mass, in the link's frame, m.
        inertia: (3, 3) about the centre, along the axes of the link's frame, kg m2.
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray

    @property
    def inertial(self) -> FloatArray:
        """The ten parameters, (10,)."""
        about_origin = self.inertia + self.mass * _steiner(self.centre)
        return np.array([self.mass, *(self.mass * self.centre), *about_origin[_UPPER]])


def _steiner(r: FloatArray) -> FloatArray:
    return np.asarray(r @ r * np.eye(3) - np.outer(r, r))


def mass_properties(inertial: FloatArray) -> MassProperties:
    """Mass, centre and inertia at the centre from ten parameters, (10,).

    Raises:
        MethodError: the mass is not positive, so that there is no centre.
    """
    mass = float(inertial[0])
    if not mass > 0:
        raise MethodError(
            f"A link of {mass:g} kg has no centre of mass; expected a positive mass: identify one near a prior."
        )
    centre = inertial[1:4] / mass
    return MassProperties(mass, centre, inertia_matrix(inertial) - mass * _steiner(centre))


def inertia_matrix(inertial: FloatArray) -> FloatArray:
    """Inertia about the frame's origin, (3, 3), of the ten parameters."""
    xx, xy, xz, yy, yz, zz = inertial[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def pseudo_inertia(inertial: FloatArray) -> FloatArray:
    """Return the pseudo-inertia, (4, 4), of the ten parameters, (10,)."""
    inertia = inertia_matrix(inertial)
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return np.block([[second, inertial[1:4, np.newaxis]], [inertial[np.newaxis, 1:4], inertial[:1, np.newaxis]]])


def inertial_of(pseudo: FloatArray) -> FloatArray:
    """Return the ten parameters, (10,), of a pseudo-inertia, (4, 4)."""
    second = pseudo[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    return np.array([pseudo[3, 3], *pseudo[:3, 3], *inertia[_UPPER]])


def is_physical(inertial: FloatArray) -> bool:
    """True if a body can have these ten parameters, (10,).

    Thin bodies, rods and plates, count; so does a link without any mass.
    """
    if not np.any(inertial):
        return True
    mass, scale = inertial[0], max(float(np.trace(inertia_matrix(inertial))), 0.0)
    if not (mass > 0 and np.all(np.isfinite(inertial))):
        return False
    pseudo = pseudo_inertia(inertial)
    at_centre = pseudo[:3, :3] - np.outer(inertial[1:4], inertial[1:4]) / mass
    return bool(np.linalg.eigvalsh(at_centre)[0] >= -_ROUNDING * scale)


def change_frame(inertial: FloatArray, rotation: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the ten parameters of a body in another frame.

    Args:
        inertial: (10,) in the body's own frame.
        rotation: (3, 3) of that frame to the other.
        origin: (3,) of that frame in the other, m.
    """
    placed = np.block([[rotation, origin[:, np.newaxis]], [np.zeros((1, 3)), np.ones((1, 1))]])
    return inertial_of(placed @ pseudo_inertia(inertial) @ placed.T)


def log_cholesky(pseudo: FloatArray) -> FloatArray:
    """Return the log-Cholesky parameters, (10,), of a positive definite pseudo-inertia, (4, 4).

    ``alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3`` [Rucker and Wensing 2022, (11)]; t is the centre of mass in m.

    Raises:
        numpy.linalg.LinAlgError: it is not positive definite.
    """
    U = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]
    scaled = U / U[3, 3]
    logs = np.log(np.diag(scaled)[:3])
    return np.array([np.log(U[3, 3]), *logs, scaled[0, 1], scaled[1, 2], scaled[0, 2], *scaled[:3, 3]])


def from_log_cholesky(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inertial parameters, (10,), of log-Cholesky ones, (10,), and derivatives, (10, 10).

    They are physically consistent for all numbers.
    """
    alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 = parameters
    lengths = np.exp([d1, d2, d3])
    U = np.exp(alpha) * np.array(
        [[lengths[0], s12, s13, t1], [0, lengths[1], s23, t2], [0, 0, lengths[2], t3], [0, 0, 0, 1]]
    )
    slopes = np.zeros((10, 4, 4))
    slopes[0] = U
    for k, (row, column) in enumerate(_ENTRIES, 1):
        slopes[k, row, column] = np.exp(alpha) * (lengths[row] if row == column else 1.0)
    derivatives = [inertial_of(slope @ U.T + U @ slope.T) for slope in slopes]
    return inertial_of(U @ U.T), np.array(derivatives).T
