"""The gains of a robot's drives from a payload of known mass: what each motor's current is worth in torque.

Currents I alone tell all gains and parameters but for one common factor. A payload of which the mass is known, in the
second of two records, tells that factor as well [M. Gautier, S. Briot: Global identification of joint drive gains and
dynamic parameters of robots, Journal of Dynamic Systems, Measurement, and Control 136, 2014]::

    g I = W x            without the payload
    g I = W x + W_L x_L  with it, of whose ten parameters x_L some are known

There this is a homogeneous system, solved by total least squares. Here it stands as ``I = k (W x + W_L x_L)``, k = 1/g
of each joint: the currents, which hold the noise, are on one side, so least squares by Gauss and Newton's steps has no
bias of theirs, each joint weighs by its error, and the covariance is that of every other estimate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Paragraph, Table
from jointid.common.errors import MethodError, require_type
from jointid.common.messages import no_choice
from jointid.common.text import interval
from jointid.estimation.robots.payload import both_records
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.regression import least_squares
from jointid.uncertainty.covariance import Covariance, robust

_STEPS = 50
_SETTLED = 1e-4  # deviations: the largest change that ends the search


@dataclass(frozen=True, slots=True, eq=False)
class DriveGains(Documented):
    """Gains of the drives: factors on the logged torques.

    Attributes:
        joints: their names.
        values: (n,) gains, torque behind the gear for torque as it was read.
        std: (n,) their deviations.
        covariance: of the reciprocals of the gains, then of the robot's and the payload's parameters.
    """

    joints: tuple[str, ...]
    values: FloatArray
    std: FloatArray
    covariance: Covariance

    @property
    def rows(self) -> Mapping[str, Mapping[str, float]]:
        """Value and deviation of each gain, by its joint's name."""
        pairs = zip(self.joints, map(float, self.values), map(float, self.std), strict=True)
        return {name: {"value": value, "std": std} for name, value, std in pairs}

    def to_document(self, *, details: bool = False) -> Document:
        """Return the gains with their intervals; there are no further details."""
        del details
        rows = tuple(
            (name, interval(float(value), 2 * float(std)), f"{100 * std / value:.2g}")
            for name, value, std in zip(self.joints, self.values, self.std, strict=True)
        )
        said = (
            "What each joint's torque, as the robot file reads it, is to be multiplied with; of a current read with "
            "torque_constant = 1, the drive's gain."
        )
        return Document(
            "Gains of the drives, by a payload of known mass",
            (Paragraph(said, lead=True), Table(("joint", "gain, 2 sigma", "sigma, %"), rows, words=(0, 1))),
        )


def identify_drive_gains(
    robot: Robot,
    empty: Sequence[Record],
    loaded: Sequence[Record],
    known: Mapping[str, float],
    *,
    filtering: Filtering | None = None,
) -> DriveGains:
    """Identify the gain of each joint's drive from a record without and one with a payload that is known in part.

    Args:
        robot: its geometry, gravity and coupling.
        empty: the record of each joint without the payload; the torques are in any unit, each joint's its own.
        loaded: the record of each joint with it, in the same units.
        known: of the payload, by the symbols of `inertial`, in the last link's frame; the mass `m` at least.
        filtering: of positions and rows.

    Raises:
        MethodError: the mass is not among what is known, or not positive; the records do not determine the gains.
        RecordError: as of `identify_robot`.

    Valid for gears without losses that grow with the load: such a loss is taken for a part of the gain.
    """
    require_type(robot, Robot, "The gains of drives are identified with a Robot", "give the robot alone")
    for name in known:
        if name not in SYMBOLS:
            raise MethodError(f"A number of the payload{no_choice(name, SYMBOLS)}")
    if not known.get("m", 0.0) > 0:
        raise MethodError(
            f"The payload's mass is {known.get('m', 0.0):g} kg; expected a positive one, as it was weighed."
        )
    rows, n = both_records(robot, empty, loaded, filtering or Filtering()), len(robot)
    own = len(rows.names) - len(SYMBOLS)
    given = np.array([known.get(symbol, 0.0) for symbol in SYMBOLS])
    free = [*range(own), *(own + i for i, symbol in enumerate(SYMBOLS) if symbol not in known)]
    joint = np.tile(np.arange(n), 2).repeat(rows.Y.size // (2 * n))
    carried, columns = rows.W[:, own:] @ given, rows.W[:, free]
    each = np.eye(n)[joint]
    # The start: g I = W x, whose noise is taken for none; the gains come out too small, and of the right order.
    names = tuple(f"gain of {name}" for name in robot.names)
    others = tuple(rows.names[i] for i in free)
    start = least_squares(np.column_stack([each * rows.Y[:, np.newaxis], -columns]), carried, (*names, *others)).values
    if not np.all(start[:n] > 0):
        wrong = ", ".join(name for name, gain in zip(robot.names, start[:n], strict=True) if gain <= 0)
        raise MethodError(
            f"The gain of {wrong} does not come out positive; expected currents and positions of one sign, and a "
            "payload heavy enough to be felt: check the signs, and that the second record is the one with it."
        )
    k, x = 1 / start[:n], start[n:]
    for _ in range(_STEPS):
        torque = columns @ x + carried
        error = rows.Y - k[joint] * torque
        size = np.sqrt(np.mean(error.reshape(2, n, -1) ** 2, axis=(0, 2)))
        weight = 1 / np.maximum(size, 1e-9 * np.sqrt(np.mean(rows.Y**2)))[joint]
        J = np.column_stack([each * torque[:, np.newaxis], columns * k[joint][:, np.newaxis]]) * weight[:, np.newaxis]
        norms = column_norms(J)
        fit = least_squares(J / norms, error * weight, (*names, *others))
        step = fit.values / norms
        k, x = k + step[:n], x + step[n:]
        if np.all(np.abs(fit.values) <= _SETTLED * fit.std):
            break
    else:
        raise MethodError("The search for the gains did not settle; expected a heavier payload, or livelier motions.")
    if not np.all(k > 0):
        raise MethodError("A gain comes out negative; expected currents and positions of one sign: check them.")
    covariance = robust(J, J, error * weight, equations=rows.equations)
    return DriveGains(robot.names, 1 / k, covariance.std[:n] / k**2, covariance)
