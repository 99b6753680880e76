"""The EMPS records and loop, as every test of an estimator uses them."""

from pathlib import Path

import pytest

from jointid.models.controllers import Cascade
from jointid.records.columns import Column
from jointid.records.reading import read
from jointid.records.record import InjectionPoint, Record

GAIN = 35.15065188
CONTROLLER = Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=GAIN, limit=10.0)
COLUMNS = {"torque": Column("vir", unit="N", gain=GAIN), "reference": "qg", "motor_position": "qm"}


@pytest.fixture(scope="session")
def emps(emps_path: Path) -> Record:
    """The EMPS record with its motor position."""
    return read(emps_path, COLUMNS, time="t", name="EMPS", kind="prismatic")


@pytest.fixture(scope="session")
def emps_pulses(emps_path: Path) -> Record:
    """The EMPS record with pulses."""
    known = Column("pulses_N", unit="N", gain=35.636, at=InjectionPoint.AFTER_LIMIT, in_torque=True)
    path = emps_path.with_name("DATA_EMPS_PULSES.mat")
    return read(path, {**COLUMNS, "injected": known}, time="t", name="PULSES", kind="prismatic")
