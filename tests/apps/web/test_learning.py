"""A controller that the page learns: the one that `jointid learn-controller` learns from the same files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointid.apps.cli import main
from jointid.apps.web import worker
from jointid.apps.web.fields import LEARN
from jointid.apps.web.form import make_order
from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.config import load
from jointid.controller_id.learned_controller import LearnedController
from jointid.controller_id.structures import Structure
from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.geared import RATE, RIGID
from tests.learned_once import find_law

CONSTANT = 0.5  # N m/A
LAW = Cascade(position_gain=25.0, velocity_gain=0.04, gain=CONSTANT)
DRAFT = {
    "joint.kind": "revolute",
    "transmission.ratio": "10",
    "record.time": "t",
    "record.channels.torque.column": "i",
    "record.channels.reference.column": "r",
    "record.channels.reference.unit@revolute": "rad",
    "record.channels.motor_position.column": "q",
    "record.channels.motor_position.unit@revolute": "rad",
    "controller.law": LEARN,
}
IN_AMPERE = {"record.channels.torque.unit@revolute": "A", "joint.torque_constant": f"{CONSTANT}"}
IN_NEWTON_METRES = {"record.channels.torque.unit@revolute": "N m", "controller.gain": f"{CONSTANT}"}


@pytest.fixture(scope="module")
def axis() -> FloatArray:
    """A geared axis as its motor sees it: time, torque, commanded and measured position."""
    reference = trapezoids((20.0, 40.0), 400.0, 40.0, RATE, duration=2.0)
    noise = 0.002 * np.random.default_rng(2).standard_normal(reference.size)
    loop = ClosedLoop(RigidJoint("revolute"), LAW)
    record = simulated_record(loop, reference, RIGID, sample_time=RATE, torque_noise=noise, encoder_step=1e-5)
    assert record.torque is not None
    assert record.motor_position is not None
    time = RATE * np.arange(reference.size)
    return np.column_stack([time, record.torque.values, reference, record.motor_position.values])


@pytest.fixture(params=[IN_AMPERE, IN_NEWTON_METRES], ids=["torque constant", "gain"])
def folder(request: pytest.FixtureRequest, axis: FloatArray, tmp_path: Path) -> Path:
    """A folder with the log and the joint file that the page writes beside it."""
    logged = axis / np.array([1.0, CONSTANT if request.param is IN_AMPERE else 1.0, 1.0, 1.0])
    np.savetxt(tmp_path / "log.csv", logged, delimiter=",", header="t,i,r,q", comments="")
    text, learn = make_order(DRAFT | request.param, "log.csv")
    assert learn
    (tmp_path / "joint.toml").write_text(text, encoding="utf-8")
    return tmp_path


def learned_by_both(folder: Path) -> tuple[Any, Any]:
    """Return the controllers that the page and the command put into the joint file."""
    with pytest.raises(SystemExit) as end:
        main(["learn-controller", str(folder / "joint.toml"), "--write", str(folder / "command.toml"), "-q"])
    assert end.value.code == 0
    worker.learn(folder, {"file": "log.csv"})
    return load(folder / "joint.toml").controller, load(folder / "command.toml").controller


def test_the_learner_is_told_the_same_gain_by_both(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []

    def give_up(record: Record, *, gain: float, **_: object) -> LearnedController:
        told.append(gain)
        raise MethodError("No law.")

    monkeypatch.setattr("jointid.controller_id.learn.learn_controller", give_up)
    with pytest.raises(SystemExit):
        main(["learn-controller", str(folder / "joint.toml"), "-q"])
    with pytest.raises(MethodError):
        worker.learn(folder, {"file": "log.csv"})
    assert told == [10 * CONSTANT] * 2


@pytest.mark.parametrize("folder", [IN_AMPERE], indirect=True, ids=["torque constant"])
def test_behind_a_gear_the_page_learns_what_the_command_does(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    near = {"position_gain": 0.9 * LAW.position_gain, "velocity_gain": 0.9 * LAW.velocity_gain}
    find_law(monkeypatch, Structure(), near)
    page, command = learned_by_both(folder)
    assert page == command
    assert page.gain == pytest.approx(10 * CONSTANT)
    assert page.velocity_gain == pytest.approx(10 * LAW.velocity_gain, rel=0.03)  # the motor's A per rad/s of the load
    assert page.position_gain == pytest.approx(LAW.position_gain, rel=0.03)
