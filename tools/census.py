"""The size of the package and of its structure, and the budget that CI holds it to.

``python -m tools.census [SRC] [--arrows] [--check]`` counts a `src/jointid` folder, this checkout's unless another is
named, so that two versions are counted by one rule.

- Code is a line with a token that is neither a comment nor of a docstring.
- A room is a first folder below the package. An arrow is a pair of rooms of which one imports the other; imports for
  types alone count, too. A public name that is imported from the package itself, or from one of its namespaces (a
  file beside `__init__.py`), leads to the room that defines it.
- A private function is a function or method whose name begins with one underscore. It is used once if its own file
  refers to that name exactly once, beside the definition; to a name that is defined twice, twice.

``--check`` compares the counts with `tools/budget.toml`, and the processor time of the quick tests, which
`tests/processor_time.py` measures. It exits with 1 if a measure is over its budget.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import sys
import time
import tokenize
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parents[1] / "src" / "jointid"
QUICK_TESTS = Path("build", "quick-tests.json")
"""Where the quick tests leave what they took, in their checkout."""
QUICK = "quick tests"
"""The name of what they took: processor seconds, divided by those of the reference computation."""

REMEDY = "lower it, or raise the budget in a commit of its own that says what it bought"
_SILENT = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
_SPARE = 0.03
"""The share of a budget from which on unused budget is worth a remark."""


def count_lines(text: str) -> tuple[int, int]:
    """Return the lines of code and of docstrings of a module."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                documented |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _SILENT:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - documented), len(documented)


def _parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _rooms_of_names(package: Path) -> dict[str, str]:
    """Return the room of each public name, as `package.Record` or `package.friction.StribeckFriction`."""
    found = {f"{package.name}.{path.parent.name}": path.parent.name for path in package.glob("*/__init__.py")}
    for path in sorted(package.glob("*.py*")):
        module = package.name if path.stem == "__init__" else f"{package.name}.{path.stem}"
        for node in _parse(path).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                room = node.module.removeprefix(f"{package.name}.").split(".")[0]
                found |= {f"{module}.{alias.name}": room for alias in node.names}
    return found


def _imported(tree: ast.Module, package: str, public: Collection[str]) -> Iterator[str]:
    """Yield what a file imports: a module by its name, a public name with that of the package or the namespace.

    What is used of the package by attribute, after ``import jointid as ji``, counts as imported from it, once for each
    name.
    """
    whole: set[str] = set()
    used: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names = {f"{node.module}.{alias.name}" for alias in node.names} & {*public}
            yield from names or {node.module or ""}
        elif isinstance(node, ast.Import):
            whole |= {alias.asname or alias.name for alias in node.names if alias.name == package}
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Attribute):
            used.add(ast.unparse(node))
    for name in sorted(used):
        first, *below = name.split(".")
        if first in whole and ".".join([package, *below]) in public:
            yield ".".join([package, *below])


def find_arrows(package: Path) -> Counter[tuple[str, str]]:
    """Return how many imports lead from a room to another, for each pair of rooms."""
    found: Counter[tuple[str, str]] = Counter()
    public = _rooms_of_names(package)
    for path in package.rglob("*.py"):
        here = path.relative_to(package).parts[0]
        if here.endswith(".py"):
            continue
        for name in _imported(_parse(path), package.name, public):
            room = public.get(name) or public.get(".".join(name.split(".")[:2]))
            if room and room != here:
                found[here, room] += 1
    return found


def count_names(package: Path) -> int:
    """Return the number of public names: the entries of `__all__`, in the stub or in the package's own file."""
    for name in ("__init__.pyi", "__init__.py"):
        path = package / name
        if not path.is_file():
            continue
        for node in _parse(path).body:
            if (
                isinstance(node, ast.Assign)
                and isinstance(node.value, ast.List)
                and ast.unparse(node.targets[0]) == "__all__"
            ):
                return len(node.value.elts)
    return 0


