"""A found joint or robot is kept in a file, and gives the torque of a motion."""

from __future__ import annotations

import copy
import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError, RecordError
from jointid.common.fields import dumps
from jointid.models.robots.dynamics import inverse_dynamics
from jointid.models.robots.robot import Robot
from jointid.output.json import read_report
from jointid.records.signals.filtering import window_torque
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_plants import two

JOINT = ji.RigidJoint("revolute", friction=ji.friction.AsymmetricFriction(), gravity=ji.Gravity("link"))
VALUES = {
    "inertia": 0.8, "viscous_forwards": 1.1, "viscous_backwards": 1.4, "coulomb_forwards": 2.0,
    "coulomb_backwards": 1.7, "offset": 0.0, "gravity_cos": 4.0, "gravity_sin": -1.0,
}  # fmt: skip


@cache
def found(kind: str) -> ji.Estimate:
    """Return the estimate of a joint, or of a robot by a method."""
    if kind == "joint":
        law = ji.controller.PD(position_gain=900.0, derivative_gain=60.0)
        loop = ji.ClosedLoop(JOINT, law)
        reference = ji.excitation.trapezoids((0.5, 1.0), 4.0, 1.0, sample_time=1e-3, rest=0.2, duration=4.0)
        return ji.identify(ji.simulated_record(loop, reference, VALUES, sample_time=1e-3), loop, checks=False)
    loop = two().loop()
    return ji.identify(
        recorded(loop, two().records(4.0), 0.01)[0], loop if kind == "didim" else loop.robot, checks=False
    )


def setup_of(kind: str) -> object:
    loop = found(kind).settings.loop if kind == "joint" else two().loop()
    return loop.robot if kind == "idim" else loop  # type: ignore[union-attr]


def motion(n: int) -> list[np.ndarray]:
    """Return position, velocity and acceleration, (samples, n), and of the joint (samples,)."""
    random = np.random.default_rng(3)
    return [random.normal(size=(40, n) if n else 40) for _ in range(3)]


