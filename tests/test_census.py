"""The size of a package is counted by stated rules, and what is over its budget is named."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.census import check_checkout, find_arrows, main, measure

ROOT = Path(__file__).resolve().parents[1]
QUICK = {"ratio": 2000, "seconds": 800.0, "reference": 0.4, "tests": 4000}
FILES = {
    "__init__.py": "",
    "__init__.pyi": 'from . import laws\nfrom .low.records import Record\n\n__all__ = ["Record", "laws"]\n',
    "laws.py": 'from package.low.laws import Law\n\n__all__ = ["Law"]\n',
    "low/__init__.py": "",
    "low/laws.py": "class Law:\n    pass\n",
    "low/records.py": "class Record:\n    pass\n",
    "middle/__init__.py": "",
    "middle/fit.py": """
from package.low.laws import Law


def _once(law): return law


def _twice(law): return law


class Fit:
    def _step(self): return _once(self._error()) + _twice(1) + _twice(2)

    def _error(self): return self._step() + self._step()

    def __len__(self): return 0
""",
    "top/__init__.py": "from package.laws import Law\n",
    "top/shown.py": "from package import __version__, laws\nimport package\n",
    "upper/__init__.py": "",
    "upper/program.py": "def run():\n    import package as ji\n\n    ji.Record()\n    ji.Record()\n    ji.laws.Law()\n",
}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A checkout of a package of four rooms, whose budget is what it has."""
    made = tmp_path / "src" / "package"
    for name, text in FILES.items():
        (made / name).parent.mkdir(parents=True, exist_ok=True)
        (made / name).write_text(text, encoding="utf-8")
    write_budget(made)
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "quick-tests.json").write_text(json.dumps(QUICK), encoding="utf-8")
    return made


def write_budget(package: Path, **changed: float) -> None:
    """Write a budget of what the package has, but for the measures that are named."""
    budget = {"files": len(FILES), "arrows between rooms": 3, "private functions used once": 2, "quick tests": 2000}
    text = "".join(f'"{name}" = {value}\n' for name, value in (budget | changed).items())
    (package.parents[1] / "tools").mkdir(exist_ok=True)
    (package.parents[1] / "tools" / "budget.toml").write_text(text, encoding="utf-8")


def test_arrows_go_to_the_room_that_defines_a_public_name(package: Path) -> None:
    """Also those of a namespace."""
    assert find_arrows(package) == {("middle", "low"): 1, ("top", "low"): 1, ("upper", "low"): 2}


def test_a_private_function_is_used_once_if_its_file_names_it_once(package: Path) -> None:
    """`_once` and `_error`; `_twice` and `_step` are used twice, and a special method is not private."""
    assert measure(package)["private functions used once"] == 2


def test_what_is_within_its_budget_passes(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(package), "--check"]) == 0
    said = capsys.readouterr().out
    assert "4,000 took 800 s of processor, the reference 0.400 s" in said
    assert "budget" not in said


def test_every_measure_over_its_budget_is_named(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_budget(package, **{"files": 10, "quick tests": 1999, "arrows between rooms": 4})
    assert main([str(package), "--check"]) == 1
    *_, files, quick, spare = capsys.readouterr().out.splitlines()
    assert files.startswith("over budget: files 12, budget 10: lower it, or raise the budget in a commit of its own")
    assert quick.startswith("over budget: quick tests 2,000, budget 1,999: ")
    assert spare == "budgets that could be lowered by more than 3%: arrows between rooms 4 to 3"


@pytest.mark.parametrize(("in_ci", "passed"), [("true", False), ("", True)])
def test_quick_tests_must_have_been_measured_in_ci(
    package: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, in_ci: str, passed: bool
) -> None:
    monkeypatch.setenv("CI", in_ci)
    (package.parents[1] / "build" / "quick-tests.json").unlink()
    assert check_checkout(package, measure(package)) is passed
    assert "quick-tests.json is missing: a run of all quick tests" in capsys.readouterr().out


def test_a_budget_of_something_unknown_is_refused(package: Path) -> None:
    write_budget(package, pages=3)
    with pytest.raises(SystemExit, match="'pages'"):
        check_checkout(package, measure(package))


@pytest.mark.slow
@pytest.mark.parametrize("processes", [0, 2])
def test_processor_time_counts_every_process_of_a_whole_run(tmp_path: Path, processes: int) -> None:
    """One test computes for a second, another has a subprocess do so."""
    second = "import time; any(time.process_time() > 1.0 for _ in iter(int, 1))"
    files = {
        "pytest.ini": f"""
[pytest]
testpaths = tests
addopts = -p xdist.plugin -m "not slow" -n {processes}
markers = slow
""",
        "tests/conftest.py": 'pytest_plugins = ["tests.processor_time"]\n',
        "tests/test_busy.py": f"""
import subprocess, sys, time

def test_here():
    end = time.process_time() + 1.0
    while time.process_time() < end: pass

def test_below(): subprocess.run([sys.executable, "-c", {second!r}], check=True)
""",
    }
    (tmp_path / "tests").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")

    def run(*words: str) -> dict[str, float] | None:
        place = tmp_path / "build" / "quick-tests.json"
        place.unlink(missing_ok=True)
        command = [sys.executable, "-m", "pytest", "-q", *words]
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "PYTEST_ADDOPTS": "",
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        }
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
        return json.loads(place.read_text(encoding="utf-8")) if place.is_file() else None

    found = run()
    assert found
    assert found["tests"] == 2
    assert 2.0 < found["seconds"] < 30.0
    assert found["ratio"] == pytest.approx(found["seconds"] / found["reference"], abs=0.6)
    if not processes:
        for words in (("-k", "test"), ("-m", ""), ("tests",)):
            assert run(*words) is None
