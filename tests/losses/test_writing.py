"""Kills at random moments, and a disk that is full: what was there stays, and nothing is cut."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jointid.records.formats import Table, write_table
from tests.losses.runs import COUNT, SEED, contents, require_calm, run_program
from tests.rigid_axis import run

pytestmark = [pytest.mark.hostile, pytest.mark.skipif(sys.platform != "linux", reason="copies of a process")]

OLD = b"what was there"
WRITERS = {
    "inspect": "inspect record.csv --json o.json",
    "identify": "identify joint.toml -q --json o.json",
    "simulate .csv": "simulate joint.toml --identified -q --out o.csv",
    "simulate .mat": "simulate joint.toml --identified -q --out o.mat",
    "simulate .npy": "simulate joint.toml --identified -q --out o.npy",
    "simulate .parquet": "simulate joint.toml --identified -q --out o.parquet",
    "export": "export joint.toml --out o.toml",
    "report": "report joint.toml -q --no-profiles --no-tuning --html o.html",
}
LONGEST = 6.0  # seconds in which a command is attacked
ENDS = {".png": b"IEND\xaeB`\x82", ".html": b"</html>", ".toml": b"\n", ".csv": b"\n",
        ".parquet": b"PAR1"}  # fmt: skip


def is_whole(name: str, content: bytes) -> bool:
    suffix = Path(name).suffix
    if suffix == ".json":
        return bool(json.loads(content))
    return content.rstrip().endswith(ENDS.get(suffix, b"").rstrip())


@pytest.mark.parametrize("writer", ["inspect", "identify", "simulate .csv", "report"])
def test_nothing_is_lost_or_cut_at_any_moment(writer: str, place: Path) -> None:
    words = WRITERS[writer].split()
    named = [word for word in words if word.startswith("o.")]
    chance, seconds = random.Random(writer + SEED), LONGEST
    for turn in range(COUNT):
        for name in named:
            (place / name).write_bytes(OLD)
        before = contents(place)
        kill = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)[turn % 3]
        ended = run_program(*words, folder=place, kill=kill, after=chance.uniform(0.0, seconds))
        seconds = min(seconds, 1.1 * ended.seconds) if ended.code == 0 else seconds
        require_calm(ended, (0, -kill, 128 + kill))
        found = contents(place)
        left = {name for name in found if ".jointid-" in name}
        assert not left or kill != signal.SIGINT, left
        assert found.keys() - left == before.keys()
        for name in before:
            assert found[name] == before[name] or (name in named and is_whole(name, found[name])), name
        for room in place.rglob(".jointid-*"):
            room.unlink()


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk_keeps_the_old_result_whole(writer: str, place: Path) -> None:
    words = WRITERS[writer].split()
    done = run_program(*words, folder=place)
    assert done.code == 0, done
    names = [word for word in words if word.startswith("o.")]
    most = max(len(contents(place)[name]) for name in names)
    for name in names:
        (place / name).write_bytes(OLD)
    before = contents(place)
    sizes = max(COUNT // 4, 3)
    # To the last byte: C keeps the end of a short file to itself, and NumPy does not ask how that went.
    for size in (*(most * turn // sizes for turn in range(sizes)), most - 1):
        ended = run_program(*words, folder=place, most=size)
        require_calm(ended, (2,))
        assert "cannot be written" in ended.said, ended
        assert contents(place) == before, size


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_any_terminal_shows_what_it_can(encoding: str, place: Path) -> None:
    program = [sys.executable, "-c", "from jointid.apps.cli import main; main()", "inspect", "table.csv"]
    shown = {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"} | os.environ
    ended = subprocess.run(program, cwd=place, env=shown, capture_output=True, check=False)
    assert ended.returncode == 0 and b"3 channels" in ended.stdout


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the demo's record, joint file and estimate, another format of the record, and a small table."""
    import scipy.io  # noqa: F401 - all are loaded here, once, and not in every copy

    from jointid.simulation.warm_up import warm_up

    folder = tmp_path_factory.mktemp("demo")
    assert run("demo", folder, "-q") == 0
    (folder / "torque.png").unlink()
    record = folder / "record.csv"  # a third of it, to have more moments in the same time
    record.write_text("".join(record.read_text(encoding="utf-8").splitlines(keepends=True)[:8001]), encoding="utf-8")
    warm_up()
    assert run("identify", folder / "joint.toml", "-q") == 0  # and no command searches for it again
    rows = np.arange(400)
    write_table(folder / "table.csv", Table({"t": rows * 1e-3, "i": np.sin(rows), "q": np.cos(rows)}))
    return folder


@pytest.fixture
def place(demo: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    shutil.copytree(demo, tmp_path / "place")
    return tmp_path / "place"
