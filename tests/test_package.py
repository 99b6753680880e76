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

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_wheel_works_when_installed_alone(tmp_path: Path) -> None:
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not there to make a fresh environment with")
    clean = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    (wheel,) = tmp_path.glob("*.whl")
    environment = tmp_path / "env"
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, str(environment)], check=True, env=clean)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    subprocess.run([uv, "pip", "install", "-q", "--python", str(python), str(wheel)], check=True, env=clean)
    program = python.with_name("jointid")
    version = subprocess.run(
        [program, "--version"], check=True, env=clean, cwd=tmp_path, capture_output=True, text=True
    )
    assert re.search(r"\d+\.\d+\.\d+", version.stdout)
    demo = subprocess.run([program, "demo", "out"], check=True, env=clean, cwd=tmp_path, capture_output=True, text=True)
    assert "inertia" in demo.stdout
    assert (tmp_path / "out" / "torque.png").stat().st_size > 10_000
    typed = python.parent.parent.rglob("jointid/py.typed")
    assert next(typed, None) is not None


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
