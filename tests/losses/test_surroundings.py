"""The first second of a command, a campaign on a full disk, folders that take nothing, and a reader that is killed."""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from jointid.apps.cli import main
from jointid.campaigns.cases import Outcome, Row
from jointid.campaigns.store import open_database
from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_table, write_table
from tests.losses.runs import BROKEN, COUNT, FIRST, SEED, contents, note, require_calm, run_copy, run_program
from tests.losses.test_full_disk import WRITERS
from tests.losses.test_signals import COMMANDS, OLD, is_whole

pytestmark = [pytest.mark.hostile, pytest.mark.skipif(sys.platform != "linux", reason="rights, and bounds on files")]

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
CAMPAIGN = """\
[sweep]
"filtering.cutoff" = [40.0, 50.0]
[fleet]
joint = "joint.toml"
"""


STARTED = {
    **COMMANDS,
    "examine": ("examine joint.toml -q", "--json", "o.json"),
    "doctor": ("doctor joint.toml", "--json", "o.json"),
    "serve": ("serve --port 0 --folder made",),
    "payload": ("payload robot/robot.toml --with record.csv -q", "--json", "o.json"),
    "design": ("design joint.toml -q --search-time 1", "--out", "pages", "--json", "o.json"),
    **{f"diagnose {what}": (f"diagnose {what} joint.toml -q", "--json", "o.json") for what in ("springs", "friction")},
    "diagnose intervals": ("diagnose intervals joint.toml -q",),
    "campaign run": ("campaign run campaign.toml --out made --workers 1 -q",),
    "campaign work": ("campaign work campaign.toml --shard 1/1 --out made -q",),
    "campaign status": ("campaign status results",),
    "campaign report": ("campaign report results", "--html", "o.html", "--csv", "o.csv"),
    "campaign export": ("campaign export results", "--out", "o.csv"),
}
"""Every command, with what it writes."""
FOLDERS = ("made", "results")  # of the page or a campaign, which tests of their own look into


def drawn(every: dict[str, object], what: str, many: int = 3) -> list[str]:
    """Some of the names, other ones for each draw; all where many attacks are asked for."""
    names = sorted(every)
    return names if COUNT >= 20 else random.Random(f"{what}{SEED}").sample(names, many)


def test_every_command_is_attacked_in_its_first_second() -> None:
    from jointid.apps.cli.app import _EXAMPLES

    for examples in _EXAMPLES.values():
        for text in examples.values():
            words = takewhile(lambda word: re.fullmatch(r"(?!results)[a-z][a-z-]*", word), text.split()[1:])
            assert " ".join(words) in STARTED


@pytest.mark.parametrize("command", drawn({**STARTED}, "first second"))
def test_the_first_second_of_a_command_leaves_nothing_cut_and_no_traceback(command: str, place: Path) -> None:
    words = " ".join(STARTED[command]).split()
    (place / "campaign.toml").write_text(CAMPAIGN)
    shutil.copytree(EXAMPLES / "robot", place / "robot")
    (place / "results").mkdir()
    with open_database(place / "results") as database:
        database.list_cases("fleet", ["f" * 64])
        database.add([Row("f" * 64, "a", "a.npy", "", (), None, Outcome.REFUSED, "Refused.", "")])
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
            sent = time.monotonic()
            said = process.stderr.read().decode()
        note(seconds=time.monotonic() - sent)
        assert "Traceback" not in said, said
        assert process.returncode in (0, -kill, 128 + kill), said
        found = {name: content for name, content in contents(place).items() if not name.startswith(FOLDERS)}
        before = {name: content for name, content in before.items() if not name.startswith(FOLDERS)}
        assert before.keys() <= found.keys()
        for name, content in found.items():
            kept = name not in named and name in before
            assert content == before[name] if kept else content == OLD or is_whole(name, content), name


def test_a_campaign_on_a_full_disk_loses_nothing(place: Path) -> None:
    """What is finished at one size is there at the next, and on a free disk the same command goes on."""
    (place / "campaign.toml").write_text(CAMPAIGN)
    words, before = ["campaign", "run", "campaign.toml", "--out", "results", "--workers", "1", "-q"], contents(place)
    status, finished = ["campaign", "status", "results"], 0
    for turn in range(max(COUNT // 4, 3)):
        ended = run_program(*words, folder=place, most=40_000 * turn // max(COUNT // 4, 3))
        note()
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
        note(seconds=ended.seconds)
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
    note(seconds=ended.seconds)
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
        began = time.monotonic()
        try:
            wholes += read_table(path).rows == 200_000
        except RecordError as error:
            sentences.append(str(error))
        note(seconds=time.monotonic() - began)
    over.set()
    killer.join()
    assert all("ended what reads it" in one for one in sentences)
