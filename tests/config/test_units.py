"""The controller as the drive says it: gains, times and limits with units, and the torque constant said once."""

import math

import pytest

from jointid.common.units import UnitError, normalise_unit, parse_quantity
from jointid.config import controller_text, dumps, edit, loads, replace_table
from jointid.models.controllers import Cascade, FirstOrder, SecondOrder
from jointid.models.controllers.filters import DigitalFilter
from jointid.models.limits import AxisLimits
from jointid.records.columns import Column
from jointid.records.record import known_units
from tests.joint_files import JOINT, SMALLEST, faults, told

TURNING = """
[joint]
kind = "revolute"
torque_constant = "0.72 N m/A"
[record.channels]
torque = { column = "i", unit = "A" }
reference = { column = "r" }
[controller]
law = "cascade"
position_gain = "1 (m/min)/mm"
velocity_gain = "0.8 A s/rad"
"""


def changed(*changes: tuple[str, str]) -> str:
    text = TURNING
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return text


@pytest.mark.parametrize(
    ("line", "name", "value"),
    [
        ('position_gain = "1000/min"', "position_gain", 1000 / 60),
        ('position_gain = "1.5 1000/min"', "position_gain", 25.0),
        ('position_gain = "1.5 rpm/rev"', "position_gain", 0.025),
        ('velocity_gain = "0.8 A/rpm"', "velocity_gain", 24 / math.pi),
        ('velocity_gain = "800 mA.s/rad"', "velocity_gain", 0.8),
        ('velocity_gain = "0.8 A/(rad/s)"', "velocity_gain", 0.8),
        ('integral_time = "6 ms"', "integral_gain", 1 / 0.006),
        ("integral_time = 0.006", "integral_gain", 1 / 0.006),
        ('integral_gain = "10 1/s"', "integral_gain", 10.0),
        ('velocity_limit = "3000 1/min"', "velocity_limit", 100 * math.pi),
        ('limit = "8000 mA"', "limit", 8.0),
        ('period = "0.25 ms"', "period", 0.00025),
        ('acceleration_feedforward = "2 A s²/rad"', "acceleration_feedforward", 2.0),
    ],
)
def test_a_number_is_taken_to_si_by_its_unit(line: str, name: str, value: float) -> None:
    key = line.partition(" ")[0]
    text = "\n".join(one for one in TURNING.splitlines() if not one.startswith(key)) + f"\n{line}"
    file = loads(text)
    assert getattr(file.controller, name) == pytest.approx(value, rel=1e-14)
    assert file.controller.gain == 0.72
    written = dumps(file)
    assert line in written or '"' not in line
    assert loads(written) == file


MINUTES = "0.8 A min"  # of turns, or of time
NOT_FIT = ("0.8 N s/m", "0,8 A s/rad", MINUTES, "0.8 V s/rad", "1 " + "(" * 3000, "1e999 A s/rad", "0.8 % s/rad")
UNFIT = [
    *(([('"0.8 A s/rad"', f'"{one}"')], "controller.velocity_gain unit") for one in NOT_FIT),
    ([('"0.8 A s/rad"', '"0.8 A s/rad"\nlimit = "3 N m"')], "controller unit"),
    ([('"0.8 A s/rad"', '"0.8 A s/rad"\ngain = 2.0')], "controller.gain contradiction"),
    ([('"0.8 A s/rad"', '"0.8 A s/rad"\nintegral_time = 0.01\nintegral_gain = 100')], "controller.integral_gain value"),
    # nothing takes amperes to the torque
    ([('torque_constant = "0.72 N m/A"\n', ""), ('unit = "A"', 'unit = "N m"')], "controller.velocity_gain unit"),
    ([('"0.8 A s/rad"', "0.8"), ('unit = "A"', 'unit = "V"')], "record.channels.torque unit"),
    ([('"0.8 A s/rad"', "0.8"), ("N m/A", "N m/V")], "record.channels.torque unit"),
    (
        [
            ("A s/rad", "% s/rad"), ("[controller]", '[drive]\nrated_torque = "1.5 N m"\n[controller]'),
            ('torque_constant = "0.72 N m/A"', ""),
        ],
        "controller.velocity_gain unit",
    ),
    ([("[controller]", '[limits]\nstroke = "20 mm"\n[controller]')], "limits.stroke unit"),
    ([("[controller]", "[limits]\nhighest = 0.05\n[controller]")], "limits contradiction"),
    ([("[controller]", '[limits]\nrms_torque = "5 A"\n[controller]')], "limits.rms_torque unit"),
    ([("[controller]", '[drive]\ntorque_constant = 3.0\n[controller]')], "drive.torque_constant unknown"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "said"), UNFIT)
