"""What examples/kr300/README.md says of the real records is what comes out, of each axis alone and of all at once."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import jointid as ji
from jointid.config import File
from jointid.estimation.parameters import mass_matrix_at
from jointid.estimation.result.verdict import Trust
from tests.estimates import beside_tables, errors_of_bodies
from tests.estimation.robots.twin import identified

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "kr300"
PAGE = (EXAMPLE / "README.md").read_text(encoding="utf-8")
OF_AXES = re.findall(r"^\| (\d) \| ([AB]) \| (.*) \|$", PAGE, re.MULTILINE)
OF_THE_ROBOT = re.findall(r"^\| ([AB]) on ([AB]) \| (.*) \|$", PAGE, re.MULTILINE)


def axis(number: int, data_dir: Path, record: str) -> tuple[File, ji.Record]:
    file = ji.load(EXAMPLE / f"axis{number}.toml")
    return file, file.record(data_dir / "kr300" / f"rec_{record}.mat")


@pytest.mark.parametrize(("number", "name", "cells"), OF_AXES)
def test_the_table_of_axes_is_what_comes_out(data_dir: Path, number: str, name: str, cells: str) -> None:
    file, record = axis(int(number), data_dir, name)
    estimate = ji.identify(record, file.joint, file.method)
    values = [estimate[each] for each in ("inertia", "viscous", "coulomb", "offset")]
    found = [part for one in values for part in (one.value or 0.0, 2 * (one.stderr or 0.0))]
    found.append(100 * estimate.fit.filtered_error)
    assert [float(text) for text in re.findall(r"-?[\d.]+", cells)] == pytest.approx(found, rel=0.01, abs=1.0)


@pytest.mark.parametrize(("number", "name"), [(1, "A"), (3, "A")])
def test_both_encoders_are_refused(data_dir: Path, number: int, name: str) -> None:
    _, record = axis(number, data_dir, name)
    with pytest.raises(ji.MethodError):
        ji.identify(record, ji.FlexibleJoint("revolute"), ji.IDIM())


BOTH = [(1, "B", 350.0, 2329.0), (2, "A", 0.787e6, 0.231e6), (3, "B", 3152.0, 18270.0)]
BOTH += [pytest.param(2, "B", 0.505e6, 0.901e6, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("number", "name", "stiffness", "two_sigma"), BOTH)
def test_a_stiffness_from_both_encoders_is_not_relied_on(
    data_dir: Path, number: int, name: str, stiffness: float, two_sigma: float
) -> None:
    _, record = axis(number, data_dir, name)
    estimate = ji.identify(record, ji.FlexibleJoint("revolute"), ji.IDIM())
    spring, trust = estimate["K12"], estimate.answer.trust
    assert (spring.value, 2 * (spring.stderr or 0.0)) == pytest.approx((stiffness, two_sigma), rel=0.05)
    assert trust.code == Trust.NOT_YET
    assert "encoder_lag" in trust.values["reasons"] and "stamps of" in beside_tables(estimate)["next"]


@pytest.fixture(scope="module")
def file() -> File:
    pytest.importorskip("mujoco", reason="reads the robot's model")
    return ji.load(EXAMPLE / "robot.toml")


def test_the_mass_matrix_is_the_nominal_one(file: File, data_dir: Path) -> None:
    data = loadmat(data_dir / "kr300" / "rec_B.mat", squeeze_me=True, struct_as_record=False)
    for k in range(0, 2501, 500):
        found = np.diag(mass_matrix_at(file.robot.tree, file.robot.inertials, data["ref_kin"].phi_r_all[k]))
        assert found + file.robot.of_joints("rotor_inertia") == pytest.approx(data["m_all"][:, k], rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second", "cells"), OF_THE_ROBOT)
def test_the_table_of_the_robot_is_what_comes_out(
    file: File, data_dir: Path, first: str, second: str, cells: str
) -> None:
    records = {name: file.records(data_dir / "kr300" / f"rec_{name}.mat") for name in "AB"}
    estimate = identified(file.robot, records[first])
    found = ji.validate(estimate, records[second])
    bodies = errors_of_bodies(estimate, ji.robots.consistent_robot(estimate).robot, records[second])
    each = ([a.filtered_error for a in found.axes], [a.nominal_error for a in found.axes], bodies)
    errors = np.array(each, dtype=float).ravel()
    assert [float(text) for text in re.findall(r"[\d.]+", cells)] == pytest.approx(100 * errors, rel=0.05, abs=0.3)


@pytest.mark.parametrize("name", ["A", "B"])
def test_its_springs_are_refused_on_the_drive_side(file: File, data_dir: Path, name: str) -> None:
    joints = tuple(
        replace(joint, spring=ji.robots.JointSpring(stiffness) if stiffness else None)
        for joint, stiffness in zip(file.robot.joints, (4.58e6, 7.52e6, 4.10e6, 0, 0, 0), strict=True)
    )
    with pytest.raises(ji.MethodError):
        identified(
            replace(file.robot, joints=joints), file.records(data_dir / "kr300" / f"rec_{name}.mat"), ji.DriveSideFit()
        )
