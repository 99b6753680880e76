"""What all tests share: the real records, and how property tests run."""

import os
import shlex
import sys
from pathlib import Path

# Matrices here are thousands of rows by ten columns: a second thread of the linear algebra only waits for the first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from tests.drawing import DRAW, SHARES, is_drawn

# Without bytecode files, every worker compiles all tests and libraries again, which takes 12 s of processor, and every
# child process its libraries.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

IN_CI = os.environ.get("CI") == "true"

# Shared machines are slow now and then, and a build that fails must fail again when it is repeated.
settings.register_profile("jointid", deadline=None, derandomize=IN_CI)
settings.load_profile("jointid")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels once, before workers start that would wait for each other."""
    options = session.config.option
    alone = hasattr(session.config, "workerinput") or not getattr(options, "numprocesses", None)
    if not alone and not options.collectonly:
        from jointid.simulation.warm_up import main

        main()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests that `JOINTID_DRAW` does not draw; one of several layers is drawn in the last of them."""

    def drawn(item: pytest.Item) -> bool:
        layers = [layer for layer in SHARES if item.get_closest_marker(layer)]
        return not layers or is_drawn(layers[-1], item.nodeid)

    config.hook.pytest_deselected(items=[item for item in items if not drawn(item)])
    items[:] = filter(drawn, items)


def pytest_terminal_summary(terminalreporter: "pytest.TerminalReporter", config: pytest.Config) -> None:
    """Print the draw and the command that repeats it."""
    if DRAW:
        shares = ", ".join(f"{share:.0%} of {layer}" for layer, share in SHARES.items())
        command = shlex.join(["pytest", *config.invocation_params.args])
        terminalreporter.write_line(f"drawn: {shares}; again by: JOINTID_DRAW={shlex.quote(DRAW)} {command}")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of the real records: where JOINTID_DATA points, or else ../shared/data from the root."""
    named = os.environ.get("JOINTID_DATA")
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    places = [Path(named), beside] if named else [beside]
    for place in places:
        if place.is_dir():
            return place
    reason = f"the real records are in none of {', '.join(map(str, places))}; set JOINTID_DATA to their folder"
    if IN_CI:
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def emps_path(data_dir: Path) -> Path:
    """The public EMPS record: vir [V], qg and qm [m], t [s], at 1 kHz."""
    return data_dir / "emps" / "DATA_EMPS.mat"