def test_a_unit_that_does_not_fit_is_one_fault(changes: list[tuple[str, str]], said: str) -> None:
    assert told(changed(*changes)) == [said]


@pytest.mark.parametrize(
    ("changes", "gain"),
    [
        ([], 0.72),
        ([('"0.8 A s/rad"', "0.8")], 0.72),
        ([('"0.8 A s/rad"', "0.8\ngain = 1.0")], 1.0),
        ([('"0.8 A s/rad"', "0.8\ngain = 0.72")], 0.72),
        ([('"0.8 A s/rad"', '"0.8 N m s/rad"')], 1.0),
        (
            [('"0.8 A s/rad"', '"0.8 % s/rad"'), ("[controller]", '[drive]\nrated_torque = "1.5 N m"\n[controller]')],
            0.015,
        ),
        ([("torque_constant", "#"), ("", "")], 1.0),
        ([('"0.72 N m/A"', "0.72")], 0.72),
        ([('"0.72 N m/A"', '"720 mN m/A"')], 0.72),
        ([("[controller]", '[transmission]\nratio = 10\n[controller]\nside = "load"')], 7.2),
    ],
)
def test_the_torque_constant_is_said_once(changes: list[tuple[str, str]], gain: float) -> None:
    file = loads(changed(*[change for change in changes if change[0]]))
    assert file.controller.gain == pytest.approx(gain, rel=1e-14)
    assert file.joint.torque_unit == ("A" if ("torque_constant", "#") in changes else None)
    assert loads(dumps(file)) == file


def test_behind_a_screw_the_torque_constant_is_the_motors() -> None:
    screw = [('"revolute"', '"prismatic"'), ("[controller]", '[transmission]\nlead = "10 mm per turn"\n[controller]')]
    assert loads(changed(*screw)).controller.gain == 0.72
    there = changed(*screw, ("A s/rad", "A s/m")).replace("[controller]", '[controller]\nside = "load"')
    assert loads(there).controller.gain == pytest.approx(0.72 * 2 * math.pi / 0.01)
    assert told(changed(*screw, ("N m/A", "N/A"))) == ["joint.torque_constant unit"]
    assert "lead of" in next(one for one in faults(changed(screw[0])) if one.place[0] == "controller")


def test_a_torque_in_volts_takes_the_constant_of_the_amplifier() -> None:
    text = JOINT + 'torque_constant = "35 N/V"\n' + SMALLEST.removeprefix(JOINT).replace('"i"', '"i", unit = "V"')
    file = loads(text)
    assert file.joint.torque_unit is None
    assert file.axis.drive.torque_per_volt == 35.0
    assert file.controller.gain == 35.0
    assert loads(dumps(file)) == file


@pytest.mark.parametrize(
    ("said", "made"),
    [
        ('{ kind = "first_order", cutoff = "100 Hz" }', FirstOrder(0.5 / math.pi / 100)),
        ('{ kind = "first_order", time_constant = "1 ms" }', FirstOrder(0.001)),
        ('{ kind = "second_order", frequency = "0.1 kHz", damping = 0.6 }', SecondOrder(100.0, 0.6)),
        ("[0.5, 0.5]", DigitalFilter((0.5, 0.5))),
    ],
)
def test_a_filter_is_said_by_its_cutoff_its_time_constant_or_its_taps(said: str, made: object) -> None:
    assert loads(f"{SMALLEST}velocity_filter = {said}").controller.velocity_filter == made


