"""A found joint or robot is kept in a file, comes back, and gives the torque of a motion."""

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
from jointid.estimation.result.fields import dumps
from tests.estimation.robots.test_rigid_robots import recorded
from tests.estimation.robots.twin import torque_of
from tests.robots_plants import two

JOINT = ji.RigidJoint("revolute", friction=ji.friction.Friction("asymmetric"), gravity=ji.Gravity("link"))
VALUES = {
    "inertia": 0.8, "viscous_forwards": 1.1, "viscous_backwards": 1.4, "coulomb_forwards": 2.0,
    "coulomb_backwards": 1.7, "offset": 0.0, "gravity_cos": 4.0, "gravity_sin": -1.0,
}  # fmt: skip


@cache
def logged(seed: int) -> tuple[ji.robots.RobotLoop, tuple[ji.Record, ...]]:
    """Return a robot under its controllers, and a record of each of its joints."""
    loop = two().loop()
    return loop, tuple(recorded(loop, two().records(4.0 + seed), 0.01)[0])


@cache
def found(kind: str) -> ji.Estimate:
    """Return the estimate of a joint, or of a robot by a method, also with its delays."""
    if kind == "joint":
        law = ji.controller.PD(position_gain=900.0, derivative_gain=60.0)
        loop = ji.ClosedLoop(JOINT, law)
        reference = ji.excitation.trapezoids((0.5, 1.0), 4.0, 1.0, sample_time=1e-3, rest=0.2, duration=4.0)
        return ji.identify(ji.simulated_record(loop, reference, VALUES, sample_time=1e-3), loop, checks=False)
    free = ji.DIDIM(free=("delay",)) if kind == "delays" else None
    return ji.identify(logged(0)[1], setup_of(kind), free, checks=False)


def setup_of(kind: str) -> Any:
    loop = found(kind).settings.loop if kind == "joint" else logged(0)[0]
    return loop.robot if kind == "idim" else loop


def motion(n: int) -> list[np.ndarray]:
    """Return position, velocity and acceleration, (samples, n), and of the joint (samples,)."""
    random = np.random.default_rng(3)
    return [random.normal(size=(40, n) if n else 40) for _ in range(3)]


@pytest.mark.parametrize("kind", ["joint", "idim", "didim"])
def test_a_kept_estimate_gives_the_torque_of_a_motion(kind: str, tmp_path: Path) -> None:
    estimate = found(kind)
    back = ji.load_estimate(estimate.save(tmp_path / "out.json"), setup_of(kind))
    q, v, a = motion(0 if kind == "joint" else 2)
    torque = back.torque(q, v, a)
    np.testing.assert_allclose(torque, estimate.torque(q, v, a), rtol=1e-12)
    np.testing.assert_allclose(back.torque(q[0], v[0], a[0]), torque[0], rtol=1e-12)
    if kind == "joint":
        assert str(back["inertia"]) in {one.get_text() for one in back.plot().axes[0].texts}
        x = back.values
        forwards, backwards = ((x[f"viscous_{way}"] * v, x[f"coulomb_{way}"]) for way in ("forwards", "backwards"))
        friction = np.where(v > 0, sum(forwards), backwards[0] - backwards[1])
        weight = x["gravity_cos"] * np.cos(q) + x["gravity_sin"] * np.sin(q) + x["offset"]
        expected = x["inertia"] * a + friction + weight
    else:
        expected = torque_of(back.require_robot().robot(), q, v, a)
    np.testing.assert_allclose(torque, expected, rtol=1e-9, atol=1e-9)
    assert back.to_dict()["parameters"] == estimate.to_dict()["parameters"]
    with pytest.raises(ji.MethodError):
        back.torque(q, v[:-1], a)


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
@pytest.mark.parametrize("every", [211, pytest.param(7, marks=pytest.mark.hostile)])
def test_a_damaged_estimate_is_used_or_refused_in_a_sentence(kind: str, every: int, tmp_path: Path) -> None:
    path, parts = tmp_path / "out.json", motion(0 if kind == "joint" else 2)
    document, tried, refused = json.loads(dumps(found(kind).to_dict())), 0, 0
    for changed in spoiled(document, every):
        path.write_text(json.dumps(changed), "utf-8")
        tried += 1
        try:
            back = ji.load_estimate(path, setup_of(kind))
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
    assert "Do not rely on it yet" in ji.load_estimate(path, setup_of("joint")).sentence
    lacking = [{name: value for name, value in document.items() if name != key} for key in ("checks", "warnings")]
    for key in ("converged", "filtered_error"):
        lacking.append(document | {"fit": {name: value for name, value in document["fit"].items() if name != key}})
    for one in lacking:
        path.write_text(dumps(one), "utf-8")
        with pytest.raises(ji.RecordError):
            ji.load_estimate(path, setup_of("joint"))


