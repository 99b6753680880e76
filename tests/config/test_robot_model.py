"""Robots read from URDF and MJCF: where links are, what they weigh, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import JointFileError
from jointid.config.robot_model import load_robot, read_robot
from jointid.models.limits import AxisLimits
from tests.models.robots.trees import as_mjcf, by_mujoco, inverse_dynamics, random_robot

pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")

URDF = """
<robot name="two">
  <link name="base"><visual><geometry><mesh filename="package://nowhere/base.stl"/></geometry></visual></link>
  <joint name="lift" type="prismatic">
    <parent link="arm"/><child link="rod"/><origin xyz="1 0 0" rpy="0 1.5707963267948966 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 0.5" rpy="0 0 0"/><axis xyz="0 1 0"/>
    <dynamics damping="3" friction="4"/>
  </joint>
  <link name="arm"><inertial><origin xyz="0.5 0 0" rpy="0 0 0"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/></inertial>
    <collision><geometry><mesh filename="../../etc/passwd"/></geometry></collision></link>
  <link name="rod"/>
  <joint name="weld" type="fixed"><parent link="rod"/><child link="tool"/><origin xyz="0 0 0.3" rpy="0 0 0"/></joint>
  <link name="tool"><inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="5"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <transmission name="t"><joint name="turn"/></transmission>
</robot>
"""


@pytest.mark.parametrize("seed", range(5))
def test_a_tree_written_as_mjcf_comes_back(seed: int) -> None:
    robot = random_robot(seed)
    found, _ = read_robot(as_mjcf(robot))
    assert sorted(found.names) == sorted(robot.names)
    order = [robot.names.index(name) for name in found.names]
    random = np.random.default_rng(seed)
    q, v, a = random.normal(size=(3, 4, 6))
    expected = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
    moved = [np.ascontiguousarray(one[:, order]) for one in (q, v, a)]
    torque = inverse_dynamics(found.tree, found.inertials, *moved)
    assert np.abs(torque - expected[:, order]).max() < by_mujoco(1e-11) * np.abs(expected).max()
    assert found.of_joints("rotor_inertia") == pytest.approx(robot.of_joints("rotor_inertia")[order])


def test_a_urdf_without_its_meshes_in_order_of_its_tree() -> None:
    robot, _ = read_robot(URDF)
    assert (robot.name, robot.names, [link.parent for link in robot.links]) == ("two", ("turn", "lift"), [-1, 0])
    assert [link.kind for link in robot.links] == ["revolute", "prismatic"]
    assert (robot.joints[0].viscous, robot.joints[0].coulomb) == (3.0, 4.0)
    assert robot.links[0].origin.tolist() == [0, 0, 0.5]
    # A fixed tool is a part of the rod, which says no mass of its own.
    assert robot.links[1].inertial == pytest.approx([5, 0, 0, 1.5, 1.45, 0, 0, 1.45, 0, 1], abs=1e-11)
    rest = np.zeros((1, 2))
    torque = inverse_dynamics(robot.tree, robot.inertials, rest, rest, rest)
    assert torque[0] == pytest.approx([-9.81 * (2 * 0.5 + 5 * 1.3), 0.0], abs=1e-9)


def test_joints_of_one_body_and_a_position_that_does_not_begin_at_zero() -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><body name="b" pos="1 0 0">
      <joint name="x" type="slide" axis="1 0 0" ref="0.25"/><joint name="r" pos="0 0.2 0" axis="0 0 2" ref="0.5"/>
      <geom type="sphere" size="0.1" mass="2" pos="0.3 0 0"/><body name="c" pos="0.4 0 0">
      <joint name="s" pos="0 0.1 0" axis="0 0 1"/><geom type="sphere" size="0.1" mass="1" pos="0.2 0 0"/>
      </body></body></worldbody></mujoco>"""
    robot, _ = read_robot(text)
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    data, (q, v, a) = mujoco.MjData(model), np.array([[0.4, -0.3, 0.7], [1.0, 2.0, -1.5], [3.0, -1.0, 2.0]])
    data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
    mujoco.mj_inverse(model, data)
    found = inverse_dynamics(robot.tree, robot.inertials, q[None], v[None], a[None])
    assert found[0] == pytest.approx(data.qfrc_inverse, rel=1e-12)


def mjcf(inside: str, beside: str = "") -> str:
    body = '<body name="b"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    return f'<mujoco><worldbody>{body}<joint name="j"/>{inside}</body></worldbody>{beside}</mujoco>'


