"""What is refused before anything is identified, each once, by the type of its exception."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.models.friction import Friction
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.paper.twin import twin
from tests.estimation.robots.twin import arm, records_of
from tests.estimation.test_recovery import LOOP, MOVING, TRUTH, T, simulated_record

RECORD = simulated_record(LOOP, MOVING, TRUTH, sample_time=T)
RIGID, FLEXIBLE = ji.RigidJoint("prismatic"), ji.FlexibleJoint("prismatic")
ON_LOAD = replace(FLEXIBLE, ripple=PositionHarmonics(0.02, side="load"))
ASYMMETRIC = ji.RigidJoint("prismatic", friction=Friction("asymmetric"))
AXIS, ARM = twin(noise="none"), arm(2)
VERBS: tuple[Any, ...] = (ji.identify, ji.diagnose, ji.write, ji.validate, ji.intervals, ji.simulate, ji.Report.of)


def run_away() -> None:
    """Instruments of a loop that its gain makes unstable."""
    fast = replace(AXIS.loop.controller, velocity_gain=1e4, limit=np.inf)  # type: ignore[type-var]
    ji.identify(AXIS.record, ji.ClosedLoop(AXIS.loop.joint, fast), ji.IDIM("iv"))


def freeing(name: str) -> None:
    """A number that is to be identified with the joint, of a law without a limit."""
    unlimited = replace(LOOP, controller=replace(LOOP.controller, limit=np.inf))  # type: ignore[type-var]
    ji.identify(RECORD, unlimited, ji.DIDIM(free=(name,)))


def resting() -> None:
    """A reference that asks for no motion."""
    still = replace(RECORD.reference, values=np.zeros(len(RECORD.reference)))
    ji.identify(replace(RECORD.without("motor_position"), reference=still), LOOP)


@pytest.mark.parametrize(
    ("refused", "by"),
    [
        # channels
        (lambda: ji.identify(RECORD.without("motor_position"), RIGID), ji.RecordError),
        (lambda: ji.identify(RECORD.without("reference"), LOOP, ji.DIDIM()), ji.RecordError),
        (lambda: ji.identify(AXIS.record.without("load_position"), AXIS.loop, ji.IDIM()), ji.RecordError),
        (lambda: ji.identify(AXIS.record.without("reference"), AXIS.loop, ji.IDIM("iv")), ji.RecordError),
        (lambda: ji.identify(RECORD.without("motor_position"), RIGID, ji.DriveSideFit()), ji.RecordError),
        (resting, ji.RecordError),
        # parameters
        (lambda: ji.identify(RECORD, ASYMMETRIC, parameters={"offset": RIGID.parameters[3]}), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, parameters={p.name: p.fix(1.0) for p in RIGID.parameters}), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, parameters={"mass": RIGID.parameters[0]}), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, parameters={"inertia": 30.0}), ji.MethodError),  # type: ignore[dict-item]
        # filters
        (lambda: ji.identify(RECORD, LOOP, filtering=ji.Filtering(cutoff=60.0, decimation=12)), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, filtering=ji.Filtering(cutoff=600.0)), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, filtering=ji.Filtering(cutoff=1e-9)), ji.MethodError),
        (lambda: ji.identify(RECORD, RIGID, filtering=ji.Filtering(position_cutoff=1e-4)), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, filtering=ji.Filtering(borders=(5000, 5000))), ji.RecordError),
        # settings of methods
        (lambda: ji.identify(RECORD, RIGID, ji.DIDIM()), ji.MethodError),
        (lambda: ji.identify(RECORD, replace(LOOP, joint=FLEXIBLE), ji.DIDIM(evaluations=9)), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, ji.DIDIM(frequency=30.0)), ji.MethodError),
        (lambda: ji.identify(AXIS.record, ON_LOAD, ji.DriveSideFit()), ji.MethodError),
        (lambda: ji.DIDIM(tolerance=0.0), ji.MethodError),
        (lambda: ji.DIDIM(outputs=("torque", "motor_position")), ji.MethodError),
        # What one record cannot tell, what the law has not, and numbers from which no search begins.
        *((partial(freeing, n), ji.MethodError) for n in ("drive_gain", "derivative_gain", "integral_gain", "limit")),
        (lambda: ji.IDIM("best"), ji.MethodError),  # type: ignore[arg-type]
        (lambda: ji.identify(RECORD, RIGID, ji.IDIM("iv")), ji.MethodError),
        (run_away, ji.MethodError),
        # forces
        (lambda: PositionHarmonics(-0.1), ji.MethodError),
        (lambda: ji.RigidJoint("prismatic", gravity=Gravity("link")), ji.MethodError),
        (lambda: replace(ASYMMETRIC, gravity=Gravity("constant")), ji.MethodError),
        (lambda: Gravity("link", angle=0.0), ji.MethodError),
        (lambda: Counterbalance(rate=float("nan")), ji.MethodError),
        # several records
        (lambda: ji.identify([RECORD, RECORD], RIGID), ji.MethodError),
        (lambda: ji.identify([], RIGID), ji.MethodError),
        (lambda: ji.identify([RECORD], RIGID, several={"junk": []}), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, several={}), ji.MethodError),
        (lambda: ji.identify([RECORD, RECORD], LOOP, several={"added_inertia": 1.0}), ji.MethodError),
        (lambda: ji.identify([RECORD, RECORD], LOOP, several={"free": "drive_gain"}), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, windows=0.0), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, windows=60.0), ji.MethodError),  # two windows or more
        (lambda: ji.identify(RECORD, LOOP, ji.IDIM(), windows=2.0), ji.MethodError),
        (lambda: ji.identify(RECORD, LOOP, ji.DriveSideFit(), windows=2.0), ji.MethodError),
        (lambda: ji.design(LOOP, RECORD, values={}, noise={"foo": 0.2}), ji.MethodError),
        (lambda: ji.design(LOOP, RECORD, values={}, noise=0.2), ji.MethodError),  # type: ignore[arg-type]
        *((partial(*call, LOOP), ji.MethodError) for call in product(VERBS, ("x.csv", {}, [LOOP], None))),
        (lambda: ji.learn_controller([RECORD]), ji.MethodError),  # type: ignore[arg-type]
        (lambda: ji.identify(RECORD, "joint.toml"), ji.MethodError),  # type: ignore[arg-type]
        (lambda: ji.design(LOOP, RECORD, motion="log.csv"), ji.MethodError),  # type: ignore[arg-type]
        (lambda: ji.diagnose(torque=[1.0], model=LOOP), ji.MethodError),  # type: ignore[call-arg]
        (lambda: ji.Record(torque=[1.0]), ji.RecordError),  # type: ignore[arg-type]
        (lambda: ji.identify(ji.Record(), LOOP, windows=4.0), ji.RecordError),
        # robots
        (lambda: ji.identify(records_of(ARM, 1)[0], ARM), ji.MethodError),
        (lambda: ji.identify(records_of(ARM, 1)[:1], ARM), ji.RecordError),
        (lambda: ji.identify(records_of(ARM, 1), ARM, ji.IDIM("iv")), ji.MethodError),
        (lambda: ji.robots.identify_payload(LOOP, [RECORD], [RECORD]), ji.MethodError),  # type: ignore[arg-type]
    ],
)
def test_it_is_refused(refused: Callable[[], object], by: type[Exception]) -> None:
    with pytest.raises(by):
        refused()
