"""Three pages as notebooks that run by themselves, in Jupyter or Colab, with the release of this version.

python docs/_ext/notebooks.py        writes them again; a test holds them to the pages
"""

from __future__ import annotations

import json
import os
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tools.metadata import published  # noqa: E402

FOLDER = ROOT / "examples" / "notebooks"

EMPS_RECORDS = """from pathlib import Path

if not Path("DATA_EMPS.mat").exists():  # simulated records in the place of the real ones, which you may upload
    !python examples/emps/make_records.py
    Path("like-emps.mat").rename("DATA_EMPS.mat")
    Path("like-emps-pulses.mat").rename("DATA_EMPS_PULSES.mat")
"""

NOTEBOOKS: dict[str, tuple[str, str, tuple[str, ...], str]] = {
    "own-axis": ("docs/notebooks/own-axis.md", "jointid", (), ""),
    "emps": (
        "examples/emps/README.md", "jointid", ("examples/emps/joint.toml", "examples/emps/make_records.py"),
        EMPS_RECORDS,
    ),
    "actuator": (
        "examples/actuator/README.md", "jointid[robots]", ("examples/actuator/servo.toml", "examples/actuator/make.py"),
        "",
    ),
}  # fmt: skip
"""By name the page, what is installed, the files of the repository that it needs, and a cell before all others."""

_BLOCK = re.compile(
    r"^(?:<!-- not run: [^\n]+ -->\n)?```(?P<language>[^\n]*)\n(?P<text>.*?)^```\n", re.MULTILINE | re.DOTALL
)
_RELATIVE = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")
_WITHIN = re.compile(r"\[([^\]]+)\]\(#[^)]*\)")


def write(name: str) -> str:
    """Return a notebook as JSON."""
    source, needed, files, first = NOTEBOOKS[name]
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    version, repository = settings["project"]["version"], settings["tool"]["jointid"]["repository"]
    cells = [("code", f'%pip install -q "{needed}=={version}"')]
    if files:
        cells.append(("code", f'import os\n\nos.makedirs("{Path(files[0]).parent.as_posix()}", exist_ok=True)'))
    for path in files:
        cells.append(("code", f"%%writefile {path}\n{(ROOT / path).read_text(encoding='utf-8')}"))
    cells += [("code", first)] if first else []
    text = _find_links((ROOT / source).read_text(encoding="utf-8"), (ROOT / source).parent)
    title, *rest = _cells(published(text, repository and f"{repository}/{{}}/v{version}"))
    made = [_cell(number, *cell) for number, cell in enumerate((title, *cells, *rest))]
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    document = {"cells": made, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(document, ensure_ascii=False, indent=1) + "\n"


def _find_links(text: str, here: Path) -> str:
    """Return a page without its header, with links from the root; those within the page are text."""
    text = re.sub(r"\A---\n.*?\n---\n+", "", text, flags=re.DOTALL)
    text = _RELATIVE.sub(lambda link: f"]({Path(os.path.relpath(here / link[1], ROOT)).as_posix()}", text)
    return _WITHIN.sub(r"\1", text)


def _cells(text: str) -> list[tuple[str, str]]:
    """Return the kind and the text of each cell; what a page shows as printed is left out."""
    cells, at = list[tuple[str, str]](), 0
    for block in _BLOCK.finditer(text):
        language, runs = block["language"], not block[0].startswith("<!--")
        if runs and language != "toml":
            cells.append(("markdown", text[at : block.start()]))
            at = block.end()
            if language:
                command = "!" if language == "sh" else ""
                cells.append(("code", re.sub(r"^(?=.)", command, block["text"], flags=re.MULTILINE)))
    cells.append(("markdown", text[at:]))
    return [(kind, cell) for kind, cell in cells if cell.strip()]


def _cell(number: int, kind: str, text: str) -> dict[str, Any]:
    own = {"execution_count": None, "outputs": []} if kind == "code" else {}
    lines = text.strip("\n").splitlines(keepends=True)
    return {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, **own, "source": lines}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in NOTEBOOKS:
        (FOLDER / f"{name}.ipynb").write_text(write(name), encoding="utf-8")
