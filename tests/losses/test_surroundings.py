"""The first second of a command, a campaign on a full disk, folders that take nothing, and a reader that is killed."""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from jointid.apps.cli import main
from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_table, write_table
from tests.losses.runs import BROKEN, COUNT, FIRST, SEED, contents, require_calm, run_copy, run_program
from tests.losses.test_full_disk import WRITERS
from tests.losses.test_signals import COMMANDS, OLD, is_whole

pytestmark = [pytest.mark.hostile, pytest.mark.skipif(sys.platform != "linux", reason="rights, and bounds on files")]

CAMPAIGN = """\
[sweep]
"filtering.cutoff" = [40.0, 50.0]
[fleet]
joint = "joint.toml"
"""


def drawn(every: dict[str, object], what: str, many: int = 3) -> list[str]:
    """Some of the names, other ones for each draw; all where many attacks are asked for."""
    names = sorted(every)
    return names if COUNT >= 20 else random.Random(f"{what}{SEED}").sample(names, many)


@pytest.mark.parametrize("command", drawn({**COMMANDS}, "first second"))
def test_the_first_second_of_a_command_leaves_nothing_cut_and_no_traceback(command: str, place: Path) -> None:
    words = " ".join(COMMANDS[command]).split()
    named, chance = [word for word in words if word.startswith("o.")], random.Random(f"first {command}{SEED}")
    for turn in range(max(COUNT // 4, 2)):
        kill = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[turn % 3]
        for name in named:
            (place / name).write_bytes(OLD)
        before = contents(place)
        with subprocess.Popen(
            [sys.executable, "-c", FIRST, *words], cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as process:
            assert process.stderr is not None
            assert process.stderr.read(1) == b"!"
            time.sleep(chance.uniform(0.0, 1.0))
            process.send_signal(kill)
            said = process.stderr.read().decode()
        assert "Traceback" not in said, said
        assert process.returncode in (0, -kill, 128 + kill), said
        found = contents(place)
        assert before.keys() <= found.keys()
        for name in found:
            kept = name not in named and name in before
            assert found[name] == before[name] if kept else found[name] == OLD or is_whole(name, found[name]), name


def test_a_campaign_on_a_full_disk_loses_nothing(place: Path) -> None:
    """What is finished at one size is there at the next, and on a free disk the same command goes on."""
    (place / "campaign.toml").write_text(CAMPAIGN)
    words, before = ["campaign", "run", "campaign.toml", "--out", "results", "--workers", "1", "-q"], contents(place)
    status, finished = ["campaign", "status", "results"], 0
    for turn in range(max(COUNT // 4, 3)):
        ended = run_program(*words, folder=place, most=40_000 * turn // max(COUNT // 4, 3))
        require_calm(ended, (2,))
        assert before.items() <= contents(place).items()
        seen = run_program(*status, folder=place)
        require_calm(seen, (0, 2))
        done = int(seen.said.split("done")[1].split()[0]) if "done" in seen.said else 0
        assert done >= finished
        finished = done
    ended = run_program(*words, folder=place)
    require_calm(ended, (0,))
    assert "2 cases done" in ended.said
    for target in ("r.html", "r.md", "e.csv"):
        option = {"r.html": "report results --html", "r.md": "report results --markdown"}
        ask = f"campaign {option.get(target, 'export results --out')} {target}".split()
        (place / target).write_bytes(OLD)
        ended = run_program(*ask, folder=place, most=100)
        require_calm(ended, (2,))
        assert (place / target).read_bytes() == OLD


def drop_power_over_rights() -> None:
    """Take from root the power to write where the rights say no."""
    libc, head = ctypes.CDLL(None), (ctypes.c_uint32 * 2)(0x20080522, 0)
    powers = (ctypes.c_uint32 * 6)()
    assert libc.capget(head, powers) == 0
    powers[0] &= ~(1 << 1)  # CAP_DAC_OVERRIDE
    assert libc.capset(head, powers) == 0


@pytest.mark.parametrize("writer", drawn({**WRITERS, "campaign": ""}, "read-only"))
def test_a_folder_that_takes_nothing_is_a_sentence(writer: str, place: Path) -> None:
    (place / "campaign.toml").write_text(CAMPAIGN)
    words = WRITERS.get(writer, "campaign run campaign.toml --out results -q").split()

    def program() -> None:
        drop_power_over_rights()
        sys.argv = ["jointid", *words]
        main()

    before = contents(place)
    place.chmod(0o555)
    try:
        ended = run_copy(program, folder=place)
    finally:
        place.chmod(0o755)
    assert ended.code != BROKEN, ended
    require_calm(ended, (2,))
    assert "permission denied" in ended.said
    assert contents(place) == before


def test_a_reader_that_is_killed_from_outside_is_a_sentence(tmp_path: Path) -> None:
    path, chance, over = tmp_path / "run.h5", random.Random(f"reader{SEED}"), threading.Event()
    write_table(path, Table({"t": np.arange(2e5) * 1e-3, "q": np.sin(np.arange(2e5))}))

    def kill_readers() -> None:
        while not over.wait(chance.uniform(0.0, 0.5)):
            children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
            for child in children:
                with contextlib.suppress(OSError):
                    if b"reader_program" in Path(f"/proc/{child}/cmdline").read_bytes():
                        os.kill(int(child), signal.SIGKILL)

    killer = threading.Thread(target=kill_readers)
    killer.start()
    sentences, wholes = list[str](), 0
    while wholes + len(sentences) < 4 * COUNT or not sentences:
        try:
            wholes += read_table(path).rows == 200_000
        except RecordError as error:
            sentences.append(str(error))
    over.set()
    killer.join()
    assert all("ended what reads it" in one for one in sentences)
