"""What no model is: each refusal once, by its type."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.parameters import adjust_parameters
from jointid.models.controllers import PD, Cascade, FirstOrder, Notch, SecondOrder, invert
from jointid.models.controllers.filters import DigitalFilter, MovingAverage
from jointid.models.controllers.laws import StateSpaceController
from jointid.models.controllers.sampled import INPUTS
from jointid.models.friction import Friction
from jointid.models.joints import RigidJoint
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.models.springs import Spring
from tests.models.robots.trees import chain

T = 1e-3
ARM = chain()


def law(period: float = T, **numbers: Any) -> object:
    return Cascade(**({"position_gain": 1.0, "velocity_gain": 1.0} | numbers)).law(period)


def pd(**numbers: Any) -> object:
    return PD(position_gain=1.0, derivative_gain=1.0, **numbers).law(T)


def turned_round(D: dict[str, float]) -> object:
    made = StateSpaceController(A=[[0.0]], B={"position": [1.0]}, C=[-5.0], D=D)
    return invert(made.law(T), np.zeros(5), np.zeros((5, INPUTS)), np.zeros(1))


def link(**change: Any) -> object:
    return replace(ARM, links=(ARM.links[0], replace(ARM.links[1], **change), ARM.links[2]))


def coupled(first: dict[str, float], second: dict[str, float]) -> object:
    joints = (replace(ARM.joints[0], coupling=first), replace(ARM.joints[1], coupling=second), ARM.joints[2])
    return replace(ARM, joints=joints)


REFUSED: dict[str, Callable[[], object]] = {
    "a notch beyond half the rate": lambda: Notch(80.0, 20.0).coefficients(0.01),
    "a notch without a bandwidth": lambda: Notch(80.0, 0.0),
    "an average of nothing": lambda: MovingAverage(0),
    "a negative time constant": lambda: FirstOrder(-1.0),
    "a filter without damping": lambda: SecondOrder(60.0, 0.0),
    "a denominator that starts with 0": lambda: DigitalFilter((1.0,), (0.0, 1.0)),
    "a negative position gain": lambda: law(position_gain=-1.0),
    "a gain of 0": lambda: law(gain=0.0),
    "a negative limit": lambda: law(limit=-2.0),
    "a negative delay": lambda: law(delay=-0.1),
    "a slower loop out of step": lambda: law(position_period=2.5e-3),
    "a slower loop of too many periods": lambda: law(position_period=65e-3),
    "a delay of too many periods": lambda: pd(reference_delay=0.5),
    "another reference velocity": lambda: pd(reference_velocity="derivative"),
    "a ratio of 0": lambda: pd(ratio=0.0),
    "a ratio that is no number": lambda: pd(ratio=np.nan),
    "matrices of other sizes": lambda: StateSpaceController(A=np.eye(2), B={"position": [1.0]}, C=[1.0, 0.0], D={}),
    "a law that sees the position later": lambda: turned_round({"reference": 5.0}),
    "a law with an unstable inverse": lambda: turned_round({"position": -1.0}),
    "an unknown friction": lambda: Friction("dahl"),
    "a friction without a name": lambda: Friction(None),  # type: ignore[arg-type]
    "a rise over the speed that winds up": lambda: Friction("asymmetric-stribeck-presliding"),
    "an unknown spring": lambda: Spring("quintic"),
    "a spring without a name": lambda: Spring(None),  # type: ignore[arg-type]
    "a joint that neither slides nor turns": lambda: RigidJoint("rotary"),  # type: ignore[arg-type]
    "a parameter that a model has not": lambda: adjust_parameters(
        RigidJoint("prismatic").parameters, {"stiffness": Parameter("stiffness", "K12", Quantity.STIFFNESS)}
    ),
    "a link before its parent": lambda: link(parent=1),
    "an axis of another length": lambda: link(axis=np.array([0.0, 0.0, 2.0])),
    "a rotation that mirrors": lambda: link(rotation=np.diag([1.0, 1.0, -1.0])),
    "an origin that is no number": lambda: link(origin=np.array([0.0, np.nan, 0.0])),
    "a ball joint": lambda: link(kind="ball"),
    "two links of one name": lambda: link(name=ARM.links[0].name),
    "more links than joints": lambda: Robot(ARM.links, ARM.joints[:2]),
    "a coupling to no joint": lambda: coupled({"d": 1.0}, {}),
    "motors that move one joint": lambda: coupled({"joint1": 1.0}, {"joint0": 1.0}),
    "a joint of negative friction": lambda: RobotJoint("b", viscous=-1.0),
    "an infinite offset": lambda: RobotJoint("b", offset=float("inf")),
    "a spring without a rotor": lambda: RobotJoint("b", spring=JointSpring(1e4)),
    "a rise without its speed": lambda: RobotJoint("b", stribeck_force=2.0),
}


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused(what: str) -> None:
    with pytest.raises(MethodError):
        REFUSED[what]()
