"""Outputs that take nothing, or cannot show what is printed; and a compiler's cache that is of no use."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from jointid.apps.cli import main
from jointid.apps.cli.streams import finish_outputs, prepare_outputs
from jointid.common.document import Document
from jointid.config import JointFile, loads
from jointid.controller_id.learned_controller import LearnedController, LearnedNumber
from jointid.controller_id.structures import Structure
from jointid.records.formats import Table, write_table
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.losses.runs import COUNT

pytestmark = [pytest.mark.hostile, pytest.mark.skipif(sys.platform == "win32", reason="/dev/full")]

PROGRAM = [sys.executable, "-c", "from jointid.apps.cli import main; main()"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("outputs")
    rows = np.arange(400)
    write_table(made / "table.csv", Table({"t": rows * 1e-3, "µ": np.sin(rows), "\u4e2d": np.cos(rows)}))
    return made


def shell(folder: Path, command: str, **variables: str) -> subprocess.CompletedProcess[bytes]:
    line = command.replace("jointid", f"{sys.executable} -c 'from jointid.apps.cli import main; main()'")
    environment = {**os.environ, "PYTHONUNBUFFERED": "", **variables}
    return subprocess.run(["bash", "-c", line], cwd=folder, env=environment, capture_output=True, check=False)


def shows(text: str, encoding: str) -> bool:
    return text.encode(encoding, "replace").decode(encoding) == text


def calm(ended: subprocess.CompletedProcess[bytes], code: int) -> str:
    said = ended.stderr.decode("utf-8", "replace")
    assert "Traceback" not in said, said
    assert "Exception ignored" not in said, said
    assert ended.returncode == code, said
    return said


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1", "utf-8"])
@pytest.mark.parametrize(
    "command", ["jointid data inspect table.csv", "jointid data inspect --help", "jointid nothing"]
)
def test_any_terminal_shows_what_it_can(folder: Path, command: str, encoding: str) -> None:
    code = 2 if "nothing" in command else 0
    for unbuffered in ("", "1"):
        ended = shell(folder, command, PYTHONIOENCODING=encoding, PYTHONUTF8="0", PYTHONUNBUFFERED=unbuffered)
        calm(ended, code)
        shown = ended.stdout.decode(encoding)
        if "table.csv" in command and encoding != "utf-8":
            assert "#" in shown
            assert "t is the time of 2 channels" in shown


JOINT = """
[joint]
name = "Größe 中"
kind = "prismatic"
[record]
file = "Größe-中.csv"
sample_time = 0.002
[record.channels]
torque = { column = "µ", unit = "N" }
reference = { column = "中", unit = "m" }
motor_position = { column = "q", unit = "m" }
[controller]
law = "cascade"
position_gain = 30.0
velocity_gain = 3000.0
limit = 1000.0
"""
COMMANDS = {
    "identify joint.toml --details": "Inertia",
    "validate joint.toml --estimate estimate.json": "was identified from",
    "compare estimate.json estimate.json": "ZZ",
    "diagnose methods joint.toml": "DIDIM",
    "diagnose joint.toml": "Loop and log",
    "diagnose intervals joint.toml": "ZZ",
    "tune joint.toml": "position_gain",
    "learn-controller joint.toml": "cascade",
    "reproduce": "from torque alone",
}
"""Commands whose answers say more than a table of a file, and a word of each."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A joint that is identified in no time, whose names few terminals can show."""
    folder, rng = tmp_path_factory.mktemp("small"), np.random.default_rng(1)
    (folder / "joint.toml").write_text(JOINT, encoding="utf-8")
    reference = trapezoids((0.05, 0.12), 1.5, 0.1, 0.002, duration=4.0)
    made = loads(JOINT)
    assert made.loop is not None
    record = simulated_record(
        made.loop, reference, {"inertia": 100.0, "viscous": 150.0, "coulomb": 20.0, "offset": 3.0}, sample_time=0.002,
        disturbance=2.0 * rng.standard_normal(reference.size),
    )  # fmt: skip
    assert record.torque is not None and record.motor_position is not None
    columns = {"µ": record.torque.values, "中": reference, "q": record.motor_position.values}
    write_table(folder / "Größe-中.csv", Table(columns))
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_every_answer_is_shown_on_any_terminal(
    command: str, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is made once, and printed on a terminal of each kind; what takes minutes is made up."""
    monkeypatch.chdir(small)
    monkeypatch.setattr(JointFile, "learn_controller", lambda file, *_: learned_in_no_time(file))
    monkeypatch.setattr("jointid.paper.reproduce.reproduce", lambda *_: reproduced_in_no_time())
    monkeypatch.setattr("jointid.paper.reproduce.report_reproduction", lambda *_: Document("±", ()))
    if not (small / "estimate.json").exists():
        call("identify joint.toml --json estimate.json -q")
    capsys.readouterr()
    call(f"{command} --out {tmp_path}" if command == "reproduce" else command)
    text = capsys.readouterr().out
    assert COMMANDS[command] in text
    for encoding in ("ascii", "cp1252", "latin-1", "utf-8"):
        terminal = io.BytesIO()
        with monkeypatch.context() as here:
            here.setattr(sys, "stdout", io.TextIOWrapper(terminal, encoding, newline=""))
            here.setattr(sys, "stderr", io.StringIO())
            prepare_outputs()
            print(text, end="")
            finish_outputs()
            shown = terminal.getvalue().decode(encoding)
        assert COMMANDS[command] in shown
        assert len(shown) >= len(text)
        assert (shown == text) is shows(text, encoding)


def call(command: str) -> None:
    with pytest.raises(SystemExit) as end:
        main(command.split())
    assert end.value.code == 0


def learned_in_no_time(file: JointFile) -> LearnedController:
    """As if the controller of a joint file had been learned: to 1 %."""
    assert file.controller is not None
    law: Any = file.controller
    numbers = tuple(
        LearnedNumber(name, value, 0.005 * value, "1/s", 0.99 * value, 1.01 * value)
        for name, value in (("position_gain", law.position_gain), ("velocity_gain", law.velocity_gain))
    )
    return LearnedController(
        law, Structure(), numbers, np.eye(2), (), (), (), 1.0, 0.01, 1.0, 1e-6, 100.0, np.zeros(1), "N", "m",
        "Größe-中", None,
    )  # fmt: skip


def reproduced_in_no_time() -> SimpleNamespace:
    """As much of a reproduction as the command prints."""
    found = SimpleNamespace(symbol="ZZ1", stderr=0.1, unit="kg")
    names = ("motor_inertia", "load_inertia", "stiffness")
    best = MagicMock(values=dict.fromkeys(names, 1.0), fit=SimpleNamespace(simulations=9))
    best.__getitem__.return_value = found
    axis = SimpleNamespace(truth=dict.fromkeys(names, 1.0))
    first = SimpleNamespace(didim=best, best=best, axis=axis)
    return SimpleNamespace(first=first, variations=lambda _: {"load_inertia": 10.0})


def test_an_output_that_is_full_is_said_and_the_files_are_written(folder: Path) -> None:
    said = calm(shell(folder, "jointid data inspect table.csv --json full.json > /dev/full"), 2)
    assert "The answer could not be printed (no space left on device)" in said
    assert (folder / "full.json").stat().st_size > 100
    calm(shell(folder, "jointid --help > /dev/full"), 2)
    calm(shell(folder, "jointid nothing 2> /dev/full"), 2)


def test_a_reader_that_goes_or_an_output_that_is_closed_disturbs_nothing(folder: Path) -> None:
    calm(shell(folder, "set -o pipefail; jointid data inspect table.csv --json gone.json | true"), 0)
    assert (folder / "gone.json").stat().st_size > 100
    calm(shell(folder, "jointid data inspect table.csv --json closed.json >&-"), 0)
    assert (folder / "closed.json").read_bytes() == (folder / "gone.json").read_bytes()
    calm(shell(folder, "jointid data inspect table.csv >&- 2>&-"), 0)


CACHED = """
import numpy as np
from jointid.common.compiled import carry
said = np.ones((1, 40, 8))
carry(np.full((2, 4), 0.5), said, 1)
print(repr(float(said.sum())))
"""


def compute(cache: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), **variables}
    return subprocess.run([sys.executable, "-c", CACHED], env=environment, capture_output=True, text=True, check=False)


DAMAGES = {
    "empty": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "zeros": lambda content: bytes(len(content)),
    "a changed byte of code": lambda content: content[:-200] + bytes([content[-200] ^ 1]) + content[-199:],
    "other words": lambda content: b"not a cache",
}


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache, and what was computed while it was made."""
    cache = tmp_path_factory.mktemp("cache")
    good = compute(cache)
    assert (good.returncode, good.stderr) == (0, "")
    return cache, good.stdout


# Each starts Python twice, and compiles: where few attacks are asked for, those that take a way of their own.
FEW = ((".nbi", "cut"), (".nbc", "cut"), (".nbc", "a changed byte of code"))


@pytest.mark.parametrize(
    ("suffix", "damage"),
    FEW if COUNT < 20 else [(suffix, damage) for suffix in (".nbi", ".nbc") for damage in DAMAGES],
)
def test_a_damaged_cache_is_compiled_again(
    suffix: str, damage: str, computed: tuple[Path, str], tmp_path: Path
) -> None:
    shutil.copytree(computed[0], tmp_path, dirs_exist_ok=True)
    (kept,) = list(tmp_path.rglob(f"*carry*{suffix}"))
    kept.write_bytes(DAMAGES[damage](kept.read_bytes()))
    ended = compute(tmp_path)
    assert (ended.returncode, ended.stdout) == (0, computed[1]), ended.stderr
    assert "Traceback" not in ended.stderr
    if (suffix, damage) != (".nbi", "a changed byte of code"):  # of the index some bytes may change, and it still fits
        assert ended.stderr.count("is damaged, and what is needed of it is compiled again") == 1, ended.stderr
        assert str(kept.parent) in ended.stderr
    again = compute(tmp_path)
    assert (again.stdout, again.stderr) == (computed[1], "")


def test_a_cache_that_cannot_be_written_is_done_without(computed: tuple[Path, str], tmp_path: Path) -> None:
    shutil.copytree(computed[0], tmp_path, dirs_exist_ok=True)
    (index,) = tmp_path.rglob("*carry*.nbi")
    index.unlink()
    index.mkdir()  # even root cannot write a file there
    ended = compute(tmp_path)
    assert (ended.returncode, ended.stdout) == (0, computed[1]), ended.stderr
    assert "cannot be written" in ended.stderr
    assert str(index.parent) in ended.stderr
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    assert compute(tmp_path / "file").stdout == computed[1]
