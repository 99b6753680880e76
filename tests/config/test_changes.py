"""Keys that are set, and choices of the command line, in place of what the joint file says."""

from typing import Any

import pytest

import jointid as ji
from jointid.config import loads
from jointid.config.toml import apply_changes
from tests.joint_files import BOTH_ENCODERS, CASCADE, CHANNELS, FLEXIBLE, JOINT, SMALLEST

FILE = (
    FLEXIBLE
    + 'torque_filters = [{ kind = "notch", frequency = 80.0, bandwidth = 20.0 }, [0.5, 0.5]]\n'
    + "[parameters]\noffset = 0.0\n"
)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("method.frequency=30", {"method": {"frequency": 30}}),
        (" method . frequency = 30.5 ", {"method": {"frequency": 30.5}}),
        ("method.name=idim", {"method": {"name": "idim"}}),
        ("joint.name=axis=3", None),
        ('joint.name="axis = 3"', {"joint": {"name": "axis = 3"}}),
        ("method.free=['position_gain', 'delay']", {"method": {"free": ["position_gain", "delay"]}}),
        ("parameters.inertia.upper=inf", {"parameters": {"inertia": {"upper": float("inf")}}}),
    ],
)
def test_a_change_is_a_key_and_a_value_in_toml(change: str, expected: dict[str, Any] | None) -> None:
    if expected is None:
        with pytest.raises(ji.JointFileError):
            apply_changes({}, [change])
    else:
        assert apply_changes({}, [change]) == expected


def test_a_change_leaves_all_else_and_the_last_one_wins() -> None:
    tables: dict[str, Any] = {"method": {"frequency": 10.0, "iterations": 1}, "joint": {"kind": "prismatic"}}
    changed = apply_changes(tables, ["method.frequency=20", "method.frequency=30"])
    assert changed == {"method": {"frequency": 30, "iterations": 1}, "joint": {"kind": "prismatic"}}
    assert tables["method"]["frequency"] == 10.0


def test_the_records_of_a_list_are_counted_from_1() -> None:
    listed = FILE + '[[records]]\nfile = "a.csv"\n[[records]]\nfile = "b.csv"\n'
    assert [run.added_inertia for run in loads(listed, changes=["records.2.added_inertia=10"]).runs] == [0.0, 10.0]


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ("method.frequenzy=30", ("method", "frequenzy")),
        ("method.frequency=-3", ("method", "frequency")),
        ("controller.position_gain=fast", ("controller", "position_gain")),
        ("method.form=paper", ("method", "form")),
        ("method", ()),
        ("a b=1", ()),
        ("method.frequency=", ()),
        ("parameters.offset.upper=3", ()),
        ("controller.torque_filters.2.frequency=9", ()),
    ],
)
def test_a_fault_of_a_change_is_one_sentence(change: str, place: tuple[str, ...]) -> None:
    with pytest.raises(ji.JointFileError) as caught:
        loads(FILE, changes=[change])
    (fault,) = caught.value.faults
    assert fault.place == place


def test_keys_are_set_before_the_file_is_checked() -> None:
    text = FLEXIBLE.replace(CHANNELS, BOTH_ENCODERS) + "[method]\ntolerance = 1e-3"
    assert loads(text, changes=[]) == loads(text)
    assert loads(text, changes=["method.frequency=42.0"]).method == ji.DIDIM(tolerance=1e-3, frequency=42.0)
    changed = loads(text, changes=["method.frequency=20.0", "filtering={cutoff=60, decimation=6}"])
    assert changed.method == ji.DIDIM(tolerance=1e-3, frequency=20.0)
    assert changed.filtering == ji.Filtering(cutoff=60.0, decimation=6)
    whole = ['method={name="didim", frequency=20.0}']  # in place of the whole table
    assert loads(text, changes=whole).method == ji.DIDIM(frequency=20.0)
    assert loads(SMALLEST, changes=["joint.friction=asymmetric"]).joint.friction == ji.friction.Friction("asymmetric")
    with pytest.raises(ji.JointFileError):
        loads(text, changes=["method.estimator=ols"])


def test_a_change_may_bring_what_makes_a_method_the_file_s_own() -> None:
    text = JOINT + CHANNELS + "[method]\ntolerance = 1e-3"
    controller = [f"controller={{{', '.join(CASCADE.strip().splitlines()[1:])}}}"]
    assert loads(text, changes=controller).method == ji.DIDIM(tolerance=1e-3)
