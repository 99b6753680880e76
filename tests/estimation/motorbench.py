"""The two-motor bench: its record, and what both of its encoders say of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.optimize import minimize_scalar

from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.inverse_model import decimate_each, inverse_of_joint, motion_along
from jointid.models.joints import FlexibleJoint
from jointid.records.record import Channel, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import least_squares

PERIOD = 4e-4
JOINT = FlexibleJoint("revolute", torque_unit="A")
_ZERO = Parameter("zero_difference", "K dq", Quantity.FORCE)


@dataclass(frozen=True)
class Bench:
    """The signals, as logged but for the load encoder's sign."""

    measured: np.ndarray
    command: np.ndarray
    motor: np.ndarray
    load: np.ndarray

    @classmethod
    def read(cls, data_dir: Path) -> Bench:
        made = loadmat(data_dir / "motorbench" / "MultisineTypeA.mat", squeeze_me=True)
        return cls(made["iq_adx"], made["iq_refx"], made["theta_mx"], -made["theta_my"])

    def record(self, current: str = "measured") -> Record:
        """What a drive logs: one current and the motor's encoder."""
        return Record(
            torque=self.torque(current),
            tap=Tap(current),
            motor_position=Channel(self.motor, "rad", PERIOD),
            name="motorbench",
        )

    def torque(self, current: str) -> Channel:
        if current == "measured":
            return Channel(self.measured, "A", PERIOD, Timing.SAMPLED)
        return Channel(self.command, "A", PERIOD, Timing.HELD)

    def both_encoders(self, current: str, filtering: Filtering) -> dict[str, float]:
        """What IDIM finds with the load encoder: the difference of the encoders' zeros is one more column.

        The current's delay is the one that leaves least of both rows.
        """
        resolved = filtering.resolve(PERIOD, "flexible")

        def regression(delay: float) -> tuple[float, np.ndarray]:
            motion = motion_along([self.torque(current)], np.column_stack([self.motor, self.load]), resolved, [delay])
            names = (*(p.name for p in JOINT.parameters), _ZERO.name)
            W = motion.decimate_columns(inverse_of_joint(JOINT).columns(motion))
            Y = decimate_each(motion, list(motion.torque.T[:, :, np.newaxis]))[:, 0]
            values = least_squares(W, Y, names)
            return float(np.linalg.norm(Y - W @ values)), values

        best = minimize_scalar(
            lambda delay: regression(delay)[0], bounds=(-1e-3, 1.5e-3), method="bounded", options={"xatol": 1e-6}
        )
        names = [p.name for p in JOINT.parameters] + [_ZERO.name]
        return dict(zip(names, regression(best.x)[1], strict=True)) | {"delay": float(best.x)}
