"""The pictures of docs/images that show the program at work, made by the program.

JOINTID_DATA=FOLDER python docs/_ext/pictures.py        makes them again; needs a Chromium, and the records in FOLDER
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from jointid.apps.cli import main

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"


def run(*words: object) -> None:
    """Run a command of the program."""
    try:
        main([str(word) for word in words])
    except SystemExit as end:
        if end.code:
            raise


def figure(record: Path) -> None:
    """Measured, simulated and error force of the EMPS axis."""
    run("identify", ROOT / "examples/emps/joint.toml", "--record", record, "--figure", IMAGES / "emps.png", "-q")


def web_page(folder: Path) -> None:
    """Two steps of the page in the browser, as its test comes by them."""
    test = "tests/apps/web/test_in_the_browser.py::test_emps_end_to_end"
    words = [sys.executable, "-m", "pytest", "-q", "-m", "browser", "-n", "0", "-p", "no:cacheprovider", test]
    subprocess.run(words, cwd=ROOT, env=os.environ | {"JOINTID_SHOTS": str(folder)}, check=True)  # noqa: S603
    saved(folder / "1280-2-channels.png", "page-channels.png", 800, 831)
    saved(folder / "1280-5-answer.png", "page-report.png", 800, 620)


def saved(picture: Path, name: str, width: int, height: int | None = None) -> None:
    """Save the upper part of a picture at that width, in few colours."""
    with Image.open(picture) as opened:
        scaled = opened.convert("RGB").resize(
            (width, round(opened.height * width / opened.width)), Image.Resampling.LANCZOS
        )
        scaled.crop((0, 0, width, min(height or scaled.height, scaled.height))).quantize(128).save(
            IMAGES / name, optimize=True
        )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        emps = Path(os.environ["JOINTID_DATA"]) / "emps" / "DATA_EMPS.mat"
        figure(emps)
        web_page(Path(scratch))
