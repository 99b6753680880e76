"""The record of a joint file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.config import File, Run, load, loads
from jointid.estimation.problems.several_records import SeveralRecords
from tests.estimates import identify
from tests.joint_files import EXAMPLE, SMALLEST, told


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A short record in a folder below the joint file's."""
    time = np.arange(400) * 1e-3
    table = np.column_stack([time, 300 * np.sin(20 * time), 0.1 * np.sin(20 * time), 0.1 * np.sin(20 * time - 0.1)])
    (tmp_path / "runs").mkdir()
    np.savetxt(tmp_path / "runs" / "run.csv", table, delimiter=";", header="t;i;r;q", comments="")
    return tmp_path / "runs" / "run.csv"


def saved(folder: Path, text: str) -> File:
    (folder / "joint.toml").write_text(text, encoding="utf-8")
    return load(folder / "joint.toml")


def test_the_record_lies_beside_the_joint_file(run: Path) -> None:
    folder = run.parents[1]
    record = saved(folder, "[record]\nfile = 'runs/run.csv'\ndelimiter = ';'\n" + SMALLEST).record()
    assert record.channels == ("torque", "reference", "motor_position")
    assert record.name == "run"
    assert saved(folder, SMALLEST).record(run).channels == record.channels
    with pytest.raises(
        RecordError, match=r"joint.toml names no record in \[record\]; add file to it, or name one by --record"
    ):
        saved(folder, SMALLEST).record()


def test_a_channel_that_the_method_does_not_need_may_be_absent(run: Path) -> None:
    without_motor = SMALLEST.replace('"q"', '"nowhere"')
    assert loads(without_motor).record(run).channels == ("torque", "reference")
    with pytest.raises(RecordError, match=r'has no column "nowhere" \(for motor_position\)'):
        loads(without_motor, changes=["method.name=idim"]).record(run)
    without_reference = SMALLEST.replace('"r"', '"nowhere"')
    assert loads(without_reference, changes=["method.name=idim"]).record(run).channels == ("torque", "motor_position")
    with pytest.raises(RecordError, match=r'has no column "nowhere" \(for reference\)'):
        loads(without_reference).record(run)


def test_an_injected_signal_may_be_absent_only_if_it_is_optional(run: Path) -> None:
    injected = SMALLEST.replace("[controller]", 'injected = { column = "x" }\n[controller]')
    with pytest.raises(RecordError, match=r'has no column "x" \(for injected\)'):
        loads(injected).record(run)
    optional = injected.replace('"x"', '"x", optional = true')
    assert loads(optional).record(run).injected is None


def test_a_torque_beyond_the_limit_is_refused(run: Path) -> None:
    limited = loads(SMALLEST + "gain = 2.0\nlimit = 100.0")
    with pytest.raises(RecordError):
        limited.record(run)
    assert loads(SMALLEST + "gain = 2.0\nlimit = 160.0").record(run).torque is not None


def test_the_emps_file_serves_both_records(data_dir: Path) -> None:
    file = load(EXAMPLE)
    channels = ("torque", "reference", "motor_position")
    first = file.record(data_dir / "emps" / "DATA_EMPS.mat")
    second = file.record(data_dir / "emps" / "DATA_EMPS_PULSES.mat")
    assert first.channels == channels
    assert second.channels == (*channels, "injected")
    assert second.injected is not None
    assert second.injected.channel.values.max() == pytest.approx(5.07 * 35.15, rel=1e-3)
    assert file.loop is not None
    estimate = identify(first, file.loop, file.method, filtering=file.filtering, parameters=file.parameters)
    found = {parameter.name: parameter.value for parameter in estimate.params.rows}
    assert found["inertia"] == pytest.approx(95.4, abs=0.1)
    assert found["viscous"] == pytest.approx(210.0, abs=0.5)
    assert found["coulomb"] == pytest.approx(19.9, abs=0.1)
    assert found["offset"] == pytest.approx(-3.17, abs=0.02)
    assert estimate.fit.relative_error == pytest.approx(0.0454, abs=2e-4)


# Several records


SEVERAL = """
[[records]]
file = "a.csv"

[[records]]
file = "b.csv"
added_inertia = 10.0
own = ["coulomb"]

[together]
free = ["drive_gain"]
"""


def test_several_records(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = run.parents[1]
    file = saved(folder, "[record]\ndelimiter = ';'\n" + SMALLEST + SEVERAL.replace("a.csv", "runs/run.csv"))
    assert file.runs == (Run("runs/run.csv"), Run("b.csv", 10.0, ("coulomb",)))
    assert file.together == ("drive_gain",) and file.only_lists
    with pytest.raises(RecordError, match=r"b\.csv"):
        file.identify_together()
    (folder / "b.csv").write_bytes(run.read_bytes())
    asked = list[SeveralRecords]()
    monkeypatch.setattr(File, "identify", lambda *_, several, **__: asked.append(several))
    other = folder / "other.csv"
    other.write_bytes(run.read_bytes())
    for paths in ((), (other, folder / "runs" / ".." / "b.csv")):  # one is known by its path
        file.identify_together(paths)
    both = {"added_inertia": [0.0, 10.0], "own": [(), ("coulomb",)], "free": ("drive_gain",)}
    assert asked == [both, both]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SEVERAL.replace('"coulomb"', '"colomb"'), "records.2.own unknown"),
        (SEVERAL.replace('file = "a.csv"', ""), "records.1.file missing"),
        (SEVERAL.replace("10.0", "-10.0"), "records.2.added_inertia value"),
        ("records = 3\n", "records value"),
    ],
)
def test_a_fault_of_several_records_has_its_place(text: str, said: str) -> None:
    assert told(text + SMALLEST if text.startswith("records") else SMALLEST + text) == [said]
