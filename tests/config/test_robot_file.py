"""The robot file: its joints, their channels in one record, what is written back, and the sentences on faults."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import dot_path
from jointid.config import File, dumps, load, loads
from jointid.models.friction import FRICTIONS
from jointid.models.springs import SPRINGS
from tests.models.robots.trees import as_mjcf, chain

pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")

TEXT = """
[robot]
model = "arm.xml"
base = [0.0, 1.5707963267948966, 0.0]
feed_forward = "gravity"

[record]
file = "log.csv"
sample_time = 0.002

[record.channels]
torque = { column = "i_{index}", unit = "A" }
motor_position = { column = "{joint}.q" }
reference = { column = "r{axis}" }

[[joints]]
name = "joint0"
torque_constant = 2.0
viscous = 3.0

[[joints]]
name = "joint1"
torque_constant = 2.0
rotor_inertia = 0.5
spring = { stiffness = 1e4, viscous = 0.5 }
transmission = { ratio = 100, side = "load" }
controller = { law = "pd", position_gain = 10.0, derivative_gain = 1.0, side = "motor" }

[[joints]]
name = "joint2"
torque_constant = 2.0
coupling = { joint1 = 0.1 }
channels = { reference = { column = "last" } }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(as_mjcf(chain(3)), encoding="utf-8")
    (tmp_path / "robot.toml").write_text(TEXT, encoding="utf-8")
    names = ["i_0", "i_1", "i_2", "joint0.q", "joint1.q", "joint2.q", "r1", "r2", "last"]
    rows = np.random.default_rng(0).normal(size=(200, 9)).round(6)
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(names), comments="")
    return tmp_path


def test_a_robot_and_its_record(folder: Path) -> None:
    file = load(folder / "robot.toml")
    first, second, _ = file.robot.joints
    assert (first.viscous, first.rotor_inertia) == (3.0, chain(3).joints[0].rotor_inertia)
    assert (second.rotor_inertia, second.spring) == (0.5, ji.robots.JointSpring(1e4, viscous=0.5))
    assert file.robot.coupling[2].tolist() == [0.0, 0.1, 1.0] and file.feed_forward == "gravity"
    assert file.robot.gravity == pytest.approx([9.81, 0.0, 0.0], abs=1e-12)
    assert isinstance(file.axes[1].controller, ji.controller.PD)
    rows = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1)
    records = file.records()
    for i, (record, gear) in enumerate(zip(records, (1, 100, 1), strict=True)):
        assert record.torque.values == pytest.approx(2.0 * gear * rows[:, i])
        assert record.motor_position.values == pytest.approx(rows[:, 3 + i] / gear)
        assert record.reference.values == pytest.approx(rows[:, 6 + i] / gear)


REFUSED = [
    ('model = "arm.xml"', "", "robot.model missing"),
    ("viscous = 3.0", "viscous = -3.0", "joints.1.viscous value"),
    ("viscous = 3.0", "viscus = 3.0", "joints.1.viscus unknown"),
    ('"joint0"', '"joint9"', ""),
    ('name = "joint2"', 'name = "joint1"', ""),
    ("base = [0.0, ", "base = [", "robot.base value"),
    ("base = [0.0, 1.5707963267948966, 0.0]", "base = [0, 90, 0]", "robot.base value"),
    ('"gravity"', '"perfect"', "robot.feed_forward value"),
    ('"pd"', '"pdd"', "joints.2.controller.law value"),
    ("joint1 = 0.1", "joint9 = 0.1", ""),
    ('"arm.xml"', '"leg.xml"', ""),
    ("derivative_gain = 1.0, ", "", "joints.2.controller.derivative_gain missing"),
    ('column = "i_{index}"', 'column = "i_0"', ""),
    ('ratio = 100, side = "load"', 'ratio = 100, side = "motor"', "joints.2.transmission.side contradiction"),
    ("[[joints]]", '[method]\nestimator = "ols"\nname = "didim"\n[[joints]]', "method.estimator contradiction"),
    ("viscous = 3.0", "parameters = { harmonic_1_cos = 1.0 }", "joints.1.parameters.harmonic_1_cos unknown"),
    ("viscous = 3.0", 'kind = "prismatic"', "joints.1.kind contradiction"),
    ("viscous = 3.0", 'friction = "dahl"', "joints.1.friction value"),
    ("viscous = 3.0", "parameters = {inertia = {start = 3, lower = 4}}", "joints.1.parameters.inertia contradiction"),
    ("viscous = 3.0", "spring = { damping = 1.0 }", "joints.1.spring.stiffness missing"),
    ("viscous = 3.0", "limits = { lower = 1.0, upper = -1.0 }", "joints.1.limits contradiction"),
]


