"""`jointid doctor` tells the shape of a record and none of its data."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from jointid import __version__
from jointid.apps.cli import main

JOINT = """
[joint]
kind = "prismatic"
model = "rigid"

[record]
file = "secret-customer.csv"
time = "clock"

[record.channels]
torque = { column = "hidden force [N]" }
motor_position = { column = "hidden place [mm]" }

[method]
name = "idim"
"""


@pytest.fixture
def joint(tmp_path: Path) -> Path:
    time = 2e-3 * np.arange(400)
    columns = np.column_stack([time, 71.53 * np.cos(9 * time), 39.17 * np.sin(9 * time)])
    header = "clock,hidden force [N],hidden place [mm]"
    np.savetxt(tmp_path / "secret-customer.csv", columns, delimiter=",", header=header, comments="", fmt="%.9g")
    (tmp_path / "joint.toml").write_text(JOINT, encoding="utf-8")
    return tmp_path / "joint.toml"


def test_the_report_has_the_shape_of_the_record_and_nothing_of_it(
    joint: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["doctor", str(joint), "--json", str(joint.with_name("doctor.json"))])
    assert end.value.code == 0
    text = joint.with_name("doctor.json").read_text(encoding="utf-8")
    assert json.loads(capsys.readouterr().out) == json.loads(text)
    found = json.loads(text)
    assert found["packages"]["jointid"] == __version__
    assert found["packages"]["numpy"] == np.__version__
    (axis,) = found["record"]
    assert axis["torque"] == {"unit": "N", "samples": 400, "sample_time": pytest.approx(2e-3)}
    assert axis["motor_position"]["unit"] == "m"
    for secret in ("secret", "hidden", "clock", "71.5", str(joint.parent)):
        assert secret not in text
    numbers = [value for value in _leaves(found["record"]) if isinstance(value, float)]
    assert numbers == [pytest.approx(2e-3)] * 2, "the sample times alone"


def test_a_source_tree_that_is_not_installed_has_its_version(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def find(name: str) -> metadata.Distribution:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", find)
    with pytest.raises(SystemExit) as end:
        main(["doctor"])
    assert end.value.code == 0
    assert json.loads(capsys.readouterr().out)["packages"] == {"jointid": __version__}


def _leaves(thing: object) -> list[object]:
    inner = list(thing.values()) if isinstance(thing, dict) else thing if isinstance(thing, list) else None
    return [thing] if inner is None else [leaf for one in inner for leaf in _leaves(one)]