def torque_of(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return the torques of a robot with rigid joints and symmetric friction, by its links."""
    links = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
    rotor, viscous, coulomb, offset = (
        robot.of_joints(name) for name in ("rotor_inertia", "viscous", "coulomb", "offset")
    )
    return np.asarray(links + rotor * a + viscous * v + coulomb * np.sign(v) + offset)


@pytest.mark.parametrize("kind", ["joint", "idim", "didim"])
def test_a_kept_estimate_gives_the_torque_of_a_motion(kind: str, tmp_path: Path) -> None:
    estimate = found(kind)
    back = ji.load_estimate(estimate.save(tmp_path / "out.json"), setup_of(kind))  # type: ignore[arg-type]
    q, v, a = motion(0 if kind == "joint" else 2)
    torque = back.torque(q, v, a)
    np.testing.assert_allclose(torque, estimate.torque(q, v, a), rtol=1e-12)
    np.testing.assert_allclose(back.regressor(q, v, a) @ np.array([*back.values.values()]), torque, rtol=1e-12)
    np.testing.assert_allclose(back.torque(q[0], v[0], a[0]), torque[0], rtol=1e-12)
    if kind == "joint":
        x = back.values
        friction = np.where(
            v > 0,
            x["viscous_forwards"] * v + x["coulomb_forwards"],
            x["viscous_backwards"] * v - x["coulomb_backwards"],
        )
        weight = x["gravity_cos"] * np.cos(q) + x["gravity_sin"] * np.sin(q) + x["offset"]
        expected = x["inertia"] * a + friction + weight
    else:
        expected = torque_of(back.require_robot().robot(), q, v, a)
    np.testing.assert_allclose(torque, expected, rtol=1e-9, atol=1e-9)
    assert back.to_dict()["parameters"] == estimate.to_dict()["parameters"]
    with pytest.raises(MethodError):
        back.torque(q, v[:-1], a)


@pytest.mark.parametrize("kind", ["joint", "idim", "didim"])
def test_an_estimate_of_the_first_form_is_read(kind: str, tmp_path: Path) -> None:
    stored = json.loads(Path(__file__).with_name("estimates_of_0_3.json").read_text("utf-8"))[kind]
    (tmp_path / "old.json").write_text(json.dumps(stored), "utf-8")
    back, now = ji.load_estimate(tmp_path / "old.json", setup_of(kind)), found(kind)  # type: ignore[arg-type]
    assert back.values == pytest.approx(now.values, rel=1e-6)
    assert [row.stderr for row in back.params.rows] == [row["std"] for row in stored["parameters"].values()]
    # The joint's record has no noise: its deviations are rounding, which differs from machine to machine.
    np.testing.assert_allclose(back.params.correlation, stored["correlation"], atol=1e-6)
    assert back.settings.filtering == now.settings.filtering
    assert set(back.data.fingerprints) == {stored["record"]["torque_sha256"]}
    assert back.fit.position_rms == pytest.approx(now.fit.position_rms)
    assert kind == "joint" or back.sentence == now.sentence
    change = ji.compare(*(read_report(path) for path in (tmp_path / "old.json", now.save(tmp_path / "new.json"))))
    assert [row.after for row in change.rows] == pytest.approx([row.before for row in change.rows], rel=1e-6)


def test_a_flexible_joint_moves_as_one_in_a_feed_forward() -> None:
    axis = ji.twin("L19", noise="none")
    estimate = replace(found("joint"), settings=replace(found("joint").settings, system=axis.loop.joint, loop=None))
    rows = tuple(
        replace(found("joint").params.rows[0], name=name, symbol=name, value=value)
        for name, value in axis.truth.items()
        if name in {p.name for p in axis.loop.joint.parameters}
    )
    estimate = replace(estimate, params=replace(estimate.params, rows=rows))
    x, whole = estimate.values, estimate.torque(0.3, 0.2, 2.0)
    moved = sum(
        2.0 * x[f"{side}_inertia"] + 0.2 * x[f"{side}_viscous"] + x[f"{side}_coulomb"] for side in ("motor", "load")
    )
    assert whole == pytest.approx(moved + x["offset"])


def places(part: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every part of a document."""
    for key, value in part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ():
        yield (*path, key)
        yield from places(value, (*path, key))


def spoiled(document: dict[str, Any], every: int) -> Iterator[dict[str, Any]]:
    """Yield the document with a part removed, or replaced by what does not belong there, one of so many ways."""
    ways = itertools.product(places(document), (..., None, "x", 1e300, -1.0, [1], {"a": 1}))
    for path, value in itertools.islice(ways, 0, None, every):
        changed = part = copy.deepcopy(document)
        for key in path[:-1]:
            part = part[key]
        if value is ...:
            del part[path[-1]]
        else:
            part[path[-1]] = value
        yield changed


@pytest.mark.parametrize("kind", ["joint", "idim", "didim"])
@pytest.mark.parametrize("every", [499, pytest.param(7, marks=pytest.mark.hostile)])
def test_a_damaged_estimate_is_used_or_refused_in_a_sentence(kind: str, every: int, tmp_path: Path) -> None:
    path, parts = tmp_path / "out.json", motion(0 if kind == "joint" else 2)
    document, tried, refused = json.loads(dumps(found(kind).to_dict())), 0, 0
    for changed in spoiled(document, every):
        path.write_text(json.dumps(changed), "utf-8")
        tried += 1
        try:
            back = ji.load_estimate(path, setup_of(kind))  # type: ignore[arg-type]
            assert back.sentence and back.summary(details=True)
            back.torque(*parts)
            ji.export(back, "urdf")
        except ji.JointidError as error:
            refused += 1
            assert "\n" not in str(error)
    assert 0 < refused < tried


def test_an_error_that_is_not_known_is_not_relied_on(tmp_path: Path) -> None:
    path, document = tmp_path / "out.json", found("joint").to_dict()
    unknown = document["fit"] | {"filtered_error": None, "relative_error": None}
    path.write_text(dumps(document | {"fit": unknown}), "utf-8")
    assert "Do not rely on it yet" in ji.load_estimate(path, setup_of("joint")).sentence  # type: ignore[arg-type]
    for part, key in (("fit", "converged"), ("checks", "verdicts"), ("checks", "warnings"), ("fit", "filtered_error")):
        lacking = {name: value for name, value in document[part].items() if name != key}
        path.write_text(dumps(document | {part: lacking}), "utf-8")
        with pytest.raises(RecordError):
            ji.load_estimate(path, setup_of("joint"))  # type: ignore[arg-type]


def test_a_delay_that_is_longer_than_the_record_is_refused() -> None:
    torque = ji.Channel(np.zeros(100), "N m", 1e-3, "held")
    for delay in (1e300, 1e6, -0.2, float("nan")):
        with pytest.raises(RecordError):
            window_torque(torque, delay)