@pytest.mark.parametrize(
    "text",
    [
        mjcf('<body><joint name="k" type="ball"/></body>'),
        mjcf("<body><freejoint/></body>"),
        mjcf("", '<equality><connect body1="b" anchor="0 0 0"/></equality>'),
        mjcf("", '<equality><joint joint1="j"/></equality>'),
        mjcf("", '<equality><joint joint1="j" polycoef="many"/></equality>'),
        mjcf("", '<include file="/etc/passwd"/>'),
        mjcf('<body><joint name="s" stiffness="3"/></body>'),
        URDF.replace('type="continuous"', 'type="floating"'),
        URDF.replace('<axis xyz="0 1 0"/>', '<mimic joint="lift"/>'),
        URDF.replace('<axis xyz="0 1 0"/>', '<mimic joint="none"/>'),
        URDF.replace('<parent link="base"/>', '<parent link="none"/>'),
        URDF.replace('<child link="rod"/>', '<child link="base"/>'),
        "<!DOCTYPE x><robot/>",
        '<?x <!-- ?><!DOCTYPE x [<!ENTITY a "b">]><robot/><!-- -->',
        '<robot xmlns:xacro="http://x"><xacro:include filename="a"/></robot>',
        URDF.replace('value="5"', 'value="NaN"'),
        URDF.replace('xyz="1 0 0"', 'xyz="1 -inf 0"'),
        URDF.replace('xyz="0.5 0 0"', 'xyz="1e200 0 0"'),
        "<sdf/>",
        "<robot>" + "<link>" * 400 + "</link>" * 400 + "</robot>",
        mjcf("").replace('diaginertia="1 1 1"', 'diaginertia="1 1 3"'),
    ],
)
def test_models_that_are_refused(text: str) -> None:
    with pytest.raises(JointFileError):
        read_robot(text, "arm.xml")


@pytest.mark.parametrize(
    ("text", "locked", "remarks"),
    [
        (mjcf('<freejoint name="base"/>'), "base", 0),
        (mjcf('<body name="m"><joint name="k" type="ball"/><geom size="1"/></body>'), "k", 0),
        (mjcf("").replace('<body name="b">', '<geom mesh="m"/><body name="b">'), "", 0),
        (mjcf('<body name="m"><geom mesh="m"/></body>'), "", 1),
        (URDF.replace('type="continuous"', 'type="floating"'), "turn", 0),
        (URDF.replace('<parent link="base"/>', '<parent link="world"/>'), "", 0),
        (URDF.replace('friction="4"', 'friction="-4"'), "", 1),
        (URDF.replace('izz="0.25"', 'izz="0.3000001"'), "", 0),  # a rounded plate
        (URDF.replace('ixy="0" ixz="0" iyy="0.2" iyz="0"', 'iyy="0.2"'), "", 0),
        (URDF.replace('<mass value="5"/>', ""), "", 1),
        (mjcf("", '<default><joint damping="1"/></default><actuator><motor joint="j"/></actuator>'), "", 0),
    ],
)
def test_habits_of_public_models_are_read(text: str, locked: str, remarks: int) -> None:
    robot, _ = read_robot(text, locked=dict.fromkeys(filter(None, [locked]), 0.0))
    assert robot.names[-1] in ("j", "lift") and len(robot.remarks) == remarks
    assert all(joint.coulomb >= 0.0 for joint in robot.joints)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('value="5"', 'value="-5"'),
        ('ixx="1"', 'ixx="-1"'),
        ('ixx="1"', 'ixx="3"'),
        ('ixy="0" ixz="0" iyy="1"', 'ixy="2" iyy="1"'),
    ],
)
def test_masses_that_no_body_has_are_unknown(old: str, new: str) -> None:
    assert old in URDF
    robot, _ = read_robot(URDF.replace(old, new), "arm.urdf")
    assert len(robot.remarks) == 1 and robot.remarks[0].startswith("arm.urdf: link tool has")
    assert not np.any(robot.inertials[1]) and robot.inertials[0][0] == 2.0


@pytest.mark.parametrize(("right", "wrong", "named"), [("1 0 0", "1, 0 0", "joint lift"), ("0.25", "a", "link arm")])
def test_a_number_that_is_none_is_named_by_its_joint_or_link(right: str, wrong: str, named: str) -> None:
    with pytest.raises(JointFileError, match=named):
        read_robot(URDF.replace(f'"{right}"', f'"{wrong}"'))


def test_a_finger_that_follows_another_is_locked_with_it() -> None:
    finger = (
        '<link name="tip"/><joint name="finger" type="continuous"><parent link="rod"/><child link="tip"/>'
        '<mimic joint="lift"/></joint></robot>'
    )
    text = URDF.replace("</robot>", finger)
    robot, _ = read_robot(text, locked={"lift": 0.02, "finger": 0.02})
    assert robot.names == ("turn",) and robot.inertials[0, 0] == 7.0
    assert read_robot(text.replace('finger" type="continuous"', 'finger" type="fixed"'))[0].names == ("turn", "lift")
    with pytest.raises(JointFileError):
        read_robot(text)
    with pytest.raises(JointFileError, match="finger follows none"):
        read_robot(text.replace('mimic joint="lift"', 'mimic joint="none"'))


def test_files_that_are_no_model(tmp_path: Path) -> None:
    (tmp_path / "long.urdf").write_bytes(b" " * (2**23 + 1))
    (tmp_path / "image.urdf").write_bytes(b"\xff\xd8\xff")
    for name in ("none.urdf", "long.urdf", "image.urdf"):
        with pytest.raises(JointFileError):
            load_robot(tmp_path / name)
    (tmp_path / "two.urdf").write_text(URDF, encoding="utf-8")
    assert load_robot(tmp_path / "two.urdf").names == ("turn", "lift")


