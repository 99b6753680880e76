"""A page to ask, and records to send it."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import uvicorn

import jointid as ji
from jointid.apps.web import folder as bound
from jointid.apps.web.routes import build_application, run
from tests.apps.web.asking import ADDRESS, TOKEN, WAIT, Asker, Served, TestClient

TRUTH = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "page"
    path.mkdir()
    return path


@pytest.fixture(autouse=True)
def bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small enough to be reached."""
    monkeypatch.setattr(bound, "UPLOAD", 2_000_000)


@pytest.fixture
def client(folder: Path) -> Iterator[TestClient]:
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as made:
        yield made


@pytest.fixture
def asker(client: TestClient) -> Asker:
    return Asker(client)


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A log of a rigid axis under a P-P law, position_gain 60, velocity_gain 500; its truth is TRUTH."""
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=60.0, velocity_gain=500.0))
    reference = ji.excitation.trapezoids([0.1, 0.3], 2.0, 0.2, 1e-3, 0.1, 8.0)
    record = ji.simulated_record(loop, reference, TRUTH, sample_time=1e-3, encoder_step=1e-7)
    path = tmp_path_factory.mktemp("log") / "log.csv"
    ji.write(record, path)
    return path.read_bytes()


@pytest.fixture
def served(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """The page on a port of this machine."""
    servers: list[uvicorn.Server] = []
    begin = uvicorn.Server.run

    def begin_and_note(server: uvicorn.Server, sockets: list[socket.socket]) -> None:
        servers.append(server)
        begin(server, sockets)

    monkeypatch.setattr(uvicorn.Server, "run", begin_and_note)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=run, args=(build_application(folder, TOKEN), listening))
        thread.start()
        made = Served(listening.getsockname()[1])
        assert made.ask("GET", "/")[0] == 200  # it has begun
        yield made
        servers[0].should_exit = True
        thread.join(WAIT)
        assert not thread.is_alive()
