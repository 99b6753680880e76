"""A campaign as jobs of SLURM: functions and results are files in a folder, and the client may leave.

SLURM itself is played by two scripts, which start a job as a process of this machine, and list those that run.
"""

from __future__ import annotations

import contextlib
import os
import signal
import stat
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from jointid.campaigns.cases import Case, Outcome, Row
from jointid.campaigns.engines import LocalProcesses, SlurmJobs
from jointid.campaigns.folder import read_results
from jointid.campaigns.run import run_cases
from jointid.campaigns.store import open_database
from jointid.common.errors import ExtraError, RecordError
from tests.campaigns.work import SLOW, carry, cases, ends

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name == "nt", reason="SLURM"),
    pytest.mark.skipif(not (find_spec("pysqa") and find_spec("h5py")), reason="pysqa or h5py is not installed"),
    pytest.mark.filterwarnings("default"),  # executorlib's own
]

SBATCH = """\
#!/bin/sh
for last; do :; done
cd "$(dirname "$last")" || exit 1
cp "$last" "job.$$"  # as SLURM does: the script may be written over
setsid sh "job.$$" > job.out 2>&1 < /dev/null &
echo "$! $PWD" >> "$JOBS"
echo $!
"""
SQUEUE = """\
#!/bin/sh
touch "$JOBS"
while read -r pid folder; do
    kill -0 "$pid" 2> /dev/null || continue
    case "$*" in *%A*) echo "$pid|root|RUNNING|job|$folder" ;; *) echo "$folder" ;; esac
done < "$JOBS"
"""


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SlurmJobs:
    (tmp_path / "bin").mkdir()
    for name, text in (("sbatch", SBATCH), ("squeue", SQUEUE)):
        path = tmp_path / "bin" / name
        path.write_text(text)
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("JOBS", str(tmp_path / "jobs"))
    monkeypatch.setattr("jointid.campaigns.engines._LOOK", 0.5)
    return SlurmJobs(tmp_path / "shared", jobs=2, batch=5)


def leave_after_a_job(slurm: SlurmJobs, folder: Path, made: Callable[[], Iterable[Case]]) -> None:
    """Run a campaign in a folder until the result of its first job is kept."""
    folder.mkdir()
    with pytest.raises(KeyboardInterrupt), open_database(folder) as database:
        keep = database.add

        def leave(rows: Sequence[Row]) -> None:
            keep(rows)
            raise KeyboardInterrupt

        database.add = leave  # type: ignore[method-assign]
        run_cases(made, slurm, database, carry=carry)


def test_jobs_give_what_processes_give_and_outlive_their_client(slurm: SlurmJobs, tmp_path: Path) -> None:
    log = tmp_path / "log"
    (tmp_path / "here").mkdir()
    leave_after_a_job(slurm, tmp_path / "slurm", lambda: cases(20, log))
    with open_database(tmp_path / "slurm") as database:
        run_cases(lambda: cases(20, log), slurm, database, carry=carry)
    assert len(ends(log)) == 20, "a job whose client had left was made again"
    with open_database(tmp_path / "here") as database:
        run_cases(lambda: cases(20, tmp_path / "log"), LocalProcesses(1), database, carry=carry)
    by_slurm, here = (read_results(tmp_path / name) for name in ("slurm", "here"))
    assert [row.text() for row in by_slurm.rows] == [row.text() for row in here.rows]
    assert len(here.rows) == 20
    assert stat.S_IMODE((tmp_path / "shared").stat().st_mode) == 0o700


def test_what_is_under_way_is_waited_for_by_a_client_that_returns_with_more_cases(
    slurm: SlurmJobs, tmp_path: Path
) -> None:
    """The later job is under way when the client returns, and four cases more shift every batch but that one."""
    import h5py

    log, slow = tmp_path / "log", dict.fromkeys(range(5, 10), SLOW)
    leave_after_a_job(slurm, tmp_path / "out", lambda: cases(10, log, slow))
    begun = set(hash_lines(tmp_path / "shared"))
    deadline = time.monotonic() + 60
    while len(ends(log)) < 6 and time.monotonic() < deadline:  # it has read its file
        time.sleep(0.05)
    assert len(ends(log)) < 10, "it was to be under way"
    for path in (tmp_path / "shared").glob("*_i.h5"):  # as if the client was killed before it wrote the job's number
        with h5py.File(path, "a") as file:
            file.pop("queue_id", None)
    more = [*cases(14, log, slow)][::-1]
    with open_database(tmp_path / "out") as database:
        ran = run_cases(lambda: more, slurm, database, carry=carry)
    assert (ran.found, ran.made[Outcome.IDENTIFIED]) == (5, 9)
    assert len(ends(log)) == len(set(ends(log))) == 14, "what was under way was made again"
    assert begun < set(hash_lines(tmp_path / "shared"))


def test_a_job_that_died_while_nobody_looked_is_made_again(slurm: SlurmJobs, tmp_path: Path) -> None:
    log, slow = tmp_path / "log", dict.fromkeys(range(5, 10), SLOW)
    leave_after_a_job(slurm, tmp_path / "out", lambda: cases(10, log, slow))
    for line in (tmp_path / "jobs").read_text().splitlines():
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(line.split()[0]), signal.SIGKILL)
    with open_database(tmp_path / "out") as database:
        run_cases(lambda: cases(10, log, slow), slurm, database, carry=carry)
    assert read_results(tmp_path / "out").counts()[Outcome.IDENTIFIED] == 10


def test_a_job_that_could_not_be_submitted_is_tried_again(slurm: SlurmJobs, tmp_path: Path) -> None:
    log, path = tmp_path / "log", tmp_path / "bin" / "sbatch"
    path.write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(RecordError, match=r"^The workers gave a case up"), open_database(tmp_path) as database:
        run_cases(lambda: cases(5, log), slurm, database, carry=carry)
    path.write_text(SBATCH)
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(5, log), slurm, database, carry=carry)
    assert read_results(tmp_path).counts()[Outcome.IDENTIFIED] == 5
    (script,) = (tmp_path / "shared").glob("*/run_queue.sh")
    assert "--partition" not in script.read_text(), "an empty one is not the default one"
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(6, log), replace(slurm, partition="short"), database, carry=carry)
    assert any("#SBATCH --partition=short\n" in one.read_text() for one in script.parents[1].glob("*/run_queue.sh"))


def hash_lines(folder: Path) -> list[str]:
    return [line for path in folder.glob("*/cases.txt") for line in path.read_text().split()]


def test_without_the_extra_nothing_runs_here_quietly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pysqa", None)
    with (
        pytest.raises(ExtraError, match=r'^SLURM needs the package pysqa, .* "jointid\[slurm\]"'),
        open_database(tmp_path) as database,
    ):
        run_cases(lambda: cases(1, tmp_path / "log"), SlurmJobs(tmp_path / "x"), database, carry=carry)
