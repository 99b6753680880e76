"""What a user gets: the wheel, installed alone; the commands of the README."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest

from tests.docs.blocks import blocks
from tools.licences import PAGE, pinned
from tools.metadata import published, urls

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("wheel"))


@pytest.mark.slow
@pytest.mark.parametrize("newest", [False, True], ids=["this Python", "the newest Python"])
def test_the_wheel_works_when_installed_alone(wheel: Path, tmp_path: Path, newest: bool) -> None:
    """Demo and the README's program, from outside of the checkout."""
    python = install(wheel, tmp_path / "env", find_newest() if newest else sys.executable)
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


def install(wheel: Path, environment: Path, interpreter: str, *, pinned: bool = False) -> Path:
    """Make an environment with the wheel, and what it needs or all that is pinned, and return its Python."""
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not there to make a fresh environment with")
    subprocess.run([uv, "venv", "-q", "--python", interpreter, str(environment)], check=True, env=CLEAN)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    commands = [["--require-hashes", "-r", str(ROOT / "requirements.txt")], ["--no-deps", str(wheel)]]
    for words in commands if pinned else [[str(wheel)]]:
        subprocess.run(
            [uv, "--no-config", "pip", "install", "-q", "--python", str(python), *words], check=True, env=CLEAN
        )
    subprocess.run([uv, "pip", "check", "-q", "--python", str(python)], check=True, env=CLEAN)
    return python


def find_newest() -> str:
    """Return the newest Python of this machine that is newer than this one; the test is skipped without one."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for minor in range(14, sys.version_info.minor, -1):
        for found in (shutil.which(f"python3.{minor}"), *sorted(pyenv.glob(f"3.{minor}.*/bin/python3"))):
            if found and subprocess.run([found, "-c", ""], capture_output=True, check=False).returncode == 0:
                return str(found)
    pytest.skip("no newer Python is there")


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
    python = install(wheel, tmp_path / "env", sys.executable, pinned=True)
    subprocess.run([python.with_name("jointid"), "--version"], check=True, env=CLEAN, capture_output=True)


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


def test_the_readme_on_an_index_has_no_relative_link_and_addresses_come_from_one_setting() -> None:
    place = "https://code.example/jointid/{}/v1.2"
    there = published(README, place)
    assert "![A flexible servo axis" in there
    assert "](https://code.example/jointid/raw/v1.2/docs/images/two-masses.svg)" in there
    assert "[tutorial](https://code.example/jointid/blob/v1.2/docs/tutorial.md)" in there
    nowhere = published(README, "")
    assert "![" not in nowhere, "a picture that cannot be shown"
    assert "Read on: tutorial, gallery, questions" in nowhere
    for text in (there, nowhere):
        assert not re.search(r"\]\((?!https:)", text)
    assert urls("", "") == {}
    assert urls("https://code.example/jointid", "")["Issues"] == "https://code.example/jointid/issues"


def test_the_citation_is_of_this_version() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in citation
    assert '"Joint stiffness identification from only motor' in README
    assert "title: Joint stiffness identification from only motor force/torque data\n" in citation


def test_ci_runs_the_command_of_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "README.md" in script
    assert "PIP_BREAK_SYSTEM_PACKAGES=1" in script
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_the_workflow_runs_every_layer_on_every_python() -> None:
    yaml = pytest.importorskip("yaml")
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (named,) = re.findall(r"^case \$\{1:-\} in ([\w |]+)\)", script, re.MULTILINE)
    run = {*re.findall(r"^(?:layer|beside) (\w+) ", script, re.MULTILINE)} - {"browser"}  # which is only installed
    assert {*named.split(" | ")} == run
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8"))["jobs"]
    assert {"quick", *jobs["layers"]["strategy"]["matrix"]["layer"]} == {*named.split(" | ")}
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [line.rsplit(" ", 1)[1] for line in settings["classifiers"] if "Python :: 3." in line]
    assert jobs["quick"]["strategy"]["matrix"]["python"] == stated


def test_the_forms_for_issues_ask_with_labels_that_are_there_once() -> None:
    yaml = pytest.importorskip("yaml")
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"):
        form = yaml.safe_load(path.read_text(encoding="utf-8"))
        if path.stem == "config":
            continue
        assert {"name", "description", "body"} <= form.keys()
        asked = [one for one in form["body"] if one["type"] != "markdown"]
        assert len({one["id"] for one in asked}) == len({one["attributes"]["label"] for one in asked}) == len(asked) > 2
    assert "jointid doctor joint.toml --json" in (ROOT / ".github/ISSUE_TEMPLATE/wrong-answer.yml").read_text("utf-8")


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
ji.design(loop, record, values=truth, noise=ji.Noise(log=1.0), motion=record)
print(*threads, read())
"""


@pytest.mark.parametrize(("given", "during"), [(None, "1"), pytest.param("2", "2", marks=pytest.mark.slow)])
def test_identification_limits_linear_algebra_to_one_thread_and_gives_it_back(given: str | None, during: str) -> None:
    """A number in the environment stays."""
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    ran = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, check=True)
    if ran.stdout.split() == ["none", "none"]:
        pytest.skip("NumPy was built without OpenBLAS")
    assert ran.stdout.split() == [during, "2"]
