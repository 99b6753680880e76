"""The contracts of the house: imports run one way, and importing the package loads nothing heavy."""

import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import jointid as ji
from jointid.estimation import methods
from tests.rigid_axis import LOOP, recorded

ROOT = Path(__file__).resolve().parents[1]


def test_imports_run_one_way() -> None:
    """The contracts stand in pyproject.toml; `lint-imports` names every import that breaks one."""
    program = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    found = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout


def test_no_files_import_each_other_in_a_circle() -> None:
    """Imports inside functions count, those for types alone do not.

    The shortcuts of an estimate, as `estimate.report`, import the package by its name and are no part of this graph.
    """
    graph = grimp.build_graph("jointid", exclude_type_checking_imports=True, cache_dir=None)
    imports = {one: graph.find_modules_directly_imported_by(one) - {"jointid"} for one in graph.modules}
    tuple(TopologicalSorter(imports).static_order())  # raises a CycleError that names the files


IMPORTS = {
    "jointid": ("numpy", "scipy", "numba", "matplotlib", "cyclopts", "dataclasses"),
    "jointid.apps.cli.app": ("numpy", "scipy", "numba", "matplotlib"),
    "jointid.config": ("numba", "matplotlib", "scipy.signal", "scipy.optimize"),
    "jointid.diagnostics.validation": ("numba", "matplotlib", "scipy.signal", "scipy.optimize"),
}
"""What an import does not load, and none of those before it."""


def test_what_an_import_loads() -> None:
    program = (
        "import sys, importlib\n"
        f"for name, absent in {IMPORTS!r}.items():\n"
        "    importlib.import_module(name)\n"
        "    print(name, *(m for m in absent if m in sys.modules))\n"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == list(IMPORTS)


def test_help_loads_the_command_line_and_nothing_heavy() -> None:
    program = (
        "import sys, jointid.apps.cli.app as cli\n"
        "for words in (['--help'], ['identify', '--help'], ['--version']):\n"
        "    cli.app(words, result_action='return_value')\n"
        "    print('loaded', *sorted({m.split('.')[0] for m in sys.modules}))\n"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    each = [set(line.split()) for line in found.stdout.splitlines() if line.startswith("loaded ")]
    assert len(each) == 3
    for loaded in each:
        assert {"jointid", "cyclopts"} <= loaded
        assert not loaded & {"numpy", "scipy", "numba", "matplotlib", "tomlkit", "unittest"}


def test_every_public_name_can_be_loaded() -> None:
    import jointid

    for name in jointid.__all__:
        assert getattr(jointid, name).__doc__
    with pytest.raises(AttributeError, match="nothing"):
        jointid.nothing  # noqa: B018


def test_nothing_names_this_machine() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    forbidden = re.compile(r"/(?:home|root|Users)/\w|[A-Z]:\\\\Users")
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".txt"} and path.is_file():
            assert not forbidden.search(path.read_text(encoding="utf-8")), name


STRANGER = """
from dataclasses import dataclass
from jointid.estimation.methods import Method
from jointid.estimation.problems.inverse_model import inverse_of_joint
from jointid.estimation.problems.regression import solve_rows
from jointid.estimation.result.estimate import Settings, build_estimate, build_rows
@dataclass(frozen=True)
class Plain(Method):
    name, title = "plain", "least squares without weights"
    def identify(self, task):
        inverse = inverse_of_joint(task.joint, 0.0, task.parameters)
        motion = inverse.measure([task.record], task.filtering)
        found = solve_rows(inverse.rows([motion]), "ols", {})
        values, std = (dict(zip(found.rows.names, one.tolist())) for one in (found.values, found.covariance.std))
        rows = build_rows(task.parameters, values, std, task.joint.unit, values, {})
        torques, size = (motion.torque, inverse.columns(motion)[:, 0] @ found.values), found.residual.size
        left, of = found.rows.relative_errors(found.values), found.covariance.correlation
        settings = Settings(self.name, self.title, task.joint, None, motion.filtering)
        return build_estimate([task.record], rows, of, torques, left, size, ("solved", True), 0, settings)
"""


def test_a_stranger_adds_a_method_in_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plain.py").write_text(STRANGER, encoding="utf-8")
    monkeypatch.setattr(methods, "__path__", [*methods.__path__, str(tmp_path)])
    record, joint = recorded(noise=0.5), LOOP.joint
    found, by_idim = (ji.identify(record, joint, methods.method_of(name)()) for name in ("plain", "idim"))
    assert found.values == pytest.approx(by_idim.values, rel=1e-6) and found.to_dict()["settings"]["method"] == "plain"
