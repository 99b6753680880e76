"""One axis, one log, three joint files: on the motor alone, and with its gear on either side of it."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import dot_path
from jointid.config import File, loads
from jointid.output.export.joint_model import on_other_side
from jointid.output.json import dumps, load_estimate, to_dict
from tests.estimates import identify
from tests.geared import LAW, RATE, RIGID, TURNED_SCREW
from tests.joint_files import faults

R = abs(TURNED_SCREW.motor_per_load)

CONTROLLER = '[controller]\nlaw = "cascade"\nposition_gain = 25.0\n'
MOTOR = """[joint]
kind = "revolute"
[record]
file = "run.csv"
[record.channels]
torque = { column = "tau [mN m]" }
reference = { column = "turns [rev]" }
motor_position = { column = "turns [rev]" }
[parameters]
inertia = { upper = 2.5e-4 }
"""
ON_LOAD = 'column = "x [mm]" }\nload_position = { column = "x [mm]" }'
SCREW = '[transmission]\nlead = "10 mm"\nsign = -1\nside = "SIDE"\n' + MOTOR.replace("revolute", "prismatic").replace(
    'column = "turns [rev]" }', ON_LOAD, 1
)
ON_THE_MOTOR = MOTOR + CONTROLLER + "velocity_gain = 0.02\nlimit = 3.0\n"
GEARED = SCREW + CONTROLLER + "velocity_gain = 0.02\nlimit = 3.0\n"
BY_THE_LOAD = (
    SCREW.replace("2.5e-4", f"{2.5e-4 * R**2!r}")
    + CONTROLLER
    + f'side = "load"\nvelocity_gain = {0.02 * R**2!r}\nlimit = {3 * R!r}\n'
)
"""The same law in the load's metres and newtons."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the log of a screw whose nut goes down while its motor turns forwards."""
    made = tmp_path_factory.mktemp("screw")
    reference = ji.excitation.trapezoids((20.0, 40.0), 400.0, 60.0, RATE, duration=8.0)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), LAW)
    noise = 0.004 * np.random.default_rng(2).standard_normal(reference.size)
    torque = ji.simulated_record(loop, reference, RIGID, sample_time=RATE, torque_noise=noise).torque
    time = np.arange(reference.size) * RATE
    columns = [time, 1e3 * torque.values, reference / (2 * math.pi), -1e3 * reference / R]
    rows = "\n".join(",".join(f"{value!r}" for value in map(float, row)) for row in zip(*columns, strict=True))
    (made / "run.csv").write_text(f"t,tau [mN m],turns [rev],x [mm]\n{rows}\n")
    return made


def file_of(folder: Path, text: str, side: str = "load") -> File:
    return loads(text.replace("SIDE", side), folder)


def identified(folder: Path, text: str, side: str = "load") -> ji.Estimate:
    file = file_of(folder, text, side)
    assert file.loop is not None
    return identify(file.record(), file.loop, file.method, parameters=file.parameters)


@pytest.fixture(scope="module")
def motor(folder: Path) -> ji.Estimate:
    return identified(folder, ON_THE_MOTOR)


def test_three_files_give_one_answer(folder: Path, motor: ji.Estimate) -> None:
    by_motor, by_load = identified(folder, GEARED, "motor"), identified(folder, BY_THE_LOAD)
    assert by_load.settings.joint.kind == "prismatic"
    assert by_load["inertia"].value == pytest.approx(2e-4 * R**2, rel=0.01)  # 79 kg
    assert by_load["offset"].value == pytest.approx(-0.02 * R, rel=0.05)  # the screw turns it round
    gear = by_load.settings.joint.transmission
    for found in (by_motor.rows, on_other_side(by_load.rows, gear, by_load.data.torque_unit)):
        for p, q in zip(found, motor.rows, strict=True):
            assert (p.name, p.unit) == (q.name, q.unit)
            for value, expected in ((p.value, q.value), (p.stderr, q.stderr)):
                assert (value or 0.0) == pytest.approx(expected or 0.0, rel=1e-9), p.name
    assert by_motor.fit.simulations == by_load.fit.simulations == motor.fit.simulations


def test_an_answer_has_both_sides_and_is_read_back(folder: Path, motor: ji.Estimate) -> None:
    found = identified(folder, BY_THE_LOAD)
    (folder / "out.json").write_text(dumps(to_dict(found)), "utf-8")
    answer = json.loads((folder / "out.json").read_text())
    assert answer["settings"]["system"]["transmission"]["motor_per_load"] == pytest.approx(-R)
    assert to_dict(motor)["settings"]["system"]["transmission"] is None

    (folder / "load.toml").write_text(file_of(folder, BY_THE_LOAD).text)
    assert load_estimate(folder / "out.json", str(folder / "load.toml")).values == found.values
    for other in (file_of(folder, GEARED, "motor"), file_of(folder, ON_THE_MOTOR)):
        with pytest.raises(ji.RecordError):
            load_estimate(folder / "out.json", other)


