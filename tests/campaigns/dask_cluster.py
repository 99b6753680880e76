"""A Dask cluster on this machine, whose workers come and go."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class Cluster:
    """A scheduler and workers, each a process, as `dask scheduler` and `dask worker` start them."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack, address: str = "tcp://127.0.0.1:0") -> None:
        self._file, self._stack = folder / "scheduler.json", stack
        self.scheduler = self.start_scheduler(address)
        while not self._file.exists() or not self._file.stat().st_size:  # it is made, and then written
            time.sleep(0.05)
        self.address: str = json.loads(self._file.read_text())["address"]

    def start_scheduler(self, address: str) -> subprocess.Popen[bytes]:
        """Start a scheduler at an address, whose port may be 0 for any."""
        place, _, port = address.rpartition(":")
        return self.start("dask_scheduler", "--host", place, "--port", port, "--dashboard-address", "127.0.0.1:0")

    def start(self, program: str, *options: str) -> subprocess.Popen[bytes]:
        """Start a program of Dask's, which ends with the stack."""
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--scheduler-file", str(self._file), *options]
        few = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}  # workers take seconds to start anew
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL, env=os.environ | few)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def add_worker(self, *options: str, nanny: bool = False) -> subprocess.Popen[bytes]:
        """Start a worker of one thread; with a nanny, which starts it anew when it dies."""
        kind = "--nanny" if nanny else "--no-nanny"
        return self.start("dask_worker", "--nthreads", "1", kind, "--dashboard-address", "127.0.0.1:0", *options)