def test_amperes_of_a_controller_on_the_load_are_the_motors() -> None:
    gear = "[controller]", '[transmission]\nratio = 10\n[controller]\nside = "load"'
    file = loads(changed(gear, ('torque_constant = "0.72 N m/A"', "")))
    assert file.joint.torque_unit == "A"
    assert file.controller.gain == 10.0
    assert loads(dumps(file)) == file


@pytest.mark.parametrize(
    ("constant", "gain"),
    [("", 1.0), ("", 7.2), ("0.72", 1.0), ("0.72", 7.2), ("0.72", 0.15), ("1.0", 1.0), ("1.0", 10.0)],
)
def test_a_learned_law_behind_a_gear_is_read_back_with_its_gain(constant: str, gain: float) -> None:
    drive = '[transmission]\nratio = 10\n[drive]\nrated_torque = "1.5 N m"\n[controller]'
    said = f'torque_constant = "{constant} N m/A"' if constant else ""
    text = changed(('"0.8 A s/rad"', "0.8"), ('torque_constant = "0.72 N m/A"', said), ("[controller]", drive))
    file = loads(text)
    learned = Cascade(position_gain=3.0, velocity_gain=4.0, gain=gain)  # on the side of its record: the load's
    assert loads(edit(text, replace_table(controller_text(learned, file.axis)))).controller == learned


def test_limits_of_the_axis_are_given_with_units_of_its_own_motion() -> None:
    limits = 'stroke = "90 deg"\nspeed = "60 rpm"\ntorque = 5.0\nlowest = 0.5\n'
    file = loads(f"{TURNING}[limits]\n{limits}")
    assert file.limits == AxisLimits(stroke=math.pi / 2, speed=2 * math.pi, torque=5.0, lowest=0.5)
    assert 'speed = "60 rpm"' in dumps(file)
    assert loads(dumps(file)).limits == file.limits


def test_a_torque_is_limited_in_the_unit_in_which_it_is_identified() -> None:
    assert loads(f'{TURNING}[limits]\ntorque = "5 N m"').limits.torque == 5.0
    per_ampere = changed(('torque_constant = "0.72 N m/A"\n', ""))
    assert loads(f'{per_ampere}[limits]\ntorque = "500 mA"').limits.torque == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("said", "unit"),
    [("inc", "counts"), ("U/min", "rpm"), ("1/min", "rpm"), ("°", "deg"), ("%", "%"), ("mNm", "mNm"), ("mm/s", "mm/s")],
)
def test_an_ordinary_unit_is_known(said: str, unit: str) -> None:
    assert normalise_unit(said) == unit
    known = (*known_units("reference", "revolute"), *known_units("reference_velocity", "revolute"), "%", "mNm", "mm/s")
    assert Column("q", unit=said).stated_unit(known) == unit
    assert Column(f"q [{said}]").stated_unit(known) == unit


def test_a_declared_unit_and_that_of_the_name_are_said_with_both() -> None:
    turning = SMALLEST.replace('"prismatic"', '"revolute"')
    (fault,) = faults(turning.replace('"r"', '"pos [deg]", unit = "rad"'))
    assert fault.place == ("record", "channels", "reference", "unit")
    assert loads(turning.replace('"r"', '"pos [deg]", unit = "°"'))


@pytest.mark.parametrize("text", ["0.8", "A", "3 foo", "3 A)", "3 (A", "3 A/", "3 A/rad s", "0,8 A", ""])
def test_what_is_no_quantity_is_refused(text: str) -> None:
    with pytest.raises(UnitError):
        parse_quantity(text)