@pytest.mark.parametrize(("before", "after", "said"), REFUSED)
def test_a_fault_has_its_place_in_the_robot_file(folder: Path, before: str, after: str, said: str) -> None:
    with pytest.raises(ji.JointFileError) as caught:
        loads(TEXT.replace(before, after, 1), folder)
    (fault,) = caught.value.faults
    assert f"{dot_path(fault.place)} {fault.code}".strip() == said


def test_a_fault_of_one_joint_names_it(folder: Path) -> None:
    file = load(folder / "robot.toml", ['record.channels.torque.column="none{axis}"'])
    with pytest.raises(ji.RecordError, match=r"joint1: .*none2"):
        file.records()


def test_joints_that_the_log_lacks_stand_still(folder: Path) -> None:
    text = TEXT[: TEXT.rindex("[[joints]]")]
    assert loads(text.replace("[robot]", "[robot]\nlocked = { joint2 = 0.3 }"), folder).robot.names == (
        "joint0",
        "joint1",
    )


def test_each_record_has_the_payload_that_is_stated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    payload = "payload_mass = 2.0\npayload_center = [0.1, 0.0, 0.0]\npayload_inertia = [0.01, 0, 0, 0.02, 0, 0.03]\n"
    empty, loaded = folder / "log.csv", folder / "loaded.csv"
    loaded.write_bytes(empty.read_bytes())
    text = TEXT + f'[[records]]\nfile = "log.csv"\n[[records]]\nfile = "loaded.csv"\n{payload}'
    file = loads(text, folder)
    stated = pytest.approx((2, 0.2, 0, 0, 0.01, 0, 0, 0.04, 0, 0.05))
    seen = []
    monkeypatch.setattr(File, "identify", lambda _, logs, progress: seen.extend(logs))
    for paths in ([], [empty, loaded], [loaded, empty]):
        file.identify_together(paths)
    assert [log[-1].payload for log in seen] == [(), stated, (), stated, stated, ()]
    assert file.inputs()[-1] == loaded
    one = file.record(folder / ".." / folder.name / "loaded.csv")  # every verb reads it so
    assert [record.payload for record in one] == [(), (), stated]
    with pytest.raises(ji.MethodError):
        ji.robots.identify_payload(file.setup, file.record(empty), one)
    for change in (("payload_mass = 2.0\n", ""), ("[0.01, 0", "[-5, 0")):
        with pytest.raises(ji.JointFileError, match=r"records\.2"):
            loads(text.replace(*change), folder)


@pytest.mark.parametrize("roll", ["3.1415926", "0.5"])
def test_an_export_of_a_turned_base_is_not_turned_again(roll: str, folder: Path) -> None:
    text = TEXT.replace("base = [0.0, 1.5707963267948966, 0.0]", f"base = [{roll}, 0.0, 0.0]")
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    robot = load(folder / "robot.toml").robot
    robot = replace(robot, joints=tuple(replace(one, spring=None) for one in robot.joints))
    (folder / "arm.xml").write_text(ji.export(robot, "mjcf").text, encoding="utf-8")
    with pytest.raises(ji.JointFileError, match=r"robot\.base turns the model"):
        load(folder / "robot.toml")
    (folder / "robot.toml").write_text(TEXT.replace("base = [0.0, 1.5707963267948966, 0.0]", ""), encoding="utf-8")
    assert load(folder / "robot.toml").robot.gravity == pytest.approx(robot.gravity, abs=1e-6)


def test_friction_backwards_and_a_start_in_motion(folder: Path) -> None:
    text = TEXT.replace("viscous = 3.0", "viscous = 3.0\nviscous_backwards = 2.0")
    file = loads(text.replace('feed_forward = "gravity"', "in_motion = true"), folder)
    assert file.in_motion and file.robot.joints[0].viscous_backwards == 2.0


