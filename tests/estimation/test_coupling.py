"""Other axes that moved: found by their number, warned of, and how much of the residual follows them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.record_warnings import coupling_warnings
from jointid.records.drives import Drive
from jointid.records.formats import Table, write_table
from jointid.records.reading import find_other_axes, read
from jointid.uncertainty.residual_tests import coupling

T = 1e-3
TIME = np.arange(20_000) * T
COLUMNS = {"torque": ji.Column("tau1"), "motor_position": ji.Column("q1")}


def wandering(seed: int) -> np.ndarray:
    """Return a motion of many slow sines, (samples,)."""
    rng = np.random.default_rng(seed)
    frequencies, phases = rng.uniform(0.2, 3.0, 40), rng.uniform(0, 2 * np.pi, 40)
    return 0.2 * np.sum(np.sin(2 * np.pi * np.outer(frequencies, TIME) + phases[:, np.newaxis]), axis=0)


def acceleration(position: np.ndarray) -> np.ndarray:
    return np.gradient(np.gradient(position, T), T)


def recorded(tmp_path: Path, shared: float, gravity: float, noise: float = 0.3) -> ji.Record:
    """Return a record of axis 1 beside an axis 2, which shares inertia with it and hangs on it."""
    q1, q2 = wandering(1), wandering(2)
    torque = 0.5 * acceleration(q1) + 0.2 * np.gradient(q1, T) + shared * acceleration(q2) + gravity * q2
    torque += noise * wandering(3)
    columns = {"t": TIME, "tau1": torque, "q1": q1, "tau2": 0.1 * torque, "q2": q2, "q3": 1e-3 * q2}
    write_table(tmp_path / "run.mat", Table(columns))
    return read(tmp_path / "run.mat", COLUMNS, kind="revolute")


def warned(record: ji.Record) -> str:
    estimate = ji.identify(record, ji.RigidJoint("revolute"))
    (said,) = (text for text in estimate.checks.warnings if text.startswith("other axes moved too"))
    assert said == coupling_warnings(record, estimate)[0]
    return said


def numbers(said: str) -> tuple[float, float]:
    share, chance = re.findall(r"(\d+) % of what it leaves follows .* up to (\d+) % would by chance", said)[0]
    return float(share), float(chance)


def test_coupling_is_found_and_sized(tmp_path: Path) -> None:
    said = warned(recorded(tmp_path, shared=0.05, gravity=0.5))
    share, chance = numbers(said)
    assert "(q2)" in said  # q3 is held
    assert share > 60 > 30 > chance
    assert "cannot tell" not in said


def test_an_axis_that_only_moves_is_named_too(tmp_path: Path) -> None:
    said = warned(recorded(tmp_path, shared=0.0, gravity=0.0))
    share, chance = numbers(said)
    assert share <= chance < 30
    assert "so this record cannot tell how much is theirs" in said


def test_an_axis_alone_is_not_warned_of(tmp_path: Path) -> None:
    record = recorded(tmp_path, shared=0.0, gravity=0.0)
    alone = ji.identify(
        ji.Record(torque=record.torque, motor_position=record.motor_position), ji.RigidJoint("revolute")
    )
    assert not any("other axes" in text for text in alone.checks.warnings)


@pytest.mark.parametrize(
    ("channels", "names", "expected"),
    [
        (("i[0]", "q[0]"), ("i[0]", "i[1]", "q[0]", "q[1]", "q[2]"), ("q[1]", "q[2]")),
        (("rec.tau_2", "rec.q_2"), ("rec.tau_1", "rec.tau_2", "rec.q_1", "rec.q_2", "x_3"), ("rec.q_1",)),
        (("data[1]", "data[0]"), ("data[0]", "data[1]", "data[2]"), ()),  # one matrix: its columns may be anything
        (("i[0]", "q"), ("i[0]", "i[1]", "q"), ()),
        (("6077h", "6064h"), ("6062h", "6064h", "6077h"), ()),
    ],
)
def test_which_columns_are_other_axes(
    channels: tuple[str, str], names: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    torque, position = channels
    assert find_other_axes({"torque": torque, "motor_position": position}, names) == expected


def test_the_load_of_this_axis_is_no_other_axis() -> None:
    columns = {"torque": "i[0]", "motor_position": "q[0]", "load_position": "q[1]"}
    assert find_other_axes(columns, ("i[0]", "i[1]", "q[0]", "q[1]")) == ()


def test_chance_is_that_of_motions_that_have_nothing_to_do_with_each_other() -> None:
    """In 95 of 100 cases no more is explained than by chance; slow motions explain much of each other."""
    rng = np.random.default_rng(0)
    slow = np.convolve(rng.normal(size=100_000), np.ones(20) / 20, "valid")
    rows = slow[: slow.size // 300 * 300].reshape(-1, 300)
    found = [coupling(rows[3 * k], rows[3 * k + 1 : 3 * k + 3].T) for k in range(len(rows) // 3)]
    assert 0.85 <= np.mean([not one.seen for one in found]) <= 0.99
    assert np.mean([one.by_chance for one in found]) > 0.1
    exact = coupling(rows[0], rows[:2].T)
    assert exact.explained == pytest.approx(1.0)
    assert coupling(np.zeros(50), rows[:2, :50].T).seen is False


@pytest.mark.parametrize("name", ["rec_A", "rec_B"])
def test_every_axis_of_the_kr300_is_warned_of(data_dir: Path, name: str) -> None:
    for axis in range(1, 7):
        record = read(data_dir / "kr300" / f"{name}.mat", drive=Drive("kuka", axis=axis), kind="revolute")
        said = warned(record)
        for other in range(6):
            assert (f"rec.act_pos_mot_deg[{other}]" in said) == (other != axis - 1)
        assert numbers(said)[1] > 20
