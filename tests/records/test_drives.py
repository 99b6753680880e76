"""Drives' own units and names: counts, per mille, ampere; the profiles of traces; what is missing or in doubt."""

import math
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.units import COUNTS, SHARE, unit
from jointid.config import loads
from jointid.records.columns import Column
from jointid.records.drives import Drive, index_columns, load_profile, place_of, profile_names
from jointid.records.record import CHANNELS, Tap, Timing, known_units

T = 1e-3
TIME = np.arange(400) * T
ANGLE = 0.5 * np.sin(8 * TIME)  # rad
TORQUE = 0.8 * np.cos(8 * TIME)  # N m
COUNTS_PER_TURN, RATED = 8192, 1.27
COUNTED = np.round(ANGLE / (2 * math.pi) * COUNTS_PER_TURN)
PER_MILLE = np.round(TORQUE / RATED * 1e3)


def trace(tmp_path: Path, name: str = "trace.csv", **columns: np.ndarray) -> Path:
    """Write a trace; a name with a word that Python has no letters for is given in a dictionary."""
    path = tmp_path / name
    rows = zip(*columns.values(), strict=True)
    lines = [";".join(columns), *(";".join(f"{float(value)!r}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_cia402_trace_needs_two_numbers(tmp_path: Path) -> None:
    path = trace(tmp_path, t=TIME, **{"0x6077": PER_MILLE, "0x6062": COUNTED, "0x6064": COUNTED})
    record = ji.read(path, drive=Drive("cia402", rated_torque=RATED, counts_per_turn=COUNTS_PER_TURN), kind="revolute")
    assert record.channels == ("torque", "reference", "motor_position")
    assert (record.torque.unit, record.torque.timing, record.tap) == ("N m", Timing.SAMPLED, Tap.MEASURED)
    np.testing.assert_allclose(record.torque.values, TORQUE, atol=RATED / 2e3 * 1.001)
    np.testing.assert_allclose(record.motor_position.values, ANGLE, atol=math.pi / COUNTS_PER_TURN * 1.001)


@pytest.mark.parametrize(
    "name", ["Torque actual value", "torque_actual_value", "TorqueActualValue", "Axis 3.6077h", "6077:00"]
)
def test_case_and_punctuation_of_a_name_do_not_matter(tmp_path: Path, name: str) -> None:
    path = trace(tmp_path, t=TIME, **{name: PER_MILLE})
    assert ji.read(path, drive=Drive("cia402", rated_torque=RATED), kind="revolute").channels == ("torque",)


def test_what_is_declared_wins(tmp_path: Path) -> None:
    path = trace(tmp_path, t=TIME, **{"0x6077": PER_MILLE, "0x6074": PER_MILLE, "enc": COUNTED})
    declared = {
        "torque": Column("0x6077", timing=Timing.AVERAGED, sign=-1),
        "motor_position": Column("enc", unit="mrad"),
    }
    record = ji.read(path, declared, drive=Drive("cia402", rated_torque=RATED), kind="revolute")
    assert (record.torque.timing, record.tap) == (Timing.AVERAGED, Tap.MEASURED)
    np.testing.assert_allclose(record.torque.values, -PER_MILLE / 1e3 * RATED)
    np.testing.assert_allclose(record.motor_position.values, COUNTED * 1e-3)


LOAD_COUNTS = 20_000


@pytest.mark.parametrize("ratio", [1.0, 50.0])
def test_two_encoders_have_their_own_counts(tmp_path: Path, ratio: float) -> None:
    """Behind a gear the counts of the motor's turn say nothing of the load's encoder: without its own it is refused."""
    gear = ji.Transmission(load="revolute", ratio=ratio)
    turned = np.round(ANGLE / ratio / (2 * math.pi) * LOAD_COUNTS)
    path = trace(tmp_path, t=TIME, motor=COUNTED, load=turned)
    columns = {"motor_position": Column("motor", unit="counts"), "load_position": Column("load", unit="counts")}
    one, two = (Drive(counts_per_turn=COUNTS_PER_TURN, load_counts_per_turn=own) for own in (None, LOAD_COUNTS))
    record = ji.read(path, columns, drive=two, kind="revolute", transmission=gear)
    for channel, step in ((record.motor_position, ratio * COUNTS_PER_TURN), (record.load_position, LOAD_COUNTS)):
        np.testing.assert_allclose(channel.values, ANGLE / ratio, atol=1.001 * math.pi / step)
    if ratio == 1.0:  # two encoders of one kind
        assert ji.read(path, columns, drive=one, kind="revolute", transmission=gear).load_position is not None
        return
    with pytest.raises(ji.RecordError, match="load_counts_per_turn"):
        ji.read(path, columns, drive=one, kind="revolute", transmission=gear)


def test_a_torque_constant_takes_ampere_to_newton_metres(tmp_path: Path) -> None:
    path = trace(tmp_path, t=TIME, i=TORQUE, q=ANGLE)
    columns = {"torque": Column("i", unit="mA")}
    record = ji.read(path, columns, drive=Drive(torque_constant=0.5), kind="revolute")
    assert record.torque.unit == "N m"
    np.testing.assert_allclose(record.torque.values, TORQUE * 0.5e-3)
    assert ji.read(path, columns, kind="revolute").torque.unit == "A"


def test_every_unit_of_a_drive_comes_out_in_si() -> None:
    drive = Drive(rated_torque=1.2, torque_constant=0.6, counts_per_turn=4096, counts_per_metre=1e6)
    assert drive.resolve_unit(unit("counts"), "revolute").factor == pytest.approx(2 * math.pi / 4096)
    assert drive.resolve_unit(unit("counts"), "prismatic").factor == pytest.approx(1e-6)
    assert drive.resolve_unit(unit("permille"), "revolute").factor == pytest.approx(1.2e-3)
    assert drive.resolve_unit(unit("%"), "prismatic").factor == pytest.approx(1.2e-2)
    assert drive.resolve_unit(unit("%"), "prismatic").si == "N"
    assert drive.resolve_unit(unit("deg"), "revolute") == unit("deg")
    for kind in ("prismatic", "revolute"):
        own = [name for channel in CHANNELS for name in known_units(channel, kind)]
        for name in own:
            assert drive.resolve_unit(unit(name), kind).dimension not in (COUNTS, SHARE)


def test_an_axis_of_several_is_found_by_its_number(tmp_path: Path) -> None:
    path = trace(tmp_path, t=TIME, **{f"AIPos.A{k}": np.degrees(k * ANGLE) for k in (1, 2, 3)})
    record = ji.read(path, drive=Drive("kuka", axis=2), kind="revolute")
    np.testing.assert_allclose(record.motor_position.values, 2 * ANGLE)
    with pytest.raises(ji.RecordError, match="the axis"):
        ji.read(path, drive=Drive("kuka"), kind="revolute")


@pytest.mark.parametrize("name", profile_names())
def test_a_profile_is_whole(name: str) -> None:
    profile = load_profile(name)
    assert profile.title
    assert all(profile.sources)
    assert all(text.endswith((".", '".')) for text in profile.assumed)
    place = place_of(2, "elbow")
    drive = Drive(name, 2, rated_torque=1.0, torque_constant=1.0, counts_per_turn=1000.0, counts_per_metre=1000.0)
    for channel, signals in profile.channels.items():
        assert channel in CHANNELS
        for signal in signals:
            known = known_units(channel, "revolute")
            stated = signal.unit is None or signal.unit.startswith("units of the ")  # that the user has to say
            assert stated or drive.resolve_unit(unit(signal.unit or ""), "revolute").si == unit(known[0]).si
            assert signal.tap is None or channel == "torque"
            for called in signal.names_on(place):
                # No name of one channel may be another's, or its own twice.
                same = [s for s in signals if called in s.names_on(place)]
                others = [c for c in profile.channels if profile.find(c, index_columns([called]), place)]
                assert (others, same) == ([channel], [signal]), called


def test_a_joint_file_with_a_profile_needs_no_channels(tmp_path: Path) -> None:
    path = trace(tmp_path, t=TIME, **{"6077h": PER_MILLE, "6062h": COUNTED, "6064h": COUNTED})
    text = """
        [joint]
        kind = "revolute"
        [drive]
        profile = "cia402"
        rated_torque = 1.27
        counts_per_turn = 8192
        """
    file = loads(text, tmp_path)
    assert file.joint.torque_unit is None
    assert file.record(path).channels == ("torque", "reference", "motor_position")
    alone = loads(text + '[method]\nname = "drive_side"\n', tmp_path)
    only_torque = trace(tmp_path, "other.csv", t=TIME, **{"6077h": PER_MILLE})
    with pytest.raises(ji.RecordError, match="knows as motor_position"):
        alone.record(only_torque)