@pytest.mark.parametrize(
    "method", ["idim", *(pytest.param(name, marks=pytest.mark.slow) for name in ("didim", "delays"))]
)
def test_a_saved_estimate_of_a_robot_comes_back(method: str, tmp_path: Path) -> None:
    estimate, system = found(method), setup_of(method)
    path = estimate.save(tmp_path / "out.json")
    back = ji.load_estimate(path, system)
    assert back.to_dict() == estimate.to_dict()
    path.write_text(dumps(back.to_dict() | {"warnings": ["said in other words"], "notes": []}), "utf-8")
    assert ji.load_estimate(path, system).answer.trust.code == estimate.answer.trust.code
    assert back.summary(details=True) == estimate.summary(details=True)
    np.testing.assert_allclose(back.correlation, estimate.correlation, rtol=1e-12)
    assert back.data.fingerprints == estimate.data.fingerprints
    assert back.settings.filtering == estimate.settings.filtering
    unseen = logged(1)[1]
    one, other = (ji.validate(each, unseen) for each in (back, estimate))
    np.testing.assert_allclose(*([a.filtered_error for a in check.axes] for check in (one, other)), rtol=1e-9)
    assert one.nominal_error == pytest.approx(other.nominal_error, rel=1e-9)
    assert ji.validate(back, logged(0)[1]).test == "direct"
    xml = [ji.export(each, "urdf").text for each in (back, estimate)]
    assert xml[0] == xml[1]
    read, fresh = (each.require_robot().robot().of_joints("viscous") for each in (back, estimate))
    np.testing.assert_allclose(read, fresh, rtol=1e-12)
    said = ji.Report.of(back, logged(0)[1])
    assert json.loads(said.answer())["estimate"]["parameters"] == estimate.to_dict()["parameters"]


def test_a_robot_that_is_another_one_is_refused(tmp_path: Path) -> None:
    loop, _ = logged(0)
    path = found("idim").save(tmp_path / "out.json")
    first, second = loop.robot.links
    longer = replace(loop.robot, links=(first, replace(second, origin=1.2 * second.origin)))
    renamed = replace(loop.robot, joints=tuple(replace(one, name=f"j{k}") for k, one in enumerate(loop.robot.joints)))
    by_loop = found("didim").save(tmp_path / "loop.json")
    for kept, robot in ((path, longer), (path, renamed), (by_loop, loop.robot)):
        with pytest.raises(ji.RecordError):
            ji.load_estimate(kept, robot)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["didim", "drive_side"])
def test_a_saved_estimate_of_a_flexible_robot_comes_back(method: str, tmp_path: Path) -> None:
    twin = two((12.0, 15.0))
    loop = twin.loop()
    records = tuple(recorded(loop, twin.records(6.0, multisine=0.004), 0.003)[0])
    system, how = (loop, ji.DIDIM()) if method == "didim" else (loop.robot, ji.DriveSideFit())
    estimate = ji.identify(records, system, how, checks=False)
    back = ji.load_estimate(estimate.save(tmp_path / "out.json"), system)
    assert back.to_dict() == estimate.to_dict()
    mine, own = back.require_robot().numbers(), estimate.require_robot().numbers()
    np.testing.assert_allclose(mine.inertials, own.inertials, rtol=1e-12)
    assert list(mine.values) == [pytest.approx(each, rel=1e-12) for each in own.values]
    assert ji.Report.of(back, records).diagnosis is not None, "solved again, with stiffnesses on a logarithmic scale"