def test_a_joint_takes_the_keys_of_a_joint_file(folder: Path) -> None:
    text = TEXT.replace(
        "viscous = 3.0\n",
        """kind = "revolute"
friction = "asymmetric"
parameters = { viscous_forwards = { start = 3.0 }, viscous_backwards = { start = 2.0 } }
""",
    ).replace(
        "spring = { stiffness = 1e4, viscous = 0.5 }\nt",
        'model = "flexible"\nspring = "linear"\nparameters = { stiffness = { start = 1e4 }, load_viscous = 0.5 }\nt',
    )
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    file = load(folder / "robot.toml")
    first, second, _ = file.robot.joints
    assert (first.viscous, first.viscous_backwards) == (3.0, 2.0) and first.law.two_ways
    assert second.spring == ji.robots.JointSpring(1e4, viscous=0.5) and second.rotor_inertia == 0.5
    assert [one.joint.friction.name for one in file.axes] == ["asymmetric", "symmetric", "symmetric"]
    assert list(file.parameters) == ["joint1.link_viscous"] and file.parameters["joint1.link_viscous"].start == 0.5
    bounded = text.replace("viscous_backwards = { start = 2.0 }", "viscous_backwards = { start = 2.0, lower = 1.0 }")
    (folder / "robot.toml").write_text(bounded.replace("{ start = 3.0 }", "3.0", 1), encoding="utf-8")
    kept = load(folder / "robot.toml").parameters
    assert kept["joint0.viscous_forwards"].start == 3.0 and not kept["joint0.viscous_forwards"].free
    assert (kept["joint0.viscous_backwards"].start, kept["joint0.viscous_backwards"].lower) == (None, 1.0)


@pytest.mark.parametrize(
    "said",
    [
        'friction = "drifting"\nparameters = { viscous_drift = 0.1 }',
        'friction = "stribeck"\nspring = { stiffness = 9.0 }\nstribeck_speed = 0.1\n'
        "parameters = { load_stribeck_force = 0.5 }",
        'spring = { law = "elastic-load", stiffness = 9.0 }',
        'model = "flexible"',
        'friction = "stribeck"',
        'gravity = { load = "link" }',
        "ripple = { period = 0.1 }",
    ],
)
def test_what_a_robot_has_not_is_refused_but_for_the_axis_alone(folder: Path, said: str) -> None:
    text = TEXT.replace("viscous = 3.0", said)
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ji.JointFileError, match=r"^joints\.1"):
        load(folder / "robot.toml")
    assert load(folder / "robot.toml", axis="joint0").axis.name == "joint0"


LAWS = """friction = "presliding"
rotor_inertia = 0.5
viscous = 3.0
spring = { law = "hysteretic", stiffness = 1e4 }
parameters.motor_presliding_distance = 1e-3
parameters.load_presliding_distance = { start = 2e-3 }
parameters.hysteresis_stiffness = 300.0
parameters.hysteresis_torque = 1.0
"""


def test_a_robot_takes_the_laws_of_its_joints_and_their_numbers(folder: Path) -> None:
    file = loads(TEXT.replace("viscous = 3.0\n", LAWS), folder)
    first = file.robot.joints[0]
    assert first.friction == FRICTIONS["presliding"] and first.viscous == 3.0
    assert first.spring == ji.robots.JointSpring(1e4, law=SPRINGS["hysteretic"])
    assert first.numbers == {
        "motor_presliding_distance": 1e-3, "load_presliding_distance": 2e-3, "hysteresis_stiffness": 300.0,
        "hysteresis_torque": 1.0,
    }  # fmt: skip
    again = loads(dumps(file), folder)
    assert again.robot.joints == file.robot.joints and again.axes == file.axes
    with pytest.raises(ji.MethodError, match="presliding"):
        file.identify(file.record())


def test_a_method_and_a_friction_are_chosen_as_of_a_joint_file(folder: Path) -> None:
    text = TEXT.replace("[record]", "[method]\nlog_delay = 0.001\n[record]")
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    kept = load(folder / "robot.toml", ["method.name=drive_side"])
    assert kept.method == ji.DriveSideFit(log_delay=0.001)
    friction = [f"joints.{number}.friction=asymmetric" for number in (1, 2, 3)]
    file = load(folder / "robot.toml", ["method={name='idim'}", *friction])
    assert file.method == ji.IDIM() and all(one.law.two_ways for one in file.robot.joints)
    again = loads(dumps(file), folder)
    assert again.robot.joints == file.robot.joints