def count_used_once(tree: ast.Module) -> int:
    """Return the number of a file's private functions that are used once."""
    defined: Counter[str] = Counter()
    used: Counter[str] = Counter()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            defined[node.name] += 1
        elif isinstance(node, ast.Name):
            used[node.id] += 1
        elif isinstance(node, ast.Attribute):
            used[node.attr] += 1
    private = {name: number for name, number in defined.items() if name.startswith("_") and name[:2] != "__"}
    return sum(number for name, number in private.items() if used[name] == number)


def measure(package: Path) -> dict[str, float]:
    """Return each measure of a package by its name, in the order of the table."""
    paths = [path for path in package.rglob("*.py*") if path.suffix in (".py", ".pyi")]
    texts = [path.read_text(encoding="utf-8") for path in paths]
    counts = [count_lines(text) for text in texts]
    return {
        "files": len(texts),
        "lines": sum(len(text.splitlines()) for text in texts),
        "lines of code": sum(code for code, _ in counts),
        "lines of docstring": sum(words for _, words in counts),
        "rooms": len(list(package.glob("*/__init__.py"))),
        "arrows between rooms": len(find_arrows(package)),
        "public names": count_names(package),
        "private functions used once": sum(count_used_once(_parse(path)) for path in paths),
    }


def read_quick_tests(checkout: Path) -> dict[str, float]:
    """Return the processor time of the quick tests, relative to the reference; nothing if no run measured it."""
    place = checkout / QUICK_TESTS
    if not place.is_file():
        return {}
    found = json.loads(place.read_text(encoding="utf-8"))
    when = time.strftime("%Y-%m-%d %H:%M", time.localtime(place.stat().st_mtime))
    print(
        f"quick tests: {found['tests']:,} took {found['seconds']:,.0f} s of processor, the reference"
        f" {found['reference']:.3f} s; measured {when}"
    )
    return {QUICK: found["ratio"]}


def check(measures: Mapping[str, float], budget: Mapping[str, float]) -> bool:
    """Print every measure that is over its budget, and those far below it; return whether all are within it."""
    over = [name for name, limit in budget.items() if measures[name] > limit]
    for name in over:
        print(f"over budget: {name} {measures[name]:,}, budget {budget[name]:,}: {REMEDY}")
    spare = [
        f"{name} {limit:,} to {measures[name]:,}"
        for name, limit in budget.items()
        if measures[name] < (1 - _SPARE) * limit
    ]
    if spare:
        print(f"budgets that could be lowered by more than {_SPARE:.0%}: {', '.join(spare)}")
    return not over


def check_checkout(package: Path, measures: Mapping[str, float]) -> bool:
    """Return whether a package and the quick tests of its checkout are within the checkout's budget."""
    checkout = package.parents[1]
    budget = tomllib.loads((checkout / "tools" / "budget.toml").read_text(encoding="utf-8"))
    if unknown := budget.keys() - measures.keys() - {QUICK}:
        raise SystemExit(f"tools/budget.toml has {sorted(unknown)}; expected names of this table and {QUICK!r}.")
    measured = read_quick_tests(checkout)
    if not measured:
        print(f"{QUICK_TESTS} is missing: a run of all quick tests that passes writes it")
        budget.pop(QUICK, None)
    within = check({**measures, **measured}, budget)
    return within and (bool(measured) or os.environ.get("CI") != "true")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, then the arrows and the comparison with the budget if they are asked for."""
    parser = argparse.ArgumentParser(prog="python -m tools.census", description="The size of a package.")
    parser.add_argument("package", nargs="?", type=Path, default=HERE, help="the folder to count")
    parser.add_argument("--arrows", action="store_true", help="list the arrows, each with its number of imports")
    parser.add_argument("--check", action="store_true", help="compare with the budget of the package's checkout")
    chosen = parser.parse_args(arguments)
    package = chosen.package.resolve()
    measures = measure(package)
    for name, value in measures.items():
        print(f"{name:28} {value:7d}")
    if chosen.arrows:
        for (room, other), imports in sorted(find_arrows(package).items()):
            print(f"{room} -> {other} {imports}")
    return 0 if not chosen.check or check_checkout(package, measures) else 1


if __name__ == "__main__":
    sys.exit(main())
