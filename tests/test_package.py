"""What a user gets: the wheel, installed alone; linear algebra that keeps to one thread."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.docs.blocks import blocks

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("wheel"))


@pytest.mark.slow
def test_the_wheel_works_when_installed_alone(wheel: Path, tmp_path: Path) -> None:
    """Demo and the README's program, from outside of the checkout."""
    python = install(wheel, tmp_path / "env")
    (installed,) = (tmp_path / "env").rglob("site-packages/jointid")
    take_kernels(installed)
    program = python.with_name("jointid")
    version = subprocess.run(
        [program, "--version"], check=True, env=CLEAN, cwd=tmp_path, capture_output=True, text=True
    )
    assert re.search(r"\d+\.\d+\.\d+", version.stdout)
    demo = subprocess.run([program, "demo", "out"], check=True, env=CLEAN, cwd=tmp_path, capture_output=True, text=True)
    assert "inertia" in demo.stdout
    assert (tmp_path / "out" / "torque.png").stat().st_size > 10_000
    assert (installed / "py.typed").is_file()
    (example,) = (block.text for block in blocks(ROOT / "README.md") if block.language == "python")
    ran = subprocess.run(
        [python, "-c", example], check=True, env=CLEAN, cwd=tmp_path / "out", capture_output=True, text=True
    )
    value, low, high = map(float, re.findall(r"[\d.]+(?:e[+-]?\d+)?", ran.stdout.splitlines()[-1]))
    assert low < 800_000 < high
    assert low < value < high


CLEAN = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}


def install(wheel: Path, environment: Path, *, pinned: bool = False) -> Path:
    """Make an environment with the wheel, and what it needs or all that is pinned, and return its Python."""
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not there to make a fresh environment with")
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, str(environment)], check=True, env=CLEAN)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    commands = [["--require-hashes", "-r", str(ROOT / "requirements.txt")], ["--no-deps", str(wheel)]]
    for words in commands if pinned else [[str(wheel)]]:
        subprocess.run(
            [uv, "--no-config", "pip", "install", "-q", "--python", str(python), *words], check=True, env=CLEAN
        )
    subprocess.run([uv, "pip", "check", "-q", "--python", str(python)], check=True, env=CLEAN)
    return python


def build(folder: Path, source: Path = ROOT, kind: str = "wheel") -> Path:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)],
        cwd=source, check=True, capture_output=True,
    )  # fmt: skip
    (built,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return built


def take_kernels(installed: Path) -> None:
    """Copy the compiled kernels of this checkout beside the installed sources, which are the same files.

    Compiling them takes most of a minute. A copy that does not fit is compiled again.
    """
    package = ROOT / "src" / "jointid"
    for kernel in package.rglob("*.nb[ic]"):
        there = installed / kernel.relative_to(package)
        there.parent.mkdir(exist_ok=True)
        shutil.copy2(kernel, there)


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
    subprocess.run([python.with_name("jointid"), "--version"], check=True, env=CLEAN, capture_output=True)


THREADS = """
import ctypes
import numpy.linalg._umath_linalg as linear
import jointid as ji
from jointid.diagnostics import validation
from jointid.planning import design as planned

library = ctypes.CDLL(linear.__file__)
if not hasattr(library, "scipy_openblas_set_num_threads64_"):
    print("none none")
    raise SystemExit
read, threads = library.scipy_openblas_get_num_threads64_, set()
library.scipy_openblas_set_num_threads64_(2)
loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
estimate = ji.identify(record, loop, progress=lambda _: threads.add(read()))
validation.check_record = planned._predict = lambda *_: threads.add(read())
ji.validate(estimate, record)
ji.design(loop, record, values=truth, noise={"log": 1.0}, motion=record)
print(*threads, read())
"""


def test_identification_limits_linear_algebra_to_one_thread_and_gives_it_back() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    ran = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, check=True)
    if ran.stdout.split() == ["none", "none"]:
        pytest.skip("NumPy was built without OpenBLAS")
    assert ran.stdout.split() == ["1", "2"]
