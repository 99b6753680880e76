"""No command writes over what it reads, and files are written whole."""

import errno
import itertools
import os
import re
import stat
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli.console import spare
from jointid.common.errors import RecordError
from jointid.common.files import beside, write_folder, write_whole
from jointid.config import loads
from jointid.records.formats import Table, write_table
from tests.joint_files import EXAMPLE as EMPS
from tests.losses.runs import contents
from tests.rigid_axis import run

OUTPUTS: dict[str, tuple[str, dict[str, str]]] = {
    "campaign": ("campaign.toml", {"--out": "x", "--html": "x.html"}),
    "compare": ("estimate.json other.json", {"--json": "x.json"}),
    "learn-controller": ("joint.toml", {"--json": "x.json", "--write": "x.toml"}),
    "inspect": ("record.csv", {"--json": "x.json", "--write": "x.toml"}),
    "demo": ("", {"FOLDER": "x"}),
    "design": ("joint.toml", {"--json": "x.json", "--out": "x"}),
    "diagnose": ("joint.toml", {"--json": "x.json"}),
    "export": ("joint.toml", {"--out": "x.urdf"}),
    "identify": ("joint.toml", {"--json": "x.json", "--figure": "x.png"}),
    "payload": ("joint.toml --without a.csv --with b.csv", {"--json": "x.json"}),
    "report": ("joint.toml", {"--html": "x.html", "--json": "x.json"}),
    "reproduce": ("", {"--out": "x"}),
    "serve": ("", {"--folder": "x"}),
    "simulate": ("joint.toml", {"--json": "x.json", "--out": "x.csv"}),
    "tune": ("joint.toml", {"--json": "x.json"}),
    "validate": ("joint.toml --record other.csv", {"--json": "x.json"}),
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A joint file that names a record, which has other names, too: a link that ends in .png, and another in .html."""
    text = EMPS.read_text(encoding="utf-8")
    (tmp_path / "joint.toml").write_text(text.replace("DATA_EMPS.mat", "record.csv"), encoding="utf-8")
    write_table(tmp_path / "record.csv", Table({"t": np.arange(9) * 1e-3, "vir": np.ones(9), "qg": np.zeros(9)}))
    for name in ("other.csv", "estimate.json", "other.json"):
        (tmp_path / name).write_text("{}", encoding="utf-8")
    os.link(tmp_path / "record.csv", tmp_path / "link.png")
    (tmp_path / "page.html").symlink_to("record.csv")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="links")
@pytest.mark.parametrize("command", OUTPUTS)
def test_no_command_writes_over_what_it_reads(command: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.config.file.File.record", lambda *_, **__: pytest.fail("the work has begun"))
    given, outputs = OUTPUTS[command]
    words, before = given.split(), contents(place)
    read = {word for word in words if (place / word).is_file()}
    if "joint.toml" in read:  # the record is named in it, and has other names
        read |= {"record.csv", "link.png", "page.html"}
    files = [option for option, made in outputs.items() if "." in made]
    for option, path in itertools.product(files, read):
        assert run(command, *words, option, path) == 2, (option, path)
        assert contents(place) == before, (option, path)


@pytest.mark.skipif(sys.platform == "win32", reason="rights and links")
def test_what_is_replaced_keeps_its_rights_and_a_link_stays(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text("old", encoding="utf-8")
    (tmp_path / "old.json").chmod(0o640)
    (tmp_path / "link.json").symlink_to("old.json")
    write_whole(tmp_path / "link.json", "new ±\udcff")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "old.json").read_bytes() == "new ±\\udcff".encode()
    assert stat.S_IMODE((tmp_path / "old.json").stat().st_mode) == 0o640
    write_whole(tmp_path / "fresh.json", b"")
    (tmp_path / "plain").touch()
    assert (tmp_path / "fresh.json").stat().st_mode == (tmp_path / "plain").stat().st_mode
    write_whole("/dev/null", b"gone")
    assert not Path("/dev/null").is_file()
    with pytest.raises(RecordError, match="cannot be written"):
        write_whole(tmp_path, b"a folder")


@pytest.mark.parametrize(("columns", "read"), [
    ("iq set [A];Lage-Soll [°];Rest", "rad"), ("Moment [Nm];Lage-Soll [mm];Rest", "m"),
    ("Torque setpoint (Nm);Position setpoint (mm);R", "m"), ("Torque x (Nm);Position setpoint (mm);measured (mm)", "m"),
])  # fmt: skip
def test_a_log_of_nobody_has_a_joint_file_to_complete(place: Path, columns: str, read: str) -> None:
    (place / "own.csv").write_text(f"Zeit [ms];{columns}\n0;1,5;0,5;0,5\n1;2,5;1,0;1,0\n", encoding="cp1252")
    assert run("inspect", "own.csv", "--write", "own.toml") == 0
    said = Path("own.toml").read_text("utf-8")
    if read == "m":
        with pytest.raises(ji.RecordError, match="the lead of the transmission"):
            loads(said).record()
    file = loads(re.sub(r"(?m)^# (?=\w+ =|\[)", "", said).replace("?", "1"))  # what it asks, answered
    record, joint = file.record(), file.joint
    assert (record.torque.values / joint.transmission.torque("motor")).tolist() == pytest.approx([1.5, 2.5])
    assert (joint.model, record.reference.unit, record.remarks) == ("flexible", read, ())
    assert file.controller.velocity_filter is not None


def test_half_a_result_is_never_seen(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text("old", encoding="utf-8")
    for error in (KeyboardInterrupt, OSError(28, "No space left on device")):
        with pytest.raises((KeyboardInterrupt, RecordError)), beside(tmp_path / "old.json") as fresh:
            fresh.write_text("half", encoding="utf-8")
            raise error
        assert contents(tmp_path) == {"old.json": b"old"}
    assert [path.name for path in write_folder(tmp_path / "a" / "b", {"x": b"1", "y": b"2"})] == ["x", "y"]
    write_folder(tmp_path / "a" / "b", {"x": b"3"})
    assert contents(tmp_path / "a") == {"b/x": b"3", "b/y": b"2"}
    assert not list(tmp_path.rglob(".jointid-*"))


def test_what_takes_nothing_is_refused_before_anything_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The administrator may write everywhere, so that the system's answer for a file is made up."""
    (tmp_path / "mine.json").write_text("{}")
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path / "mine.json")
    for refused in (tmp_path / "mine.json", tmp_path, tmp_path / "none" / "x.json"):
        with pytest.raises(RecordError):
            spare([refused])
    spare([Path(os.devnull), None])


@pytest.mark.parametrize("reason", [errno.ENOSPC, errno.EACCES])
@pytest.mark.parametrize("command", OUTPUTS)
def test_an_output_that_cannot_be_written_is_refused_before_anything_runs(
    command: str, reason: int, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A full disk takes no byte, a folder that is closed or read-only takes nothing."""
    there, (given, outputs) = contents(place), OUTPUTS[command]
    monkeypatch.setattr(Path, "write_bytes", Mock(side_effect=OSError(reason, os.strerror(reason))))
    for option, path in outputs.items():
        assert run(*f"{command} {given} {option if option.startswith('-') else ''} {path}".split()) == 2
        printed = capsys.readouterr()
        assert f"cannot be written ({os.strerror(reason).lower()})" in printed.err, option
        assert printed.out == "", option
        assert contents(place) == there, option
