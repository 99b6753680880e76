"""What an identification knew is printed where it is interrupted, a reason is told once, and how signals end it."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli import main
from jointid.config import loads

JOINT = """
[joint]
kind = "revolute"
model = "MODEL"
[record]
file = "run.csv"
time = "t"
[record.channels]
torque = { column = "torque", unit = "N m" }
reference = { column = "reference", unit = "rad" }
[controller]
law = "cascade"
position_gain = 40.0
velocity_gain = 0.9
"""
RIGID = JOINT.replace("MODEL", "rigid")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An axis of 0.02 kg m2, its record and its joint file."""
    reference = ji.excitation.trapezoids([2.0, 5.0], 60.0, 2.0, 1e-3, rest=0.1, duration=5.0)
    file = loads(RIGID)
    assert file.loop is not None
    truth = {"inertia": 0.02, "viscous": 0.05, "coulomb": 0.1, "offset": 0.0}
    noise = 0.01 * np.random.default_rng(3).standard_normal(reference.size)
    record = ji.simulated_record(file.loop, reference, truth, sample_time=1e-3, torque_noise=noise)
    file.write(record, tmp_path / "run.csv")
    (tmp_path / "joint.toml").write_text(RIGID, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def interrupt(*_: Any, **__: Any) -> Any:
    raise KeyboardInterrupt


def identify(*words: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["identify", *words])
    assert isinstance(end.value.code, int)
    return end.value.code


def test_an_estimate_is_printed_whose_checks_are_interrupted(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("jointid.diagnostics.identify.run_checks", interrupt)
    assert identify("joint.toml", "-q") == 130
    said = capsys.readouterr().out
    assert re.match(r"Inertia 0\.0[12]\d+ ± ", said)
    assert "which was not checked" in " ".join(said.split())


PROGRAM = """
import signal, sys
from pathlib import Path
from jointid.apps.cli import main
from jointid.common.files import beside

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it

def end(*_, **__):
    with beside(Path("o.json")) as fresh:
        fresh.write_text("half")
        signal.raise_signal(int(sys.argv[2]))

if sys.argv[1] == "loaded":
    from jointid.apps.cli import app
    app.app = end
else:
    sys.addaudithook(lambda event, words: words[:1] == ("jointid.apps.cli.app",) and signal.raise_signal(signal.SIGINT))
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no process can send itself these signals")
@pytest.mark.parametrize(
    ("when", "number", "code"),
    [("loading", signal.SIGINT, -2), ("loaded", signal.SIGINT, 130), ("loaded", signal.SIGTERM, 143)],
)
def test_a_signal_ends_the_program_without_a_traceback(
    when: str, number: signal.Signals, code: int, tmp_path: Path
) -> None:
    words = [sys.executable, "-c", PROGRAM, when, str(int(number))]
    ran = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == code and "Traceback" not in ran.stderr
    assert number == signal.SIGTERM or list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="a shell")
@pytest.mark.parametrize("ending", ["| true", "2>&1 | true", ">&-"])
def test_a_reader_that_has_gone_costs_no_file(ending: str, tmp_path: Path) -> None:
    rows = "".join(f"{0.001 * i:.3f},{i % 7}\n" for i in range(400))
    (tmp_path / "table.csv").write_text(f"t,i\n{rows}", encoding="utf-8")
    program = f"{sys.executable} -c 'from jointid.apps.cli import main; main()'"
    line = f"set -o pipefail; {program} inspect table.csv --json o.json {ending}"
    ended = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert (tmp_path / "o.json").read_bytes().rstrip().endswith(b"}")
