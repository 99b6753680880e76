"""The size of the project, room by room, and the budget that CI holds it to.

``python -m tools.census`` prints the table; ``--check`` compares it with `tools/budget.toml` and with the budgets of
former commits, and exits with 1 where a measure is over its budget or a budget was raised.

- A room is a first folder of the package, the tests, or the studies with tools and benchmarks. Its measure is all lines
  of its Python files: code, docstrings, comments and empty ones.
- Words are those of the documentation that is written by hand, without programs and generated parts.
- Classes and calls of `isinstance` are those of the package, and of its core with its private constants and tests.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUDGET = Path("tools", "budget.toml")
_PROGRAM = re.compile(r"^(```|~~~).*?^\1\s*$|<!--.*?-->", re.DOTALL | re.MULTILINE)
_CORE = ("estimation", "solvers", "uncertainty", "common")


def run_git(root: Path, *words: str) -> str:
    """Return what a command of git prints."""
    return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True).stdout


def count_lines(paths: Iterable[Path]) -> int:
    """Return the number of lines of files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def count_words(root: Path) -> int:
    """Return the number of words of the documentation that is written by hand."""
    pages = run_git(root, "ls-files", "*.md", "docs/*.md", "examples/*.md").split()  # not those that a build makes
    return sum(len(_PROGRAM.sub(" ", (root / page).read_text(encoding="utf-8")).split()) for page in pages)


def count_commands() -> int:
    """Return the number of commands of the program, those within a command each by itself."""
    from jointid.apps.cli.app import app

    def leaves(one: object) -> int:
        names = [name for name in one if not name.startswith("-")]  # type: ignore[attr-defined]
        below: list[int] = [leaves(one[name]) for name in names]  # type: ignore[index]
        return sum(below) + int(one.default_command is not None)  # type: ignore[attr-defined]

    return leaves(app)


def count_names(package: Path) -> int:
    """Return the number of public names."""
    for node in ast.parse((package / "__init__.pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.List):
            return len(node.value.elts)
    raise SystemExit("__init__.pyi has no list __all__.")


def count_ideas(paths: Iterable[Path]) -> dict[str, int]:
    """Return the numbers of classes, isinstance calls and private constants."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in paths]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    calls = [node.func for node in nodes if isinstance(node, ast.Call)]
    named = [name for tree in trees for one in tree.body if isinstance(one, ast.Assign) for name in ast.walk(one)]
    private = (one.id for one in named if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store))
    return {
        "classes": sum(isinstance(node, ast.ClassDef) for node in nodes),
        "isinstance": sum(isinstance(call, ast.Name) and call.id == "isinstance" for call in calls),
        "private constants": sum(re.fullmatch("_[A-Z0-9_]+", name) is not None for name in private),
    }


def measure(root: Path) -> dict[str, int]:
    """Return each measure by its name, in the order of the table."""
    package = root / "src" / "jointid"
    paths = [path for path in package.rglob("*.py*") if path.suffix in (".py", ".pyi")]
    core, tests = count_ideas(path for room in _CORE for path in (package / room).rglob("*.py")), root / "tests"
    around = [root / name for name in ("studies", "tools", "benchmarks")]
    return {
        **{room.parent.name: count_lines(room.parent.rglob("*.py")) for room in sorted(package.glob("*/__init__.py"))},
        "package": count_lines(paths),
        "files": len(paths),
        "tests": count_lines(tests.rglob("*.py")),
        "studies, tools, benchmarks": count_lines(path for place in around for path in place.rglob("*.py")),
        "words": count_words(root),
        "commands": count_commands(),
        "public names": count_names(package),
        **{name: count for name, count in count_ideas(paths).items() if name != "private constants"},
        **{f"core {name}": count for name, count in core.items()},
        "core tests": count_lines(path for room in _CORE for path in (tests / room).rglob("*.py")),
        "simulation and models tests": count_lines([*tests.glob("simulation/**/*.py"), *tests.glob("models/**/*.py")]),
    }


def check(measures: Mapping[str, int], budget: Mapping[str, int], former: Mapping[str, int]) -> list[str]:
    """Return what is wrong: measures over their budget, without one, and budgets that were raised."""
    wrong = [f"{name} has no budget" for name in measures.keys() - budget.keys()]
    wrong += [f"{name} is budgeted and not measured" for name in budget.keys() - measures.keys()]
    for name in measures.keys() & budget.keys():
        if measures[name] > budget[name]:
            wrong.append(f"{name} has {measures[name]:,}, over its budget of {budget[name]:,}")
        if budget[name] > former.get(name, budget[name]):
            wrong.append(f"the budget of {name} was raised from {former[name]:,} to {budget[name]:,}")
    return wrong


def read_former(root: Path) -> dict[str, int]:
    """Return the lowest budget of each measure in the commits before the last one that changed it."""
    lowest: dict[str, int] = {}
    for commit in run_git(root, "log", "--format=%H", "--", BUDGET.as_posix()).split()[1:]:
        budget: dict[str, int] = tomllib.loads(run_git(root, "show", f"{commit}:{BUDGET.as_posix()}"))
        rooms = budget if "package" in budget else {}  # older ones are of other measures
        lowest |= {name: min(value, lowest.get(name, value)) for name, value in rooms.items()}
    return lowest


def main() -> int:
    """Print the table, and compare it with the budget if that is asked for."""
    parser = argparse.ArgumentParser(prog="python -m tools.census", description="The size of the project.")
    parser.add_argument("--check", action="store_true", help="compare with the budget")
    chosen = parser.parse_args()
    measures = measure(ROOT)
    budget: dict[str, int] = tomllib.loads((ROOT / BUDGET).read_text(encoding="utf-8"))
    for name, value in measures.items():
        print(f"{name:28} {value:8,} {budget.get(name, 0):8,}")
    wrong = check(measures, budget, read_former(ROOT)) if chosen.check else []
    for one in wrong:
        print(f"{one}: lower it")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
