"""What is written is read back by the same columns, units, signs, clock and profile; what would not be is refused."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.records.drives import Drive, profile_names
from jointid.records.formats import read_table
from jointid.records.record import Channel, Injection, Record, Tap, Timing

T = 1e-3
TIME = np.arange(500) * T
GEAR = ji.Transmission(load="revolute", ratio=30.0, sign=-1)
NUMBERS: dict[str, Any] = {"rated_torque": 1.27, "counts_per_turn": 2**20, "load_counts_per_turn": 2**17}


def made(tap: Tap = Tap.COMMAND) -> Record:
    position = Channel(3.0 + np.sin(8 * TIME), "rad", T, source="made")
    return Record(
        torque=Channel(np.cos(8 * TIME), "N m", T, Timing.HELD),
        tap=tap,
        reference=position,
        motor_position=Channel(position.values + 1e-3 * np.cos(50 * TIME), "rad", T),
        load_position=Channel(position.values - 2e-3 * np.cos(50 * TIME), "rad", T),
        injected=Injection(Channel(0.1 * np.sign(np.sin(30 * TIME)), "N m", T, Timing.HELD)),
    )


def same(one: Record, other: Record, names: tuple[str, ...]) -> None:
    for name in names:
        expected, found = dict(one.items())[name], dict(other.items())[name]
        assert (found.unit, found.sample_time) == (expected.unit, pytest.approx(T, rel=1e-12))
        np.testing.assert_allclose(found.values, expected.values, rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("transmission", [None, GEAR], ids=["direct", "geared"])
@pytest.mark.parametrize("tap", [Tap.COMMAND, Tap.MEASURED])
@pytest.mark.parametrize("profile", profile_names())
def test_a_profile_reads_back_what_is_written_for_it(
    profile: str, tap: Tap, transmission: ji.Transmission | None, tmp_path: Path
) -> None:
    """Each channel that it knows, under a name, in a unit and on a side that it finds; the torque's tap as well."""
    drive = Drive(profile, axis=2, joint="elbow", **NUMBERS)
    record = made(tap)
    record = record if tap is Tap.COMMAND else record.without("injected")
    said: dict[str, Any] = {"drive": drive, "kind": "revolute", "transmission": transmission}
    in_ampere = (profile == "generic" and tap is Tap.MEASURED) or profile in ("epos", "ur-rtde")
    columns = {"torque": ji.Column(unit="N m")} if in_ampere else {}
    if profile == "lerobot":  # whose files do not state units
        columns = {"torque": ji.Column(unit="N m")} | {
            n: ji.Column(unit="deg") for n in ("reference", "motor_position")
        }
    ji.write(record, tmp_path / "run.csv", columns, **said)
    found = ji.read(tmp_path / "run.csv", columns, **said)
    known = tuple(name for name in record.channels if drive.traces is not None and name in drive.traces.channels)
    assert {"reference", "motor_position"} <= set(known) <= set(found.channels)
    traces = drive.traces
    same(record, found, known)
    taps = {signal.tap for signal in traces.channels.get("torque", ())} if traces is not None else set()
    if len(taps) > 1:  # others know a measured torque alone
        assert found.tap is tap


@pytest.mark.parametrize(
    ("said", "line"),
    [
        ({}, "t,tau [mN m],r,q,p,f"),
        ({"time": "stamp [ms]"}, "stamp [ms],tau [mN m],r,q,p,f"),
        ({"time": "ticks", "time_unit": "us", "delimiter": ";"}, "ticks;tau [mN m];r;q;p;f"),
        ({"sample_time": T, "decimal": ","}, "tau [mN m];r;q;p;f"),
        ({"sample_time": T, "delimiter": " "}, '"tau [mN m]" r q p f'),
    ],
)
def test_columns_units_signs_and_the_clock_are_those_declared(said: dict[str, Any], line: str, tmp_path: Path) -> None:
    columns: dict[str, str | ji.Column] = {
        "torque": ji.Column("tau [mN m]", sign=-1),
        "reference": ji.Column("r", unit="deg", side="load"),
        "motor_position": ji.Column("q", unit="counts", wrap=4096),
        "load_position": ji.Column("p", unit="deg", gain=0.1, wrap=3600.0),
        "injected": ji.Column("f", unit="N m", side="load"),
    }
    drive = Drive(counts_per_turn=4096)
    said = {"drive": drive, "kind": "revolute", "transmission": GEAR, **said}
    record = made()
    ji.write(record, tmp_path / "run.csv", columns, **said)
    found = ji.read(tmp_path / "run.csv", columns, **said)
    same(record, found, record.channels)
    text = (tmp_path / "run.csv").read_text(encoding="utf-8")
    assert text.splitlines()[0] == line
    options = {key: said[key] for key in ("delimiter", "decimal") if key in said}
    assert np.ptp(read_table(tmp_path / "run.csv", **options).columns["q"]) <= 4096 < 4096 * 30 * 2 / (2 * math.pi)


def test_numbered_columns_are_written_in_their_order(tmp_path: Path) -> None:
    record = made().without("load_position", "injected", "motor_position")
    columns = {"torque": "3", "reference": "2"}
    said: dict[str, Any] = {"time": "1", "kind": "revolute", "header": False}
    ji.write(record, tmp_path / "run.csv", columns, **said)
    same(record, ji.read(tmp_path / "run.csv", columns, **said), record.channels)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"reference": "x", "motor_position": "x"}, {}), ({"reference": "t"}, {}), ({}, {"sample_time": 2e-3}),
        ({"torque": ji.Column("i", unit="A")}, {}), ({"torque": "i"}, {"delimiter": ",", "decimal": ","}),
    ],
)  # fmt: skip
def test_what_would_not_come_back_is_refused(
    columns: dict[str, str | ji.Column], said: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.raises(ji.RecordError):
        ji.write(made(), tmp_path / "run.csv", columns, kind="revolute", **said)
    assert list(tmp_path.iterdir()) == []
