"""Bodies of arms as they are published: they predict what the estimate predicts, are possible, and near the model's."""

from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.models.robots.inertial import inertia_matrix, mass_properties
from jointid.models.robots.robot import Robot
from jointid.output.export import export
from tests.estimates import errors_of_bodies
from tests.estimation.robots.twin import identified, motion, records_of
from tests.models.robots.trees import inverse_dynamics
from tests.public_arms import ARMS, real_arm, urdf_of

pytest.importorskip("mujoco")


def load(text: str, path: Path) -> Robot:
    path.write_text(text, "utf-8")
    return ji.robots.load_robot(str(path))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [3e-4, 0.02])
@pytest.mark.parametrize("name", ARMS)
def test_exported_bodies_of_an_arm_without_rotors_predict_as_its_estimate(
    name: str, noise: float, tmp_path: Path
) -> None:
    model = load(urdf_of(name), tmp_path / "arm.urdf")
    arm = real_arm(model, 7)
    estimate = identified(model, records_of(arm, 2, share=noise))
    found = ji.robots.consistent_robot(estimate)
    rotors = found.robot.of_joints("rotor_inertia")
    assert found.misfit < 1.0 and rotors[2:] == pytest.approx(arm.of_joints("rotor_inertia")[2:], rel=0.2)
    exported = load(export(found.robot, "mjcf").text, tmp_path / "found.xml")
    assert exported.of_joints("rotor_inertia") == pytest.approx(rotors)
    own = load(export(found.robot, "urdf", model=tmp_path / "arm.urdf").text, tmp_path / "own.urdf")
    for one in (exported, own):
        np.testing.assert_allclose(one.inertials, found.robot.inertials, rtol=1e-5, atol=1e-7)
    kept = ji.load_estimate(estimate.save(tmp_path / "out.json"), model)
    q, v, a = (one[::250] for one in motion(3, len(model)))
    torque = estimate.torque(q, v, a)
    np.testing.assert_allclose(kept.torque(q, v, a), torque, rtol=1e-9, atol=1e-11 * np.abs(torque).max())
    of_bodies = inverse_dynamics(own.tree, own.inertials, q, v, a) + rotors * a + found.robot.of_joints("viscous") * v
    of_bodies += found.robot.of_joints("coulomb") * np.sign(v) + found.robot.of_joints("offset")
    assert np.all(np.linalg.norm(of_bodies - torque, axis=0) < 0.02 * np.linalg.norm(torque, axis=0))
    held_out = ji.validate(estimate, records_of(arm, 3, share=noise))
    for axis, left in zip(
        held_out.axes, errors_of_bodies(estimate, found.robot, records_of(arm, 3, share=noise)), strict=True
    ):
        assert left is not None and left <= 1.2 * axis.filtered_error
    for link, declared in zip(exported.links, model.links, strict=True):
        moments = np.linalg.eigvalsh(mass_properties(link.inertial).inertia)
        assert link.inertial[0] > 0.0 < moments[0] and moments[2] <= moments[0] + moments[1]
        own, nominal = (np.sqrt(np.trace(inertia_matrix(one.inertial)) / one.inertial[0]) for one in (link, declared))
        assert 0.5 * nominal < own < 2.0 * nominal
