"""What a user gets: the wheel, installed alone; the commands of the README."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tools.licences import PAGE, pinned

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("wheel"))


@pytest.mark.slow
def test_the_wheel_works_when_installed_alone(wheel: Path, tmp_path: Path) -> None:
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not there to make a fresh environment with")
    clean = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}
    environment = tmp_path / "env"
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, str(environment)], check=True, env=clean)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    subprocess.run([uv, "pip", "install", "-q", "--python", str(python), str(wheel)], check=True, env=clean)
    (installed,) = environment.rglob("site-packages/jointid")
    take_kernels(installed)
    program = python.with_name("jointid")
    version = subprocess.run(
        [program, "--version"], check=True, env=clean, cwd=tmp_path, capture_output=True, text=True
    )
    assert re.search(r"\d+\.\d+\.\d+", version.stdout)
    demo = subprocess.run([program, "demo", "out"], check=True, env=clean, cwd=tmp_path, capture_output=True, text=True)
    assert "inertia" in demo.stdout
    assert (tmp_path / "out" / "torque.png").stat().st_size > 10_000
    assert (installed / "py.typed").is_file()


def build(folder: Path) -> Path:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    (wheel,) = folder.glob("*.whl")
    return wheel


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
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not there to make a fresh environment with")
    assert build(tmp_path / "again").read_bytes() == wheel.read_bytes()
    clean = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}
    environment = tmp_path / "env"
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, str(environment)], check=True, env=clean)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    install = [uv, "--no-config", "pip", "install", "-q", "--python", str(python)]
    subprocess.run([*install, "--require-hashes", "-r", str(ROOT / "requirements.txt")], check=True, env=clean)
    subprocess.run([*install, "--no-deps", str(wheel)], check=True, env=clean)
    subprocess.run([uv, "pip", "check", "-q", "--python", str(python)], check=True, env=clean)
    subprocess.run([python.with_name("jointid"), "--version"], check=True, env=clean, capture_output=True)


def test_what_is_pinned_is_what_is_tested_names_no_host_and_has_hashes() -> None:
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    assert "//" not in text
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    tested = dict(one.lower().replace(".", "-", one.split("==")[0].count(".")).split("==")
                  for one in settings["tool"]["uv"]["constraint-dependencies"])  # fmt: skip
    versions = pinned()
    assert versions.keys() >= {"numpy", "h5py", "bokeh", "starlette", "control", "pandas"}
    assert {name: version for name, version in versions.items() if name in tested} == {
        name: version for name, version in tested.items() if name in versions
    }
    blocks = re.split(r"\n(?=[\w.-]+==)", text)[1:]
    assert len(blocks) >= len(versions)
    assert all("--hash=sha256:" in block for block in blocks)


def test_the_table_of_licences_has_every_package_and_one_that_is_not_permissive() -> None:
    rows = dict(re.findall(r"^\| ([\w-]+) \| [^|]+ \| ([^|]+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    assert rows.keys() - {"package"} == pinned().keys()
    assert [name for name, licence in rows.items() if "GPL" in licence] == ["nptdms"]
    core = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    assert not any("tdms" in one.lower() for one in core)


def test_the_readme_has_the_two_commands() -> None:
    assert "python3 -m pip install uv && python3 -m uv run jointid demo" in README
    assert "python3 -m pip install uv && python3 -m uv run pytest" in README


def test_ci_runs_the_command_of_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "README.md" in script
    assert "PIP_BREAK_SYSTEM_PACKAGES=1" in script
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_every_layer_that_is_left_out_by_itself_is_run_by_ci() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    layers = [marker.split(":")[0] for marker in settings["markers"]]
    assert f'-m "{" and ".join(f"not {layer}" for layer in layers)}"' in settings["addopts"]
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert f"pytest -m '{' or '.join(layers)}'" in script
    assert "--durations=20" in script


THREADS = """
import ctypes
import numpy.linalg._umath_linalg as linear
import jointid as ji

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
ji.identify(record, loop, progress=lambda _: threads.add(read()))
print(*threads, read())
"""


@pytest.mark.parametrize(("given", "during"), [(None, "1"), ("2", "2")])
def test_identification_limits_linear_algebra_to_one_thread_and_gives_it_back(given: str | None, during: str) -> None:
    """A number in the environment stays."""
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    ran = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, check=True)
    if ran.stdout.split() == ["none", "none"]:
        pytest.skip("NumPy was built without OpenBLAS")
    assert ran.stdout.split() == [during, "2"]