@pytest.mark.parametrize(
    "text",
    [
        mjcf("<body/>" * 5001),
        mjcf("", "<equality>" + '<weld body1="b"/>' * 5001 + "</equality>"),
        URDF.replace("</robot>", "".join(f'<link name="l{k}"/>' for k in range(5001)) + "</robot>"),
        URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/>' + '<mimic joint="lift"/>' * 5001),
    ],
)
def test_a_model_is_counted_before_it_is_compiled(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.config.robot_model.extra", lambda *_: pytest.fail("it would be compiled"))
    with pytest.raises(JointFileError):
        read_robot(text)


def test_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """MuJoCo warns of what it could not simulate on the terminal, and in a log in the current folder."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(JointFileError):
        read_robot(mjcf("").replace('name="j"', 'name="j" armature="-10"'))
    assert not list(tmp_path.iterdir()) and capfd.readouterr().err == ""


HAND = """<mujoco><worldbody>
<body name="arm"><joint name="lift" axis="0 1 0"/><inertial pos="0.3 0 0" mass="3" diaginertia="0.1 0.2 0.3"/>
<body name="wrist" pos="0.5 0 0"><joint name="turn" axis="0 0 1"/>
<inertial pos="0.1 0.02 0" mass="1" diaginertia="0.01 0.02 0.02"/>
<body name="left" pos="0.2 0 0"><joint name="grip" type="slide" axis="0 1 0"/>
<inertial pos="0 0.01 0" mass="0.4" diaginertia="1e-3 2e-3 2e-3"/>
<body name="tip" pos="0 0.1 0"><joint name="bend" axis="1 0 0"/>
<inertial pos="0 0 0.05" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body></body></body></body>
</worldbody>{}</mujoco>"""
TIE = '<equality><joint joint1="bend" joint2="grip" polycoef="0.2 30"/></equality>'


@pytest.mark.parametrize(("tie", "locked"), [(TIE, {"grip": 0.03, "bend": 1.1}), ("", {"turn": 0.7, "bend": -0.4})])
def test_locked_joints_load_the_others_as_if_they_stood_still(tie: str, locked: dict[str, float]) -> None:
    (whole, _), (left, _) = read_robot(HAND.format("")), read_robot(HAND.format(tie), locked=locked)
    moving = [k for k, name in enumerate(whole.names) if name in left.names]
    assert left.names == tuple(name for name in whole.names if name not in locked)
    rng = np.random.default_rng(4)
    motion = rng.standard_normal((3, 20, len(left)))
    full = np.zeros((3, 20, len(whole)))
    full[:, :, moving] = motion
    for k, name in enumerate(whole.names):
        if k not in moving:
            full[0, :, k] = locked[name]
    torque = inverse_dynamics(left.tree, left.inertials, *motion)
    assert torque == pytest.approx(inverse_dynamics(whole.tree, whole.inertials, *full)[:, moving], abs=1e-12)


@pytest.mark.parametrize(
    ("tie", "locked"),
    [
        (TIE, {}),
        (TIE, {"bend": 0.1}),
        (TIE, {"grip": 0.1}),
        ("", {"lid": 0.1}),
        ('<equality><weld body1="tip" body2="wrist"/></equality>', {"bend": 0.1}),
    ],
)
def test_a_tie_between_joints_that_move_names_the_key(tie: str, locked: dict[str, float]) -> None:
    text, locked = HAND.format(tie).replace("grip", "gr'p"), {one.replace("grip", "gr'p"): 0.1 for one in locked}
    with pytest.raises(JointFileError, match=r"""robot\.locked(?!.*\{ (?!"(bend|gr'p)"))"""):  # as TOML quotes it
        read_robot(text, locked=locked)


def test_limits_are_those_of_the_model_and_a_turned_zero_moves_them() -> None:
    robot, _ = read_robot(URDF.replace('effort="1"', 'effort="0"').replace('velocity="1"', 'velocity="0.3"'))
    assert [link.limits for link in robot.links] == [AxisLimits(), AxisLimits(-1.0, 1.0, speed=0.3)]
    assert robot.links[1].turn(0.25).limits == AxisLimits(-1.25, 0.75, speed=0.3)


def test_a_hundred_joints_may_move_however_many_are_locked() -> None:
    joint = '<body pos="0.1 0 0"><joint name="j{}"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    text = f"<mujoco><worldbody>{''.join(map(joint.format, range(120)))}{'</body>' * 120}</worldbody></mujoco>"
    robot, _ = read_robot(text, locked={f"j{k}": 0.0 for k in range(118)})
    assert robot.names == ("j118", "j119")
    for count in (120, 0):
        with pytest.raises(JointFileError, match=rf"{count} joints move; .*robot\.locked"):
            read_robot(text, locked={f"j{k}": 0.0 for k in range(120 - count)})
