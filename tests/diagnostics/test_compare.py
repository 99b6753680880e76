"""What changed between two estimates: seldom anything where nothing did, and surely a stiffness that did."""

import json
import math
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import jointid as ji
from jointid.output.json import dumps, load_estimate, read_report, to_dict
from tests.output.report import reports


def told(estimate: ji.Estimate) -> dict[str, Any]:
    """Return an estimate as it is read back from its JSON."""
    found: dict[str, Any] = json.loads(dumps(to_dict(estimate)))
    return found


@cache
def identified(seed: int, inertia: float) -> ji.Estimate:
    record, loop = reports.rigid_record(seed, inertia=inertia)
    return ji.identify(record, loop)


def of_rigid(seed: int, inertia: float = 0.04) -> dict[str, Any]:
    return told(identified(seed, inertia))


def test_one_record_twice_is_not_tested() -> None:
    found = ji.compare(of_rigid(1), of_rigid(1))
    assert found.same_record
    assert all(row.p_value is None and row.difference == 0 for row in found.rows)


def test_several_records_are_read_as_one_is(tmp_path: Path) -> None:
    (first, loop), (second, _), (third, _) = (reports.rigid_record(seed) for seed in (1, 2, 3))
    both = ji.identify([first, second], [loop, loop])
    (path := tmp_path / "both.json").write_text(dumps(to_dict(both)), "utf-8")
    found = ji.compare(read_report(path), of_rigid(1))
    assert found.same_record and all(row.p_value is None for row in found.rows)
    other = ji.compare(read_report(path), of_rigid(3))
    assert not other.same_record and any(row.name == "inertia" and row.p_value for row in other.rows)
    back = load_estimate(path, loop)
    assert back.values == both.values
    assert ji.validate(back, second).test == "direct" and ji.validate(back, third).test == "cross"


def test_a_difference_has_the_variance_of_both_and_holms_p_value() -> None:
    before, after = of_rigid(1), of_rigid(2, inertia=0.0408)
    found = ji.compare(before, after)
    rows = {row.name: row for row in found.rows}
    assert "initial_position" not in rows
    stds = [one["parameters"]["inertia"]["stderr"] for one in (before, after)]
    assert rows["inertia"].std == pytest.approx(math.hypot(*stds))
    assert rows["inertia"].difference == pytest.approx(0.0008, abs=4 * rows["inertia"].std)
    alone = sorted(math.erfc(abs(row.difference or 0.0) / (row.std or 1.0) / math.sqrt(2)) for row in found.rows)
    holm = [max(min((len(alone) - j) * alone[j], 1.0) for j in range(i + 1)) for i in range(len(alone))]
    assert sorted(row.p_value or 0.0 for row in found.rows) == pytest.approx(holm)
    assert [row.name for row in found.changed] == ["inertia"]


def test_what_is_fixed_or_refused_is_said() -> None:
    before, after = of_rigid(1), of_rigid(2)
    after["parameters"]["inertia"] |= {"value": None, "stderr": None}
    after["parameters"]["viscous"] |= {"stderr": None, "free": False}
    rows = {row.name: row for row in ji.compare(before, after).rows}
    assert rows["inertia"].reason == "not identified in B"
    assert rows["viscous"].reason == "fixed in B"
    assert rows["viscous"].difference is not None
    assert rows["inertia"].p_value is rows["viscous"].p_value is None


@pytest.mark.slow
def test_a_spring_that_grew_softer_is_found() -> None:
    def estimate(seed: int, stiffer: float) -> dict[str, Any]:
        axis = ji.twin(seed=seed, pulses_seed=seed, stiffer=stiffer)
        record = axis.record.without("motor_position", "load_position")
        return told(ji.identify(record, axis.loop, ji.DIDIM(frequency=30.0)))

    before, same, softer = (estimate(seed, by) for seed, by in ((1, 1.0), (2, 1.0), (3, 0.95)))
    assert not ji.compare(before, same).changed
    found = ji.compare(before, softer)
    names = {row.name for row in found.changed}
    assert "stiffness" in names
    assert not names & {"motor_inertia", "load_inertia", "total inertia"}
    row = next(row for row in found.rows if row.name == "stiffness")
    assert row.difference == pytest.approx(-0.05 * 8e5, abs=4 * (row.std or 0.0))


@pytest.mark.parametrize(("place", "value"), [
    (("settings", "system", "model"), "flexible"), (("settings", "system", "kind"), "prismatic"),
    (("settings", "system", "friction"), {"name": "asymmetric"}), (("data", "torque_unit"), "A"),
    (("settings", "system", "transmission"), {"side": "load", "motor_per_load": 100.0}),
    (("parameters", "inertia", "unit"), "kg"),
])  # fmt: skip
def test_what_cannot_be_compared_is_refused(place: tuple[str, ...], value: Any) -> None:
    one = of_rigid(1)
    other = part = deepcopy(one)
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    with pytest.raises(ji.MethodError):
        ji.compare(one, other)
    with pytest.raises(ji.RecordError):
        ji.compare(one, identified(1, 0.04))  # type: ignore[arg-type]


def test_a_damaged_answer_is_refused(tmp_path: Path) -> None:
    answer, path = json.loads(dumps(to_dict(reports.rigid().estimate))), tmp_path / "x.html"
    texts = ["", "[]", '{"schema": "jointid.Estimate/2"}', "<html></html>", "<![<![", "[" * 100_000]
    for spoil in (
        lambda a: a["parameters"].update(inertia=None),
        lambda a: a["parameters"]["inertia"].update(value="1"),
        lambda a: a.update(data=[]),
        lambda a: a.update(known=[1]),
    ):
        spoiled = json.loads(json.dumps(answer))
        spoil(spoiled)
        texts.append(json.dumps(spoiled))
    for text in texts:
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ji.RecordError):
            ji.compare(read_report(path), answer)
