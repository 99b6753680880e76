"""The commands and programs of docs/exports.md run, in their order."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import jointid as ji
from jointid.apps.cli.app import main
from jointid.output.export import LANGUAGES

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "exports.md").read_text(encoding="utf-8")


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("control")
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^jointid (.*)$", PAGE, re.MULTILINE)
    assert len(commands) == 4
    for command in commands:
        with pytest.raises(SystemExit) as end:
            main(command.split())
        assert end.value.code == 0, command
    programs = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(programs) == 3
    for program in programs:
        exec(compile(program, "exports.md", "exec"), {})
    assert "lost in mjcf: true sticking" in capsys.readouterr().out
    assert not any(p.free for p in ji.load("fixed.toml").parameters.values())
    assert ji.load("filled.toml").values()["stiffness"] == pytest.approx(8e5, rel=0.02)


def test_the_page_has_every_language_with_its_endings() -> None:
    for made in LANGUAGES:
        endings = ", ".join(f"`{suffix}`" for suffix in made.suffixes)
        assert f"| {endings} | `{made.name}` |" in PAGE
