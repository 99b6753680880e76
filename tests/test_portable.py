"""Nothing needs what Windows lacks: modules, signals and calls of POSIX are taken away, and the program still works."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jointid as ji

ROOT = Path(__file__).resolve().parents[1]

AWAY = """
import asyncio, concurrent.futures.process, ctypes, multiprocessing.connection, os, signal, subprocess, sys, tempfile
import llvmlite.binding, matplotlib.pyplot, numba, numpy, scipy.signal, scipy.optimize, threadpoolctl

for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
for name in ("SIGALRM", "SIGHUP", "SIGIO", "SIGXCPU", "pthread_sigmask", "setitimer"):
    delattr(signal, name)
for name in ("fork", "sched_getaffinity", "getuid", "geteuid", "mkfifo", "O_CLOEXEC", "statvfs"):
    delattr(os, name)
threadpoolctl.ThreadpoolController._find_libraries_with_enum_process_module_ex = lambda self: None  # by Windows
sys.platform = "win32"
from jointid.apps.cli import main

main(["identify", "joint.toml", "-q", "--json", "out.json", "--figure", "torque.png"])
"""

JOINT = """
[joint]
kind = "prismatic"
model = "rigid"

[record]
file = "run.npy"

[record.channels]
torque = { column = "tau", unit = "N" }
reference = { column = "q", unit = "m" }

[controller]
law = "cascade"
position_gain = 100.0
velocity_gain = 2000.0
"""


@pytest.mark.slow
def test_an_identification_runs_without_what_windows_lacks(tmp_path: Path) -> None:
    (tmp_path / "joint.toml").write_text(JOINT.replace("[record]", "[record]\nsample_time = 0.001"), encoding="utf-8")
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
    truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    noise = np.random.default_rng(0).standard_normal(reference.size)
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise)
    assert record.torque is not None
    rows = np.zeros(reference.size, [("tau", float), ("q", float)])
    rows["tau"], rows["q"] = record.torque.values, reference
    np.save(tmp_path / "run.npy", rows)
    ran = subprocess.run([sys.executable, "-c", AWAY], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    found = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["parameters"]["inertia"]
    assert abs(found["value"] - truth["inertia"]) < 0.3
    assert (tmp_path / "torque.png").stat().st_size > 10_000
