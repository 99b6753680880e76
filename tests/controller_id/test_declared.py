"""What is kept of a declared controller that stands on the other side of a gear than the learned one."""

import pytest

from jointid.config import Axis, File
from jointid.controller_id.learn import fill_from_declaration
from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import Cascade, Controller
from jointid.models.joints import RigidJoint

MOTOR = Cascade(position_gain=1.0, velocity_gain=1.0, gain=0.5, ratio=10.0, limit=40.0)  # 40 A, 20 N m, 200 on the load


@pytest.mark.parametrize(
    ("declared", "gain"),
    [(MOTOR, 5.0), (Cascade(position_gain=1.0, velocity_gain=1.0, ratio=10.0), 1.0), (None, 1.0)],
)
def test_a_unit_of_the_drive_is_the_same_on_the_load(declared: Controller | None, gain: float) -> None:
    axis = Axis(name=None, joint=RigidJoint("prismatic"), columns={}, controller=declared)
    assert File(axes=(axis,), method=DIDIM()).learn_settings["gain"] == gain


def test_a_declared_limit_stays_the_torque_that_it_is() -> None:
    amperes, _ = fill_from_declaration(Cascade(position_gain=1.0, velocity_gain=1.0, gain=5.0), MOTOR)
    newtons, _ = fill_from_declaration(Cascade(position_gain=1.0, velocity_gain=1.0), MOTOR)
    assert (amperes.limit, newtons.limit) == (40.0, 200.0)  # type: ignore[attr-defined]
