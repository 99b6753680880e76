"""The notebooks are those of their pages; the build of the documentation runs them, in an empty folder."""

from __future__ import annotations

import json
import re
import sys

import pytest

from tests.docs.blocks import ROOT

sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import notebooks


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
