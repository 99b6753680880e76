"""A page to ask, and records to send it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from jointid.apps.web.application import build_application
from jointid.apps.web.folder import Limits
from jointid.models.controllers import Cascade
from jointid.models.joints import RigidJoint
from jointid.records.signals.excitation import trapezoids
from jointid.records.writing import write
from jointid.simulation.loop_input import ClosedLoop
from jointid.simulation.synthesis import simulated_record
from tests.apps.web.asking import ADDRESS, TOKEN, Asker
from tests.apps.web.testclient import TestClient

TRUTH = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "page"
    path.mkdir()
    return path


@pytest.fixture
def limits() -> Limits:
    """Small enough to be reached."""
    return Limits(upload=2_000_000, joint_file=20_000)


@pytest.fixture
def client(folder: Path, limits: Limits) -> Iterator[TestClient]:
    with TestClient(build_application(folder, TOKEN, limits=limits), base_url=ADDRESS) as made:
        yield made


@pytest.fixture
def asker(client: TestClient) -> Asker:
    return Asker(client)


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A log of a rigid axis under a P-P law, kp 60, kv 500; its truth is TRUTH."""
    loop = ClosedLoop(RigidJoint(), Cascade(kp=60.0, kv=500.0))
    reference = trapezoids([0.1, 0.3], 2.0, 0.2, 1e-3, 0.1, 8.0)
    record = simulated_record(loop, reference, TRUTH, sample_time=1e-3, encoder_step=1e-7)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    write(record, path)
    return path.read_bytes()
