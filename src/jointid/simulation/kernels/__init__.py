"""Rows of numbers and of tapes that kernels take and fill, by their columns; no kernel is loaded with them."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.models import friction

IndexArray: TypeAlias = NDArray[np.uint64]
IntArray: TypeAlias = NDArray[np.int64]

FINISHED, DIVERGED, TOO_STIFF, CHATTERING, NOT_POSITIVE = range(5)
"""How a run ended, in the order of `simulate.Outcome`."""
LANES = 8
"""Columns followed at a time: one vector of a wide machine, two of others."""

# Columns of a mass in a band of its speed: inertia, constant friction, viscous coefficients and Coulomb forces of both
# directions, what both grow by per second, what the second grows by per torque that the mass carries, the law by which
# it winds up, the inverse of the displacement over which (0 of one that sticks), further numbers of that law, and the
# speed at which the band ends.
INERTIA, OFFSET, VISCOUS, VISCOUS_BACK, COULOMB, COULOMB_BACK = range(6)
VISCOUS_DRIFT, COULOMB_DRIFT = friction.COLUMNS["viscous_drift"], friction.COLUMNS["coulomb_drift"]
PER_TORQUE, WINDING = friction.COLUMNS["friction_per_torque"], friction.WINDING
MASS = HIGH = friction.WIDTH
# Columns of a spring in a piece of its deflection, of either sign: stiffness, damping, cubic stiffness, limit of its
# slider, the torque of the piece's line at no deflection, and where the piece begins. Its slider is WINDING, too.
STIFFNESS, DAMPING, CUBIC, SLIPS, HELD, BEGIN = range(6)
# Columns of a force that follows a position: of its cosine, of its sine, of the position, phase per position, mass.
COS, SIN, RATE, WAVE, WHERE = range(5)

# The tape has a row for each step: the part of a period (-1 before the first), the length, the guard whose event ended
# it (or -1); of the masses positions, velocities and accelerations as it begins, and accelerations as it ends; then of
# masses and springs the modes, the bands and pieces, and what is wound up as it begins.
PART, LENGTH, EVENT, STATE = range(4)

FREE = 2.0  # the mode of a mass that no friction holds


class Plant(NamedTuple):
    """The numbers of a joint, or of what a robot has beside its links.

    Attributes:
        masses: (masses, bands, MASS + 1) in each band of the speed; a band that is not there ends where the last does.
        springs: (springs, pieces, MASS) in each piece; one that is not there begins at infinity.
        places: (forces, 5) that follow a position.
        pairs: (springs, 2) the masses that each ties.
        motors: (axes,) the mass that each motor drives.
        carriers: (masses,) the spring whose torque a mass's friction grows with; -1 of its own motor's.
    """

    masses: FloatArray
    springs: FloatArray
    places: FloatArray
    pairs: IndexArray
    motors: IndexArray
    carriers: IntArray


class SampledLoop(NamedTuple):
    """Sampled controllers and inputs, independent of the joints; the first axis of arrays is theirs.

    Of a law (`jointid.models.controllers.SampledLaw`) what does not depend on the motion is taken out, and arrays are
    filled up with zeros to equal sizes.

    Attributes:
        lengths: (parts,) seconds of each part of a step of the controllers' clock, first to last.
        lags: (joints, parts) how many steps ago the torque that acts in each part was put out.
        every: (joints,) the period of each controller, in steps of the clock.
        A: (joints, phases of a law's cycle, nz, nz). Bq: (joints, phases, nz) from the position.
        F: (joints, phases, nz, elements) from what limits and gates take away.
        C: (joints, phases, elements, nz). D: (joints, phases, elements) from the position.
        E: (joints, phases, elements, elements) from what limits and gates take away.
        limits, gates: (joints, elements) of all phases.
        driven: (joints, periods, nz) what else goes into the states; (joints, 0, nz) where the responses hold it.
        output: (joints,) the element whose value acts, the torque's limit.
        w: (joints, elements, periods) response of their elements to the references and to what is added before the
            limits, each of its own periods.
        post: (joints, clock) what is added after the limits.
    """

    lengths: FloatArray
    lags: IntArray
    every: IntArray
    A: FloatArray
    Bq: FloatArray
    F: FloatArray
    C: FloatArray
    D: FloatArray
    E: FloatArray
    limits: FloatArray
    gates: IntArray
    driven: FloatArray
    output: IntArray
    w: FloatArray
    post: FloatArray


class Path(NamedTuple):
    """States and modes of a joint of straight lines, or of lines in pieces, as each part begins.

    Attributes:
        states: (parts, 4); or (0, 4) unless they are kept.
        modes: (parts,) ``3 m1 + m2 + 4``, and 9 times the number of bands and piece, see `affine.enter_mode`; or (0,).
        rates: (modes, 2, 5) of each that was met the accelerations of motor and load by motor velocity, stretch, load
            velocity, torque and constant forces.
        moves, bends: (modes * parts, 5, 4) and (modes * parts, 4), their maps, see `affine.enter_mode`.
        pushes: (modes * parts, 5 * 4 * LANES) of a kept run, room for the derivatives of the maps.
    """

    states: FloatArray
    modes: NDArray[np.int16]
    rates: FloatArray
    moves: FloatArray
    bends: FloatArray
    pushes: FloatArray


class Seeds(NamedTuple):
    """How the numbers of a plant depend on parameters: a list of derivatives that are not 0.

    Attributes:
        begin: (masses, springs and places, bands + 1) the first of a mass in a band, a spring in a piece, a place.
        numbers, columns, values: (derivatives,) of which number by which parameter.
        links: (some parameters, 3) which is the number of which link, in which column of its inertial ones.
        delays: (some parameters, 2) which is by how much the torque of which axis acts later.
    """

    begin: IntArray
    numbers: IntArray
    columns: IntArray
    values: FloatArray
    links: IntArray
    delays: IntArray
