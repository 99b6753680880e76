"""What is not simulated: each refusal once, by its type, and each number that no joint may have, by the outcome."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointid.common.errors import MethodError, RecordError
from jointid.models.controllers import PD, Cascade
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.robots.robot import JointSpring, RobotJoint, RobotLoop
from jointid.models.springs import SPRINGS, Spring
from jointid.records.record import Channel, Injection, Record, Tap
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome, require_success
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate, simulated_record
from tests.plants import prismatic, with_law
from tests.robots_plants import two
from tests.simulation.differences import sensitivities

T = 1e-3
VALUES = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
LAW = Cascade(position_gain=60.0, velocity_gain=6e3)
WILD = Cascade(position_gain=2e3, velocity_gain=1e6, delay=3e-3)
LINE, ARM = ClosedLoop(RigidJoint("prismatic"), LAW), two().loop()


def record(samples: int = 500, unit: str = "m", **more: Any) -> Record:
    return Record(reference=Channel(np.linspace(0.0, 0.1, samples), unit, T), **more)


def prepare_at(period: float) -> object:
    return prepare(replace(LINE, controller=replace(LAW, period=period)), record())


def slopes(name: str, law: Cascade = LAW) -> object:
    loop = replace(LINE, controller=law)
    return sensitivities(loop, prepare(loop, record()), VALUES, [name])


def simulated(**more: Any) -> Record:
    return simulated_record(LINE, np.zeros(500), VALUES, sample_time=T, **more)


OF_RECORDS: dict[str, Callable[[], object]] = {
    "a record of fewer than ten periods": lambda: prepare(LINE, record(5)),
    "a period far below the log's": lambda: prepare_at(1e-9),
    "a period as long as the record": lambda: prepare_at(1.0),
    "a period that does not divide": lambda: prepare_at(7e-4),
    "a record in other units": lambda: prepare(LINE, record(unit="rad")),
    "an injected signal that a measured torque lacks": lambda: record(
        tap=Tap.MEASURED, injected=Injection(Channel(np.zeros(500), "N", T), in_torque=False)
    ),
}
REFUSED: dict[str, Callable[[], object]] = {
    "a parameter without a value": lambda: simulate(LINE, record(), {"inertia": 1.0}),
    "a disturbance of another length": lambda: simulated(disturbance=np.zeros(499)),
    "a noise of another length": lambda: simulated(torque_noise=np.zeros(499)),
    "what did not finish": lambda: require_success(simulate(replace(LINE, controller=WILD), record(), VALUES)),
    "a derivative by the period": lambda: slopes("period"),
    "a derivative by an integral that is not there": lambda: slopes("integral_gain"),
    "a derivative by a number of another filter": lambda: slopes("velocity_filter.depth"),
    "a regressor of a spring with a gap": lambda: FlexibleJoint("prismatic", spring=Spring("backlash")).regressor(None),  # type: ignore[arg-type]
    "a robot from one record": lambda: simulate(ARM, record(unit="rad")),  # type: ignore[call-overload]
    "a joint from several records": lambda: simulate(LINE, (record(),), {}),  # type: ignore[call-overload]
    "a robot with too few controllers": lambda: RobotLoop(ARM.robot, ARM.controllers[:1]),
    "a robot with too few records": lambda: simulate(ARM, two().records(1.0)[:1]),
    "a robot that begins as a joint": lambda: simulate(ARM, two().records(1.0), initial=Initial(0.1)),
    "records of other lengths": lambda: simulate(ARM, (two().records(1.0)[0], two().records(0.5)[1])),
    "controllers without a common clock": lambda: simulate(
        RobotLoop(ARM.robot, tuple(PD(position_gain=9.0, derivative_gain=1.0, period=T / n) for n in (18, 19))),
        two().records(1.0),
    ),
    "a joint that lacks a number of its law": lambda: RobotJoint("one", 0.3, friction=FRICTIONS["presliding"]),
    "a joint with a number of no law": lambda: RobotJoint("one", 0.3, spring=JointSpring(9e2), numbers={"gap": 0.1}),
    "a link that swings in itself": lambda: JointSpring(900.0, law=SPRINGS["elastic-load"]),
}


@pytest.mark.parametrize("what", [*OF_RECORDS, *REFUSED])
def test_a_refusal_has_its_type(what: str) -> None:
    with pytest.raises(RecordError if what in OF_RECORDS else MethodError):
        (OF_RECORDS | REFUSED)[what]()


@pytest.mark.parametrize(
    ("friction", "spring", "wrong"),
    [
        ("symmetric", "three-piece", {"torque_1": 2e3}),
        ("symmetric", "three-piece", {"stiffness": 0.0}),
        ("symmetric", "three-piece", {"stiffness_3": -1.0}),
        ("symmetric", "hysteretic", {"hysteresis_torque": 0.0}),
        ("symmetric", "elastic-load", {"swinging_share": 1.0}),
        ("symmetric", "linear", {"stiffness": -1.0}),
        ("stribeck", "linear", {"motor_stribeck_speed": 0.0}),
        ("presliding", "linear", {"load_presliding_distance": -1.0}),
        ("drifting", "linear", {"load_coulomb_drift": -1e3}),
        ("drifting", "linear", {"harmonic_1_sine": float("nan")}),
    ],
)
def test_numbers_that_no_joint_has_are_not_simulated(friction: str, spring: str, wrong: dict[str, float]) -> None:
    case = prismatic(1)
    loop, values = with_law(case, friction, spring, *(["ripple"] if friction == "drifting" else []))
    experiment = prepare(loop, case.clean)
    assert simulate(loop, experiment, values).outcome is Outcome.FINISHED
    assert simulate(loop, experiment, values | wrong).outcome is Outcome.INVALID
