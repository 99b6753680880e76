"""The page about the joint file, its schema and the program say the same."""

from __future__ import annotations

import json
import math
import re

from jointid.common.transmission import Transmission
from jointid.common.units import units_of
from jointid.config import loads
from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import (
    Cascade,
    FirstOrder,
)
from jointid.models.friction import AsymmetricFriction, SymmetricFriction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.records.columns import known_units
from jointid.records.drives import Drive
from jointid.records.signals.filtering import Filtering
from tests.joint_files import (
    PAGE,
    schema,
    schema_keys,
    table,
)


def page_keys() -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if match := re.match(r"\| `([\w<>]+(?:\.[\w<>]+)+)` \|", line):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            assert len(cells) == 4, line
            assert all(cells), line
            found.setdefault(match[1], set()).add(cells[2])
    return found


def test_the_page_has_every_key_and_no_other() -> None:
    assert page_keys() == schema_keys()


def test_the_page_has_every_unit_and_parameter() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for kind in ("prismatic", "revolute"):
        cells = ["reference", "reference_velocity", "torque"]
        row = " | ".join(", ".join(known_units(channel, kind)) for channel in cells)
        assert f"| {kind} | {row} |" in page
    for joint in (RigidJoint, FlexibleJoint):
        for friction, law_ in (("symmetric", SymmetricFriction()), ("asymmetric", AsymmetricFriction())):
            made = joint("revolute", friction=law_)
            names = ", ".join(f"`{parameter.name}`" for parameter in made.parameters)
            assert f"| {made.model} | {friction} | {names} |" in page
    assert ", ".join(f'`"{name}"`' for name in units_of("time")) in page


def test_the_page_has_the_defaults_that_depend_on_the_model() -> None:
    rows = {line.split("`")[1]: line for line in PAGE.read_text(encoding="utf-8").splitlines() if line[:3] == "| `"}
    rigid, least = (DIDIM().stopping_tolerance(model) for model in ("rigid", "flexible"))
    simplex = DIDIM(minimiser="nelder-mead").stopping_tolerance("flexible")
    said = [float(word) for word in re.findall(r"else (1e-\d+)", rows["method.tolerance"])]
    assert said == [rigid, least, simplex]
    for key in ("position_cutoff", "cutoff"):
        rigid, flexible = (getattr(Filtering().resolve(1e-3, model), key) for model in ("rigid", "flexible"))
        said = f"else {rigid / 10:g} % of the sampling frequency, for a flexible joint {flexible / 10:g} %"
        assert said in rows[f"filtering.{key}"]


def test_the_files_on_the_page_are_right() -> None:
    texts = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(texts) == 7
    smallest, geared, traced, united, drive, several, whole = map(loads, texts)
    assert geared.joint.transmission == Transmission(load="revolute", ratio=100.0)
    assert geared.columns["reference"].side == "load"
    assert traced.drive == Drive("cia402", rated_torque=1.27, counts_per_turn=1048576.0)
    assert united.controller == Cascade(
        position_gain=1 / 0.06, velocity_gain=0.8, integral_gain=1 / 0.006, velocity_limit=100 * math.pi, gain=0.72,
        velocity_filter=FirstOrder(1 / (600 * math.pi)),
    )  # fmt: skip
    assert [one.added_inertia for one in several.runs] == [0.0, 10.0]
    assert isinstance(smallest.method, DIDIM)
    assert isinstance(drive.controller, Cascade)
    assert drive.controller.law(2e-3).phases == 8
    assert whole.joint.torque_unit == "A"


def test_the_schema_has_no_null_and_a_description_of_every_key() -> None:
    assert "null" not in json.dumps(schema())
    for name in schema()["$defs"]:
        assert all("description" in key for key in table(name).values())
