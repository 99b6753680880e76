"""The container file: built and run where a builder is there, else read."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "Containerfile").read_text(encoding="utf-8")
LARGEST = 600e6  # bytes
INSTRUCTIONS = {"FROM", "ENV", "WORKDIR", "COPY", "RUN", "USER", "EXPOSE", "ENTRYPOINT", "CMD"}


def test_the_container_file_copies_what_is_there_and_ends_as_a_user() -> None:
    lines = [line for line in TEXT.replace("\\\n", " ").splitlines() if line and not line.startswith("#")]
    instructions = [line.split(" ", 1) for line in lines]
    assert {name for name, _ in instructions} <= INSTRUCTIONS
    seen = {line.removeprefix("!") for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()}
    for name, words in instructions:
        if name == "COPY" and not words.startswith("--from"):
            for source in words.split()[:-1]:
                assert (ROOT / source).exists()
                assert source in seen, "the builder would not be given it"
    names = [words.split()[-1] for name, words in instructions if name == "FROM" and " AS " in words]
    assert all(stage in names for stage in re.findall(r"--from=(\w+)", TEXT))
    assert [words for name, words in instructions if name == "USER"] == ["1000"]
    assert 'ENTRYPOINT ["jointid"]' in TEXT


@pytest.mark.slow
def test_the_image_runs_the_command_and_is_small() -> None:
    builder = next((name for name in ("docker", "podman", "buildah") if works(name)), None)
    if builder is None:
        pytest.skip("no builder of images is there")
    (base,) = set(re.findall(r"^FROM (\S+)", TEXT, re.MULTILINE))
    if subprocess.run([builder, "pull", "-q", base], capture_output=True, check=False).returncode != 0:
        pytest.skip(f"{base} cannot be fetched")
    subprocess.run([builder, "build", "-t", "jointid-test", "-f", "Containerfile", "."], cwd=ROOT, check=True)
    try:
        said = subprocess.run(
            [builder, "run", "--rm", "jointid-test", "--version"], check=True, capture_output=True, text=True
        )
        assert re.search(r"\d+\.\d+\.\d+", said.stdout)
        shown = subprocess.run(
            [builder, "image", "inspect", "--format", "{{.Size}}", "jointid-test"],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        assert int(shown.stdout) < LARGEST
    finally:
        subprocess.run([builder, "rmi", "jointid-test"], check=False)


def works(builder: str) -> bool:
    return (
        shutil.which(builder) is not None
        and subprocess.run([builder, "info"], capture_output=True, check=False).returncode == 0
    )
