"""The notebooks are those of their pages, and run from an empty folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.blocks import ROOT

sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import notebooks

SHELL = "import subprocess\ndef shell(command):\n    subprocess.run(command, shell=True, check=True)\n"


@pytest.mark.parametrize("name", notebooks.NOTEBOOKS)
def test_a_notebook_is_its_page_with_the_files_that_it_needs(name: str) -> None:
    saved = (notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
    assert notebooks.write(name) == saved, "write it again: python docs/_ext/notebooks.py"
    cells = json.loads(saved)["cells"]
    texts = ["".join(cell["source"]) for cell in cells]
    assert texts[0].startswith("# ")
    assert texts[1].startswith("%pip install")
    assert not any("](.." in text or "](#" in text for text in texts), "a link that leads nowhere"
    code = "\n".join(text for cell, text in zip(cells, texts, strict=True) if cell["cell_type"] == "code")
    for path in re.findall(r"^!.*?(examples/[\w/.-]+)", code, re.MULTILINE):
        assert f"%%writefile {path}\n" in code


@pytest.mark.docs
@pytest.mark.parametrize("name", notebooks.NOTEBOOKS)
def test_a_notebook_runs(name: str, tmp_path: Path) -> None:
    if name == "actuator":
        pytest.importorskip("mujoco", reason="the log is made by MuJoCo, which is not installed")
    cells = json.loads((notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    program = SHELL + "".join(plain("".join(c["source"])) for c in cells if c["cell_type"] == "code")
    place = str(Path(sys.executable).parent)
    environment = {**os.environ, "MPLBACKEND": "agg", "PATH": place + os.pathsep + os.environ["PATH"]}
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert {"own-axis": "stiffness", "emps": "inertia", "actuator": "Stiffness"}[name] in ran.stdout


def plain(cell: str) -> str:
    """Return a cell as Python: its commands of a shell as calls, a file that it writes as a string."""
    if cell.startswith("%pip "):
        return ""
    if cell.startswith("%%writefile "):
        name, _, text = cell.removeprefix("%%writefile ").partition("\n")
        return f"open({name!r}, 'w', encoding='utf-8').write({text!r})\n"
    return re.sub(r"^( *)!(.*)$", lambda line: f"{line[1]}shell({line[2]!r})", cell, flags=re.MULTILINE) + "\n"
