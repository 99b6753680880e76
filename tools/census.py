"""The size of the package and of its structure: files, lines, arrows between rooms, public names.

``python -m tools.census [SRC] [--arrows]`` counts a `src/jointid` folder, this checkout's unless another is named, so
that two versions are counted by one rule. Code is a line with a token that is neither a comment nor of a docstring. An
arrow is a pair of rooms, the first folders below the package, of which one imports the other; imports for types alone
count, too.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parents[1] / "src" / "jointid"
_SILENT = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


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


def find_arrows(package: Path) -> Counter[tuple[str, str]]:
    """Return how many imports lead from a room to another, for each pair of rooms."""
    found: Counter[tuple[str, str]] = Counter()
    for path in package.rglob("*.py"):
        here = path.relative_to(package).parts[0]
        if here.endswith(".py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                rooms = (name or "").split(".")
                if rooms[0] == package.name and len(rooms) > 1 and rooms[1] != here:
                    found[here, rooms[1]] += 1
    return found


def count_names(package: Path) -> int:
    """Return the number of public names: the entries of `__all__`, in the stub or in the package's own file."""
    for name in ("__init__.pyi", "__init__.py"):
        path = package / name
        if not path.is_file():
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if (
                isinstance(node, ast.Assign)
                and isinstance(node.value, ast.List)
                and ast.unparse(node.targets[0]) == "__all__"
            ):
                return len(node.value.elts)
    return 0


def main() -> None:
    """Print the table."""
    words = [word for word in sys.argv[1:] if word != "--arrows"]
    package = Path(words[0]).resolve() if words else HERE
    texts = [path.read_text(encoding="utf-8") for path in package.rglob("*.py*") if path.suffix in (".py", ".pyi")]
    counts = [count_lines(text) for text in texts]
    arrows = find_arrows(package)
    rooms = sorted(path.parent.name for path in package.glob("*/__init__.py"))
    rows = (
        ("files", len(texts)),
        ("lines", sum(len(text.splitlines()) for text in texts)),
        ("lines of code", sum(code for code, _ in counts)),
        ("lines of docstring", sum(words for _, words in counts)),
        ("rooms", len(rooms)),
        ("arrows between rooms", len(arrows)),
        ("public names", count_names(package)),
    )
    for name, value in rows:
        print(f"{name:22} {value:7d}")
    if "--arrows" in sys.argv:
        for (room, other), imports in sorted(arrows.items()):
            print(f"{room} -> {other} {imports}")


if __name__ == "__main__":
    main()
