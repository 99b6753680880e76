"""The controller as the drive says it: gains, times and limits with units, and the torque constant said once."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import JointFileError
from jointid.config import controller_text, dumps, load, load_to_learn, loads, with_table
from jointid.config.quantities import Stated, list_units
from jointid.models.controllers import Cascade, FirstOrder, SecondOrder
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.limits import AxisLimits
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.joint_files import CASCADE, JOINT, SMALLEST, faults
from tests.text import unwrapped

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
        ('position_gain = "16.7 1/s"', "position_gain", 16.7),
        ('position_gain = "1000/min"', "position_gain", 1000 / 60),
        ('position_gain = "1.5 1000/min"', "position_gain", 25.0),
        ('position_gain = "1.5 rpm/rev"', "position_gain", 0.025),
        ('velocity_gain = "0.8 A/rpm"', "velocity_gain", 24 / math.pi),
        ('velocity_gain = "800 mA.s/rad"', "velocity_gain", 0.8),
        ('velocity_gain = "800 mA·s/rad"', "velocity_gain", 0.8),
        ('velocity_gain = "0.8 A/(rad/s)"', "velocity_gain", 0.8),
        ('integral_time = "6 ms"', "integral_gain", 1 / 0.006),
        ('integral_time = "6 msec"', "integral_gain", 1 / 0.006),
        ('velocity_gain = "0.8 Amps sec/rad"', "velocity_gain", 0.8),
        ("integral_time = 0.006", "integral_gain", 1 / 0.006),
        ('integral_gain = "10 1/s"', "integral_gain", 10.0),
        ('velocity_limit = "3000 1/min"', "velocity_limit", 100 * math.pi),
        ('velocity_limit = "3000 U/min"', "velocity_limit", 100 * math.pi),
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
    assert file.controller is not None
    assert file.controller.gain == 0.72  # type: ignore[attr-defined]
    written = dumps(file)
    assert line in written or '"' not in line
    assert loads(written) == file


@pytest.mark.parametrize(
    ("after", "sentence"),
    [
        (
            '"0.8 N s/m"',
            'controller.velocity_gain is "0.8 N s/m"; expected a number in N m s/rad, A s/rad, V s/rad or % s/rad, or '
            "a plain one in the controller's units: correct the unit.",
        ),
        (
            '"0.8 A/rad s"',
            'controller.velocity_gain is "0.8 A/rad s"; "A/rad s" has a product behind a stroke; write brackets, as '
            "A/(rad s), or A s/rad.",
        ),
        (
            '"0,8 A s/rad"',
            'controller.velocity_gain is "0,8 A s/rad"; write the number with a point, as "0.8 A s/rad".',
        ),
        (
            '"0.8 A min"',  # a minute of turns, or of time
            'controller.velocity_gain is "0.8 A min"; expected a number in N s/m, A s/m, V s/m, % s/m, N m s/rad, '
            "A s/rad, V s/rad or % s/rad, or a plain one in the controller's units: correct the unit.",
        ),
        (
            '"0.8 V s/rad"',
            'controller.velocity_gain = "0.8 V s/rad" is an output in V, but joint.torque_constant is per A; expected '
            "both in one unit: correct one of them.",
        ),
        (
            '"0.8 A s/rad"\nlimit = "3 N m"',
            'controller has limit = "3 N m" and velocity_gain = "0.8 A s/rad": an output in N m and one in A; expected '
            "one for all of them: take them to one unit.",
        ),
        (
            '"0.8 % s/rad"',
            'controller.velocity_gain = "0.8 % s/rad" is a share of the rated torque, which needs the drive\'s '
            "rated_torque: give it below [drive], or rated_current there and torque_constant below [joint].",
        ),
        (
            '"0.8 A s/rad"\ngain = 2.0',
            "controller.gain is 2, but joint.torque_constant = 0.72 N m/A makes it 0.72; expected the same, or gain = "
            "1 and plain numbers of a controller that speaks N or N m: leave the wrong one out.",
        ),
        (
            '"0.8 A s/rad"\nintegral_time = 0.01\nintegral_gain = 100',
            "controller.integral_time = 0.01 s stands beside integral_gain, which says the same: leave one out.",
        ),
    ],
)
def test_a_unit_that_does_not_fit_is_one_sentence(after: str, sentence: str) -> None:
    assert faults(changed(('"0.8 A s/rad"', after))) == (sentence,)


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
    assert file.controller is not None
    assert file.controller.gain == pytest.approx(gain, rel=1e-14)  # type: ignore[attr-defined]
    assert file.joint.torque_unit == ("A" if ("torque_constant", "#") in changes else None)
    assert loads(dumps(file)) == file


def test_behind_a_screw_the_torque_constant_is_the_motors() -> None:
    screw = [('"revolute"', '"prismatic"'), ("[controller]", '[transmission]\nlead = "10 mm"\n[controller]')]
    assert loads(changed(*screw)).controller.gain == 0.72  # type: ignore[union-attr]
    there = changed(*screw, ("A s/rad", "A s/m")).replace("[controller]", '[controller]\nside = "load"')
    assert loads(there).controller.gain == pytest.approx(0.72 * 2 * math.pi / 0.01)  # type: ignore[union-attr]
    assert faults(changed(*screw, ("N m/A", "N/A"))) == (
        'joint.torque_constant is "0.72 N/A"; expected a number in N m/A or N m/V, or a plain one in SI units: correct '
        "the unit.",
    )


def test_a_torque_in_volts_takes_the_constant_of_the_amplifier() -> None:
    text = JOINT + 'torque_constant = "35 N/V"\n' + SMALLEST.removeprefix(JOINT).replace('"i"', '"i", unit = "V"')
    file = loads(text)
    assert file.joint.torque_unit is None
    assert file.drive.torque_per_volt == 35.0
    assert file.controller.gain == 35.0  # type: ignore[union-attr]
    assert loads(dumps(file)) == file
    (sentence,) = faults(text.replace('unit = "V"', 'unit = "N", gain = 3.5'))
    assert sentence == (
        "record.channels.torque.gain is 3.5 to N, but joint.torque_constant = 35 N/V; expected the same: leave gain "
        'out and give unit = "V", or correct the wrong one.'
    )


def test_without_a_torque_constant_an_output_in_ampere_needs_a_torque_in_ampere() -> None:
    text = changed(('torque_constant = "0.72 N m/A"\n', ""), ('unit = "A"', 'unit = "N m"'))
    assert faults(text) == (
        'controller.velocity_gain = "0.8 A s/rad" is an output in A, but the torque is in N or N m; expected what '
        'takes one to the other: add the torque constant below [joint], as torque_constant = "0.72 N m/A".',
    )


@pytest.mark.parametrize("key", ["kp", "Kp", "kv", "Kv", "ki", "kd", "Tn", "Ti", "Td"])
def test_a_name_that_means_two_gains_is_refused_with_both(key: str) -> None:
    (sentence,) = faults(f"{SMALLEST}{key} = 3.0")
    assert sentence.startswith(f"controller.{key} is ")
    named = {"p": ["position_gain", "velocity_gain"], "v": ["position_gain", "velocity_gain"]}
    expected = named.get(key[1], ["derivative_time"] if key[1] == "d" else ["integral_time"])
    assert all(name in sentence for name in expected)


@pytest.mark.parametrize("law", ["cascade", "pd", "pid"])
def test_a_key_that_may_be_the_missing_gain_is_asked_about_alone(law: str) -> None:
    text = SMALLEST.replace(CASCADE, f'[controller]\nlaw = "{law}"\n')
    found = faults(text + 'Kp = 3.0\nKv = 1.0\nTn = "6 ms"\n')
    assert [sentence.split()[0] for sentence in found] == ["controller.Kp", "controller.Kv", "controller.Tn"]


def test_all_gains_that_a_law_lacks_are_said_at_once() -> None:
    for law, gains in (("pd", "position derivative"), ("pid", "position integral derivative")):
        found = faults(SMALLEST.replace(CASCADE, f'[controller]\nlaw = "{law}"\n'))
        assert [sentence.split()[0] for sentence in found] == [f"controller.{gain}_gain" for gain in gains.split()]
    (one,) = faults(SMALLEST.replace(CASCADE, '[controller]\nlaw = "pd"\nderivative_time = "2 ms"\n'))
    assert one.startswith("controller.position_gain is missing")


def test_what_is_said_under_a_name_of_the_drive_is_not_missing_too() -> None:
    """Kv, Kp and Tn are three things to put right, not five."""
    text = TURNING.replace("position_gain", "Kv").replace("velocity_gain", "Kp") + 'Tn = "20 ms"\n'
    assert [sentence.split()[0] for sentence in faults(text)] == ["controller.Kv", "controller.Kp", "controller.Tn"]


def test_the_position_gain_of_a_drive_is_the_position_loops() -> None:
    assert faults(SMALLEST + "Kv = 3.0") == (
        "controller.Kv is the gain of another loop on many drives; expected position_gain for the Kv of a drive's "
        "position loop, velocity_gain for the kv of the paper: write the one that is meant.",
    )
    assert faults(SMALLEST + "[drive]\ntorque_constant = 3.0") == (
        "drive.torque_constant is said once, for torque and controller: write it below [joint], as torque_constant = "
        '"0.72 N m/A".',
    )


def test_times_of_a_pid_are_those_of_its_proportional_gain() -> None:
    text = SMALLEST.replace(CASCADE, '[controller]\nlaw = "pid"\nposition_gain = 50.0\n')
    pid = loads(text + 'integral_time = "20 ms"\nderivative_time = "2 ms"').controller
    assert pid.integral_gain == pytest.approx(2500.0)  # type: ignore[union-attr]
    assert pid.derivative_gain == pytest.approx(0.1)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("said", "made"),
    [
        ('{ kind = "first_order", cutoff = "100 Hz" }', FirstOrder(1 / (200 * math.pi))),
        ('{ time_constant = "1 ms" }', FirstOrder(0.001)),
        ('{ kind = "second_order", cutoff = "0.1 kHz" }', SecondOrder(100.0)),
        ("{ cutoff = 100.0, damping = 0.6 }", SecondOrder(100.0, 0.6)),
        ("[0.5, 0.5]", (0.5, 0.5)),
    ],
)
def test_a_filter_is_said_by_its_cutoff_its_time_constant_or_its_taps(said: str, made: object) -> None:
    assert loads(f"{SMALLEST}velocity_filter = {said}").controller.velocity_filter == made  # type: ignore[union-attr]


def test_what_a_cutoff_leaves_open_is_asked() -> None:
    assert faults(SMALLEST + "velocity_filter = { cutoff = 100.0 }") == (
        'controller.velocity_filter.kind is missing; expected "first_order" or "second_order" (which filter): add it.',
    )
    assert faults(SMALLEST + 'velocity_filter = { kind = "first_order", cutoff = 100.0, time_constant = 1.0 }') == (
        "controller.velocity_filter.cutoff is 100 Hz beside time_constant, which says the same: leave one out.",
    )


def test_units_are_those_of_the_declaration() -> None:
    assert list_units("controller units per m s or rad s", "revolute")[:2] == ("N m/(rad s)", "A/(rad s)")
    assert list_units("m/s or rad/s", "prismatic") == ("m/s",)
    assert list_units("some share of it") == ()


def test_a_stated_number_is_copied_with_its_words() -> None:
    for again in (copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))):
        one = again(Stated(0.006, "6 ms"))
        assert (one, one.text) == (0.006, "6 ms")


AX5000 = changed(("[controller]", '[drive]\nprofile = "twincat"\n[controller]')).partition("position_gain")[0]


def test_a_drives_parameters_are_gains_in_its_own_units() -> None:
    file = loads(AX5000 + 'S-0-0104 = 1.5\nS-0-0100 = "0.8 A s/rad"\nS-0-0101 = 5.0\n')
    spelt = AX5000 + 'position_gain = "1.5 1000/min"\nvelocity_gain = "0.8 A s/rad"\nintegral_time = "5.0 ms"\n'
    assert file == loads(spelt)
    assert file.controller.position_gain == pytest.approx(25.0)  # type: ignore[union-attr]
    assert file.controller.integral_gain == pytest.approx(200.0)  # type: ignore[union-attr]
    off = loads(AX5000 + "S-0-0104 = 1\nvelocity_gain = 0.8\nS-0-0101 = 0.0\n")
    assert off.controller.integral_gain == 0.0  # type: ignore[union-attr]


def test_a_drives_parameter_is_said_once_and_with_a_unit_that_is_not_open() -> None:
    assert faults(AX5000 + "S-0-0104 = 1.5\nposition_gain = 3.0\nS-0-0100 = 0.8\n") == (
        "controller.S-0-0104 is position_gain, which stands beside it; expected one of them: leave one out.",
        'controller.S-0-0100 is 0.8, in a unit that the drive may have set; expected "0.8 A s/rad" or "0.8 N m s/rad" '
        'or "0.8 N s/m": add the unit.',
    )
    (unknown, *_) = faults(TURNING + "S-0-0104 = 1.5\n")
    assert unknown.startswith("controller.S-0-0104 is not a known key")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0.8 A/0", '"A/0" is no unit; its factor is 0 or too large'),
        ("1 mm^-99999", '"mm^-99999" is no unit; its factor is 0 or too large'),
        ("1 /(mm^99999)", '"/(mm^99999)" is no unit; its factor is 0 or too large'),
        ("1 " + "(" * 3000, "its unit has 3000 characters; expected at most 100"),
        ("1e999 A s/rad", "the number is too large"),
    ],
)
def test_a_unit_out_of_all_bounds_is_one_sentence(text: str, said: str) -> None:
    (sentence,) = faults(changed(("0.8 A s/rad", text)))
    assert sentence.startswith("controller.velocity_gain is ")
    assert sentence.endswith(f"; {said}.")


def test_a_torque_and_a_constant_that_is_not_of_its_unit_are_refused() -> None:
    plain = ('"0.8 A s/rad"', "0.8")
    assert faults(changed(plain, ('unit = "A"', 'unit = "V"'))) == (
        "record.channels.torque is in V, but joint.torque_constant = 0.72 N m/A is per A; expected both in one unit: "
        'write the constant of what is logged, as torque_constant = "0.72 N m/V".',
    )
    (sentence,) = faults(changed(plain, ("N m/A", "N m/V")))
    assert sentence.startswith("record.channels.torque is in A, but joint.torque_constant = 0.72 N m/V is per V;")


def test_a_share_of_a_rated_torque_needs_the_torque_constant_where_the_torque_is_in_ampere() -> None:
    share = ("A s/rad", "% s/rad"), ("[controller]", '[drive]\nrated_torque = "1.5 N m"\n[controller]')
    assert loads(changed(*share)).joint.torque_unit is None
    assert faults(changed(*share, ('torque_constant = "0.72 N m/A"', ""))) == (
        'controller.velocity_gain = "0.8 % s/rad" is a share of the rated torque, but the torque is in A; expected '
        'what takes one to the other: add the torque constant below [joint], as torque_constant = "0.72 N m/A".',
    )


def test_amperes_of_a_controller_on_the_load_are_the_motors() -> None:
    gear = "[controller]", '[transmission]\nratio = 10\n[controller]\nside = "load"'
    file = loads(changed(gear, ('torque_constant = "0.72 N m/A"', "")))
    assert file.joint.torque_unit == "A"
    assert file.controller.gain == 10.0  # type: ignore[union-attr]
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
    written = controller_text(learned, file.joint.transmission, file.torque_per_unit)
    assert loads(with_table(text, written)).controller == learned


def test_an_integral_time_is_written_only_where_it_still_says_the_gain() -> None:
    pid = '[controller]\nlaw = "pid"\nposition_gain = 1.0\nintegral_time = "10 ms"\nderivative_gain = 0.1\n'
    file = loads(SMALLEST.replace(CASCADE, pid))
    assert 'integral_time = "10 ms"' in dumps(file)
    other = replace(file, controller=replace(file.controller, position_gain=2.0))  # type: ignore[type-var]
    assert loads(dumps(other)) == other
    faster = loads(SMALLEST.replace(CASCADE, pid.replace("1.0", '"50 N/m"')))
    assert 'integral_time = "10 ms"' in dumps(faster)
    assert loads(dumps(faster)) == faster


def test_a_constant_per_volt_is_written_in_its_words_only_where_it_is_the_same() -> None:
    text = JOINT + 'torque_constant = "500.0 mN/V"\n' + SMALLEST.removeprefix(JOINT).replace('"i"', '"i", unit = "V"')
    file = loads(text)
    controller = replace(file.controller, gain=500.0)  # type: ignore[type-var]
    other = replace(file, drive=replace(file.drive, torque_per_volt=500.0), controller=controller)
    assert loads(dumps(other)).drive.torque_per_volt == 500.0


@pytest.mark.parametrize(
    "said",
    [
        'law = "pid"\nposition_gain = 2.0\nintegral_time = "10 ms"\nderivative_time = 0.001',
        'law = "pd"\nderivative_time = 0.001',
        'S-0-0104 = 1.5\nS-0-0100 = "0.8 A s/rad"\nS-0-0101 = 5',
    ],
)
def test_what_is_to_be_learned_may_say_some_of_its_gains_in_any_words(said: str, tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    path.write_text(AX5000.partition("[controller]")[0] + f"[controller]\n{said}\n")
    assert load_to_learn(path).controller is not None


@pytest.mark.parametrize(
    "said", ['[controller]\nlaw = ["pid"]', '[[controller]]\nlaw = "pid"', "[controller]\nlaw = {}"]
)
def test_a_controller_to_be_learned_that_is_no_table_is_one_sentence(said: str, tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    path.write_text(f"{SMALLEST.replace(CASCADE, '')}\n{said}\n")
    with pytest.raises(JointFileError) as raised:
        load_to_learn(path)
    assert len(raised.value.faults) == 1


@pytest.mark.parametrize(
    ("changes", "scale"),
    [
        ([], "0.72 N m/A"),
        ([("[controller]", '[transmission]\nratio = 10\n[controller]\nside = "load"')], "0.72 N m/A"),
        ([('"0.8 A s/rad"', '"0.8 N m s/rad"')], ""),
        ([('unit = "A"', 'unit = "N m"')], ""),
        ([("torque_constant", "#")], ""),
        ([('reference = { column = "r" }', 'reference = { column = "r" }\ninjected = { column = "p" }')], ""),
        (
            [('reference = { column = "r" }', 'reference = { column = "r" }\ninjected = { column = "p", unit = "A" }')],
            "0.72 N m/A",
        ),
    ],
)
def test_values_scale_with_the_torque_constant_where_log_and_controller_are_in_a(
    changes: list[tuple[str, str]], scale: str
) -> None:
    assert loads(changed(*changes)).scale == scale


def test_a_wrong_torque_constant_scales_every_value_and_a_line_says_so(tmp_path: Path) -> None:
    """No check can see it: the record fits as well with ten times as much."""
    loop = ClosedLoop(RigidJoint("revolute"), Cascade(position_gain=30.0, velocity_gain=0.8, gain=0.72))
    reference = trapezoids((2.0, 4.0), 40.0, 1.0, 1e-3, duration=3.0)
    truth = {"inertia": 0.01, "viscous": 0.02, "coulomb": 0.1, "offset": 0.02}
    record = simulated_record(loop, reference, truth, sample_time=1e-3)
    assert record.torque is not None
    columns = np.column_stack([np.arange(reference.size) * 1e-3, record.torque.values / 0.72, reference])
    np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header="t,i,r", comments="")
    text = changed(
        ('"1 (m/min)/mm"', "30.0"), ("[record.channels]", '[record]\nfile = "log.csv"\ntime = "t"\n[record.channels]')
    )
    found = {}
    for constant in ("0.72", "7.2"):
        path = tmp_path / "joint.toml"
        path.write_text(text.replace("0.72", constant), encoding="utf-8")
        file = load(path)
        estimate = file.identify(file.record())
        found[constant] = estimate.values["inertia"]
        assert f"values scale with torque_constant {constant} N m/A, which no record checks" in unwrapped(str(estimate))
    assert found["0.72"] == pytest.approx(0.01, rel=1e-3)
    assert found["7.2"] == pytest.approx(10 * found["0.72"], rel=1e-6)


def test_limits_of_the_axis_are_given_with_units_of_its_own_motion() -> None:
    limits = 'stroke = "90 deg"\nspeed = "60 rpm"\ntorque = 5.0\nlowest = 0.5\n'
    file = loads(f"{TURNING}[limits]\n{limits}")
    assert file.limits == AxisLimits(stroke=math.pi / 2, speed=2 * math.pi, torque=5.0, lowest=0.5)
    assert 'speed = "60 rpm"' in dumps(file)
    assert loads(dumps(file)).limits == file.limits
    assert faults(f'{TURNING}[limits]\nstroke = "20 mm"\nhighest = 40.0') == (
        'limits.stroke is "20 mm"; expected a number in rad, or a plain one in SI units: correct the unit.',
    )
    (fault,) = faults(f"{TURNING}[limits]\nhighest = 0.05")
    assert fault == "limits.highest: The highest frequency is above the lowest; received 0.05 and 0.1 Hz."


def test_a_torque_is_limited_in_the_unit_in_which_it_is_identified() -> None:
    assert loads(f'{TURNING}[limits]\ntorque = "5 N m"').limits.torque == 5.0
    per_ampere = changed(('torque_constant = "0.72 N m/A"\n', ""))
    assert loads(f'{per_ampere}[limits]\ntorque = "500 mA"').limits.torque == pytest.approx(0.5)
    for text, torque in ((TURNING, "5 A"), (per_ampere, "5 N m"), (TURNING, "5 N")):
        (fault,) = faults(f'{text}[limits]\nrms_torque = "{torque}"')
        assert fault.startswith(f'limits.rms_torque is "{torque}"; expected a number in ')
    (fault,) = faults(f"{TURNING}[limits]\nwindup = 0.01")
    assert fault == "limits.windup is that of a spring, and a rigid joint has none: leave it out."


@pytest.mark.parametrize(("side", "unit"), [("motor", "rad"), ("load", "m")])
def test_limits_are_those_of_the_side_that_is_reported(side: str, unit: str) -> None:
    screw = changed(('kind = "revolute"', 'kind = "prismatic"'))
    stroke = '"0.2 m"' if unit == "rad" else '"90 deg"'
    (fault,) = faults(f'{screw}[transmission]\nlead = 0.01\nside = "{side}"\n[limits]\nstroke = {stroke}')
    assert fault.startswith(f"limits.stroke is {stroke}; expected a number in {unit}, ")
