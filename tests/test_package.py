"""What a user gets: the wheel, installed alone; linear algebra that keeps to one thread."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.docs.blocks import blocks
from tests.rigid_axis import TRUTH, write_axis

ROOT = Path(__file__).resolve().parents[1]


CLEAN = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}


def call(*words: object, cwd: Path | None = None) -> str:
    """Run a program outside of the checkout's environment, and return what it printed."""
    ran = subprocess.run(list(map(str, words)), check=True, env=CLEAN, cwd=cwd, capture_output=True, text=True)
    return ran.stdout


def build(folder: Path, source: Path = ROOT, kind: str = "wheel") -> Path:
    call(sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", folder, cwd=source)
    (built,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return built


def install(wheel: Path, environment: Path, *, pinned: bool = False) -> Path:
    """Make an environment with the wheel, and what it needs or all that is pinned, and return its Python."""
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not there to make a fresh environment with")
    call(uv, "venv", "-q", "--python", sys.executable, environment)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    commands = [["--require-hashes", "-r", ROOT / "requirements.txt"], ["--no-deps", wheel]]
    for words in commands if pinned else [[wheel]]:
        call(uv, "--no-config", "pip", "install", "-q", "--python", python, *words)
    call(uv, "pip", "check", "-q", "--python", python)
    return python


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("wheel"))


@pytest.mark.slow
def test_the_wheel_works_when_installed_alone(wheel: Path, tmp_path: Path) -> None:
    """Demo and the README's program, from outside of the checkout; the kernels of this checkout need no compiling."""
    python = install(wheel, tmp_path / "env")
    (installed,) = (tmp_path / "env").rglob("site-packages/jointid")
    package = ROOT / "src" / "jointid"
    for kernel in package.rglob("*.nb[ic]"):
        there = installed / kernel.relative_to(package)
        there.parent.mkdir(exist_ok=True)
        shutil.copy2(kernel, there)
    program = python.with_name("jointid")
    assert re.search(r"\d+\.\d+\.\d+", call(program, "--version", cwd=tmp_path))
    assert "inertia" in call(program, "demo", "out", cwd=tmp_path)
    assert (tmp_path / "out" / "torque.png").stat().st_size > 10_000
    assert (installed / "py.typed").is_file()
    (example,) = (block.text for block in blocks(ROOT / "README.md") if block.language == "python")
    printed = call(python, "-c", example, cwd=tmp_path / "out").splitlines()[-1]
    value, low, high = map(float, re.findall(r"[\d.]+(?:e[+-]?\d+)?", printed))
    assert low < 800_000 < high
    assert low < value < high


@pytest.mark.slow
def test_the_wheel_is_the_same_whenever_it_is_built_and_installs_with_the_pinned_files(
    wheel: Path, tmp_path: Path
) -> None:
    assert build(tmp_path / "again").read_bytes() == wheel.read_bytes()
    with tarfile.open(build(tmp_path, kind="sdist")) as archive:
        archive.extractall(tmp_path / "source", filter="data")
    (source,) = (tmp_path / "source").iterdir()
    assert build(tmp_path / "of the source", source).read_bytes() == wheel.read_bytes()
    python = install(wheel, tmp_path / "env", pinned=True)
    call(python.with_name("jointid"), "--version")


THREADS = """
import ctypes
import numpy.linalg._umath_linalg as linear
import jointid as ji
from jointid.diagnostics import validation
from jointid.planning import design as planned
from tests.rigid_axis import LOOP, TRUTH, recorded

library = ctypes.CDLL(linear.__file__)
if not hasattr(library, "scipy_openblas_set_num_threads64_"):
    print("none none")
    raise SystemExit
read, threads = library.scipy_openblas_get_num_threads64_, set()
library.scipy_openblas_set_num_threads64_(2)
record = recorded()
estimate = ji.identify(record, LOOP, checks=False, progress=lambda _: threads.add(read()))
validation.check_record = planned._predict = lambda *_: threads.add(read())
ji.validate(estimate, record)
ji.design(LOOP, record, values=TRUTH, noise={"log": 1.0}, motion=record)
print(*threads, read())
"""


@pytest.mark.slow
def test_identification_limits_linear_algebra_to_one_thread_and_gives_it_back() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    ran = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, check=True)
    if ran.stdout.split() == ["none", "none"]:
        pytest.skip("NumPy was built without OpenBLAS")
    assert ran.stdout.split() == ["1", "2"]


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


@pytest.mark.slow
def test_an_identification_runs_without_what_windows_lacks(tmp_path: Path) -> None:
    write_axis(tmp_path)
    ran = subprocess.run([sys.executable, "-c", AWAY], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    found = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["parameters"]["inertia"]
    assert abs(found["value"] - TRUTH["inertia"]) < 0.3
    assert (tmp_path / "torque.png").stat().st_size > 10_000
