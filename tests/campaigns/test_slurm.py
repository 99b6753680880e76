"""A campaign as jobs of SLURM: functions and results are files in a folder, and the client may leave.

SLURM itself is played by two scripts, which start a job as a process of this machine, and list those that run.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from jointid.campaigns.engines import LocalProcesses, SlurmJobs
from jointid.campaigns.folder import read_results
from jointid.campaigns.rows import Row
from jointid.campaigns.run import run_cases
from jointid.campaigns.store import open_database
from jointid.common.errors import ExtraError
from tests.campaigns.work import carry, cases, ends

pytest.importorskip("pysqa")
ROOT = Path(__file__).resolve().parents[2]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name == "nt", reason="SLURM"),
    pytest.mark.filterwarnings("default"),  # executorlib's own
]

SBATCH = """\
#!/bin/sh
for last; do :; done
cd "$(dirname "$last")" || exit 1
cp "$last" "job.$$"  # as SLURM does: the next job is written over the script
setsid sh "job.$$" > job.out 2>&1 < /dev/null &
echo $!
"""
SQUEUE = """\
#!/bin/sh
ps -eo pid= | while read -r pid; do echo "$pid|root|job|RUNNING|/"; done
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
    return SlurmJobs(tmp_path / "shared", jobs=2, batch=5)


def test_jobs_give_what_processes_give_and_outlive_their_client(slurm: SlurmJobs, tmp_path: Path) -> None:
    log = tmp_path / "log"
    for name in ("slurm", "here"):
        (tmp_path / name).mkdir()
    with pytest.raises(KeyboardInterrupt), open_database(tmp_path / "slurm") as database:
        keep = database.add

        def leave(rows: Sequence[Row]) -> None:
            keep(rows)
            raise KeyboardInterrupt

        database.add = leave  # type: ignore[method-assign]
        run_cases(lambda: cases(20, log), slurm, database, carry=carry)
    deadline = time.monotonic() + 60
    while len(ends(log)) < 20 and time.monotonic() < deadline:  # four jobs were under way
        time.sleep(0.1)
    with open_database(tmp_path / "slurm") as database:
        run_cases(lambda: cases(20, log), slurm, database, carry=carry)
    assert len(ends(log)) == 20, "a job whose client had left was made again"
    with open_database(tmp_path / "here") as database:
        run_cases(lambda: cases(20, tmp_path / "log"), LocalProcesses(1), database, carry=carry)
    by_slurm, here = (read_results(tmp_path / name) for name in ("slurm", "here"))
    assert [row.text() for row in by_slurm.rows] == [row.text() for row in here.rows]
    assert len(here.rows) == 20
    assert stat.S_IMODE((tmp_path / "shared").stat().st_mode) == 0o700


def test_without_the_extra_nothing_runs_here_quietly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pysqa", None)
    with (
        pytest.raises(ExtraError, match=r'^SLURM needs the package pysqa, .* "jointid\[slurm\]"'),
        open_database(tmp_path) as database,
    ):
        run_cases(lambda: cases(1, tmp_path / "log"), SlurmJobs(tmp_path / "x"), database, carry=carry)
