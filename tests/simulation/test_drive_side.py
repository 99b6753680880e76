"""The load behind a motor whose motion is prescribed: against an independent integration, finer steps, differences."""

import numpy as np
import pytest

from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.paper.twin import TABLE_2
from jointid.simulation.drive_side import LOAD_STATE, PARTS, DriveSideRun, prescribe, run_drive_side
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.simulate import motion_of
from tests.plants import prismatic, with_law
from tests.simulation.differences import drive_side_slopes

T = 1e-3
JOINT = FlexibleJoint("prismatic")


def run_along(position: np.ndarray, values: dict[str, float], parts: int = PARTS, joint: Joint = JOINT) -> DriveSideRun:
    return run_drive_side(prescribe(position[:, np.newaxis], T, parts), Numbers.of_joint(joint, values))


def wave(samples: int = 3000, pause: bool = False) -> np.ndarray:
    """A motor position with components up to 60 Hz; with a pause in which a load comes to rest."""
    t = np.arange(samples) * T
    q = 0.02 * np.sin(2 * np.pi * 1.3 * t) + 8e-4 * np.sin(2 * np.pi * 23 * t) + 1e-4 * np.sin(2 * np.pi * 60 * t)
    if pause:  # eased in and out, so that the spline has nothing to ring about
        hold = 1 / (1 + np.exp(-(np.abs(t - 1.5) - 0.5) / 0.02))
        q = 0.02 * np.sin(2 * np.pi * 0.5 * (t - 1.5)) * hold
    return q


@pytest.mark.parametrize("coulomb", [10.4, 60.0])
def test_four_parts_of_a_sample_are_enough(coulomb: float) -> None:
    values = TABLE_2 | {"load_coulomb": coulomb}
    torques = [run_along(wave(), values, parts).torque.reshape(-1, parts).mean(axis=1) for parts in (1, PARTS, 32)]
    coarse, fine, _ = (np.linalg.norm(torque - torques[2]) / np.linalg.norm(torques[2]) for torque in torques)
    assert fine < 1e-5
    assert coarse / fine > 5.0


def test_a_load_that_sticks_stands_still_and_stores_its_deflection() -> None:
    values = TABLE_2 | {"load_coulomb": 60.0}
    run = run_along(wave(pause=True), values)
    position, velocity, *_ = motion_of(run.tape, 2, len(run.torque) + 1)
    still = velocity[:, 1] == 0
    assert 0.2 < np.mean(still) < 0.6
    longest = np.flatnonzero(still)
    held = np.split(longest, np.flatnonzero(np.diff(longest) > 1) + 1)
    assert all(np.ptp(position[part, 1]) < 1e-15 for part in held)
    assert max(map(len, held)) > 0.5 / T * PARTS


@pytest.mark.parametrize("pause", [False, True])
def test_derivatives_are_those_of_differences(pause: bool) -> None:
    loop, values = with_law(prismatic(1), "symmetric" if pause else "asymmetric")
    joint = loop.joint
    values |= {"initial_load_position": 1e-4, "initial_load_velocity": 1e-3}
    names = tuple(p.name for p in joint.parameters) + LOAD_STATE
    run = run_along(wave(pause=pause), values, joint=joint)
    slopes = drive_side_slopes(run, [Place(0, name) for name in names])[:, 0]
    for i, name in enumerate(names):
        step = 1e-5 * abs(values[name])
        above, below = (
            run_along(wave(pause=pause), {**values, name: values[name] + by}, joint=joint) for by in (step, -step)
        )
        slope = (above.torque - below.torque)[:, 0] / (2 * step)
        assert np.linalg.norm(slope - slopes[:, i]) < 1e-4 * np.linalg.norm(slope), name


def test_a_rigid_joint_takes_its_inverse_model() -> None:
    q = wave()
    values = {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    run = run_along(q, values, joint=RigidJoint("prismatic"))
    ((_, columns),) = run.columns([Place(0, name) for name in values])
    assert np.allclose(run.torque[:, 0], columns @ np.array(list(values.values())))
    t = (np.arange((q.size - 1) * PARTS) + 0.5) * T / PARTS
    w = 2 * np.pi * np.array([1.3, 23.0, 60.0])
    acceleration = -np.sin(np.outer(t, w)) @ (np.array([0.02, 8e-4, 1e-4]) * w**2)
    inside = slice(200, -200)  # a spline knows nothing beyond its ends
    assert np.max(np.abs((columns[:, 0] - acceleration)[inside])) < 2e-3 * np.max(np.abs(acceleration))