def test_a_record_is_referred_when_it_is_read_and_comes_back(folder: Path) -> None:
    on_motor, on_load = file_of(folder, ON_THE_MOTOR).record(), file_of(folder, GEARED).record()
    assert on_load.channels == ("torque", "reference", "motor_position", "load_position")
    file_of(folder, GEARED).write(on_load, folder / "again.csv")
    back = ji.read(folder / "again.csv", {"torque": "tau [mN m]", "motor_position": "turns [rev]"}, kind="revolute")
    kinds = {name: channel.unit for name, channel in on_load.items()}
    assert kinds == {"torque": "N", "reference": "m", "motor_position": "m", "load_position": "m"}
    for record, r in ((on_load, -R), (back, 1.0)):
        np.testing.assert_allclose(values(record, "torque"), r * values(on_motor, "torque"), rtol=1e-12)
        np.testing.assert_allclose(values(record, "motor_position"), values(on_motor, "motor_position") / r, rtol=1e-12)
    again = file_of(folder, GEARED).record(folder / "again.csv")
    for name in again.channels:
        np.testing.assert_allclose(values(again, name), values(on_load, name), rtol=1e-12)


def values(record: ji.Record, name: str) -> np.ndarray:
    return dict(record.items())[name].values


def test_an_added_inertia_is_on_the_load(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = '[[records]]\nfile = "a.csv"\n[[records]]\nfile = "b.csv"\nadded_inertia = 10.0\n'
    monkeypatch.setattr(File, "record", lambda *_: None)
    monkeypatch.setattr(File, "identify", lambda *_, several, **__: several["added_inertia"])
    assert file_of(folder, GEARED + runs).identify_together() == [0.0, 10.0]
    assert file_of(folder, GEARED + runs, "motor").identify_together() == [0.0, pytest.approx(10.0 / R**2)]
    assert file_of(folder, ON_THE_MOTOR + runs).identify_together() == [0.0, 10.0]


REFUSED = [  # by the key of the fault
    (GEARED.replace('kind = "prismatic"', 'kind = "revolute"').replace(" [mm]", "").replace(" [mN m]", ""), ""),
    (GEARED.replace('lead = "10 mm"', "lead = 0.01\nratio = 3.0"), ""),
    (GEARED.replace('lead = "10 mm"\n', ""), ""),
    (GEARED.replace('lead = "10 mm"', "ratio = -10.0"), "ratio"),
    (GEARED.replace('lead = "10 mm"', 'lead = "10 deg"'), "lead"),
]


@pytest.mark.parametrize(("text", "place"), REFUSED)
def test_a_file_that_cannot_be_is_refused_at_its_key(text: str, place: str) -> None:
    (fault,) = faults(text.replace("SIDE", "load"))
    assert dot_path(fault.place) == f"transmission.{place}".rstrip(".")


def test_an_injected_force_may_be_on_the_other_side_of_the_torque(folder: Path) -> None:
    injected = 'injected = { column = "f [N]", side = "load" }\n[parameters]'
    assert file_of(folder, GEARED.replace("[parameters]", injected)).axis.columns["injected"].side == "load"
    with pytest.raises(ji.JointFileError):
        file_of(folder, GEARED.replace("[parameters]", injected.replace("f [N]", "f [A]")))
    with pytest.raises(ji.RecordError):
        ji.read(folder / "run.csv", {"reference": ji.Column("x [mm]", side="load")}, kind="prismatic")


def test_a_drive_s_own_units_are_those_of_its_motor(folder: Path) -> None:
    """Per mille of a rated torque in N m, and counts per turn, of a screw whose load is reported in m and N."""
    drive = "[drive]\nrated_torque = 0.5\ncounts_per_turn = 4096\n[record]"
    text = (
        GEARED.replace("tau [mN m]", "share")
        .replace('"share"', '"share", unit = "permille"')
        .replace(
            'motor_position = { column = "turns [rev]" }', 'motor_position = { column = "counts", unit = "counts" }'
        )
    )
    table = np.genfromtxt(folder / "run.csv", delimiter=",", skip_header=1)
    made = np.column_stack([table[:, 0], table[:, 1] / 0.5, table[:, 2] * 4096, table[:, 3]])
    np.savetxt(folder / "drive.csv", made, delimiter=",", header="t,share,counts,x [mm]", comments="", fmt="%.17g")
    file = file_of(folder, text.replace("[record]", drive).replace('"run.csv"', '"drive.csv"'))
    record, plain = file.record(), file_of(folder, GEARED).record()
    for name in ("torque", "motor_position", "reference"):
        np.testing.assert_allclose(values(record, name), values(plain, name), rtol=1e-9, atol=1e-12)
        assert dict(record.items())[name].unit == dict(plain.items())[name].unit
