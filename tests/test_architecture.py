"""The picture in docs/architecture.md is true: imports run one way, through rooms that are all in it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "jointid"
PICTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").split("```")[1]


def places() -> list[str]:
    """Return every module of the picture, dotted, in its order; a folder named without files ends in a dot."""
    order = []
    for line in PICTURE.strip().splitlines():
        room, _, files = line.partition(" ")
        inside = [name.strip() for name in files.split(",") if name.strip()]
        if not inside:
            order.append(room.replace("/", "."))
        order += [room.replace("/", ".") + name.replace("/", ".") for name in inside]
    return order


def position(module: str, order: list[str]) -> int:
    """Return where a module stands in the picture: its own place, or that of the folder it is in."""
    for i, place in enumerate(order):
        if module == place or (place.endswith(".") and f"{module}.".startswith(place)):
            return i
    within = [i for i, place in enumerate(order) if place.startswith(f"{module}.")]
    if within:  # a room itself, by the names its own file gives: it stands where its last file does
        return within[-1]
    pytest.fail(f"jointid.{module} is not in the picture of docs/architecture.md")


def imports(path: Path) -> set[str]:
    """Return the modules of the package that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jointid"):
            for alias in node.names:
                inner = PACKAGE.joinpath(*str(node.module).split(".")[1:], alias.name)
                module = inner.is_dir() or inner.with_suffix(".py").is_file()
                found.add(f"{node.module}.{alias.name}" if module else str(node.module))
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("jointid")}
    return {module.removeprefix("jointid").removeprefix(".") for module in found}


def modules() -> dict[str, Path]:
    """Return every module of the package but the packages' own files, dotted."""
    files = {
        path.relative_to(PACKAGE).with_suffix("").as_posix().replace("/", "."): path for path in PACKAGE.rglob("*.py")
    }
    return {name: path for name, path in files.items() if name != "__init__"}


@pytest.mark.parametrize("module", sorted(modules()))
def test_imports_run_one_way(module: str) -> None:
    order = places()
    name = module.removesuffix(".__init__")
    if module.endswith(".__init__") and name not in {place.rstrip(".") for place in order}:
        return  # a room's own file only says what the room is
    here = position(name, order)
    for other in imports(modules()[module]):
        if other and other != name:  # the package itself has nothing but names that load lazily
            there = position(other, order)
            assert there < here or (there == here and order[here].endswith(".")), f"{module} imports {other}"


def test_every_room_of_the_picture_exists() -> None:
    for place in places():
        path = PACKAGE.joinpath(*place.rstrip(".").split("."))
        assert path.is_dir() if place.endswith(".") else path.with_suffix(".py").is_file(), place


@pytest.mark.parametrize(
    ("statement", "absent"),
    [
        ("import jointid", ("numpy", "scipy", "numba", "matplotlib", "pydantic", "cyclopts", "dataclasses")),
        ("import jointid.cli.app", ("numpy", "scipy", "numba", "matplotlib", "pydantic")),
        ("import jointid.jointfile", ("numba", "matplotlib", "scipy.signal", "scipy.optimize")),
        ("import jointid.assessment.validation", ("numba", "matplotlib", "scipy.signal", "scipy.optimize")),
    ],
)
def test_what_an_import_loads(statement: str, absent: tuple[str, ...]) -> None:
    program = f"import sys; {statement}; print([m for m in {absent!r} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("words", [["--help"], ["identify", "--help"], ["--version"]])
def test_help_loads_the_command_line_and_nothing_heavy(words: list[str]) -> None:
    program = (
        "import sys; import jointid.cli.app as cli; cli.app(sys.argv[1:], result_action='return_value'); "
        "print(*sorted({m.split('.')[0] for m in sys.modules}))"
    )
    found = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=True)
    loaded = set(found.stdout.splitlines()[-1].split())
    assert {"jointid", "cyclopts"} <= loaded
    assert not loaded & {"numpy", "scipy", "numba", "matplotlib", "pydantic", "tomli_w", "unittest"}


def test_every_public_name_can_be_loaded() -> None:
    import jointid

    for name in jointid.__all__:
        assert getattr(jointid, name).__doc__
    assert set(jointid.__all__) == set(jointid._HOME)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        jointid.nothing  # noqa: B018


def test_nothing_names_this_machine() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    forbidden = re.compile(r"/(?:home|root|Users)/\w|[A-Z]:\\\\Users")
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".txt"} and path.is_file():
            assert not forbidden.search(path.read_text(encoding="utf-8")), name
