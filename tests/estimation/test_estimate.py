"""The answer: its printed table, to the letter, and its JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import MethodError, RecordError
from jointid.common.text import interval
from jointid.estimation.result import estimate as result
from jointid.estimation.result.estimate import Data, Estimate, EstimatedParameter, Fit, Settings
from jointid.estimation.result.verdict import assemble
from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.output import json as answers
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.identifiability import Combination, Identifiability, Known
from tests.estimates import amended
from tests.estimation.conftest import CONTROLLER

LOOP = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
TORQUE = np.sin(np.arange(400) / 20.0) * 50.0


def parameter(
    name: str, symbol: str, unit: str, value: float | None, std: float | None, **more: object
) -> EstimatedParameter:
    return EstimatedParameter(name, symbol, unit, value, std, std is not None, **more)  # type: ignore[arg-type]


ESTIMATE = Estimate(
    rows=(
        parameter("inertia", "ZZ", "kg", 94.9034, 0.1101),
        parameter("viscous", "Fv", "N s/m", 207.534, 1.25),
        parameter("coulomb", "Fc", "N", None, None, lower_bound=12.5),
        parameter("offset", "offset", "N", 0.0, None),
        parameter("initial_position", "q(0)", "m", 3.2e-7, 2.2e-6, of_joint=False),
    ),
    correlation=np.zeros((0, 0)),
    fit=Fit(
        TORQUE,
        0.96 * TORQUE,
        relative_error=0.04,
        filtered_error=0.0397,
        rows=31,
        simulations=14,
        stop="",
        converged=True,
    ),
    warnings=("something to know",),
    data=Data(channels=("torque", "reference"), record="run 1", sample_time=1e-3, torque_unit="N", fingerprints=("",)),
    settings=Settings("didim", "DIDIM", LOOP.joint, LOOP, Filtering().resolve(1e-3)),
)


def test_a_row_is_found_by_its_name_or_symbol() -> None:
    assert ESTIMATE.parameters["viscous"] is ESTIMATE["Fv"] is ESTIMATE["viscous"]
    with pytest.raises(MethodError, match="viscous"):
        ESTIMATE["stiffness"]


def test_an_interval_has_what_a_lack_of_fit_adds() -> None:
    inside = [name for name, one in ESTIMATE.parameters.items() if one.interval is not None]
    assert inside == ["inertia", "viscous", "initial_position"]  # neither refused nor fixed
    assert ESTIMATE["viscous"].interval == pytest.approx((207.534 - 2 * 1.25, 207.534 + 2 * 1.25))
    wide = replace(ESTIMATE["viscous"], lack_of_fit=1.25)
    assert wide.interval == pytest.approx((207.534 - 2 * 1.25 * 2**0.5, 207.534 + 2 * 1.25 * 2**0.5))


def test_a_sum_is_moved_by_what_moves_its_parts_together() -> None:
    total = Known(Combination("total", "", "", {"inertia": 1.0, "viscous": 1.0}), 300.0, 1.0)
    moved = ({"inertia": 3.0, "viscous": -4.0}, ""), ({"viscous": 0.5}, "")
    found = assemble(replace(ESTIMATE, known=Identifiability((total,), ())), widenings=moved)
    assert (found["inertia"].lack_of_fit, found["viscous"].lack_of_fit) == (3.0, 4.0)
    assert found.known is not None and found.known.physical[0].lack_of_fit == 1.0


def test_residual_and_frequencies() -> None:
    assert ESTIMATE.residual == pytest.approx(0.04 * TORQUE)
    assert ESTIMATE.frequencies == {}
    values = {"motor_inertia": 70.0, "load_inertia": 35.0, "stiffness": 8e5}
    rows = tuple(parameter(name, name, "", value, None) for name, value in values.items())
    flexible = replace(ESTIMATE, rows=rows)
    assert flexible.frequencies["free_free"] == pytest.approx((8e5 * 105 / 70 / 35) ** 0.5 / (2 * np.pi))
    assert replace(ESTIMATE, rows=rows[:2]).frequencies == {}
    held = (*rows[:2], replace(rows[2], at_bound=8e5))
    assert replace(ESTIMATE, rows=held).frequencies == {}
    assert replace(ESTIMATE, rows=held).answer.found.values["mode_hz"] is None


def test_an_estimate_is_saved_as_the_command_writes_it(tmp_path: Path) -> None:
    path = ESTIMATE.save(tmp_path / "out.json")
    assert path.read_text(encoding="utf-8") == answers.dumps(ESTIMATE.to_dict())
    assert ESTIMATE.to_dict() == answers.to_dict(ESTIMATE)
    with pytest.raises(RecordError, match="cannot be written"):
        ESTIMATE.save(tmp_path / "nowhere" / "out.json")


def test_json_says_null_and_never_nan(tmp_path: Path) -> None:
    amended(ESTIMATE, fit={"relative_error": float("nan")}).save(tmp_path / "out.json")
    read = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert read["fit"]["relative_error"] is None
    assert read["parameters"]["coulomb"] == {
        "name": "coulomb", "symbol": "Fc", "value": None, "stderr": None, "unit": "N", "free": False,
        "lower_bound": 12.5, "of_joint": True, "at_bound": None, "lack_of_fit": 0.0, "axis": "",
        "formula": "", "nominal": None,
    }  # fmt: skip


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"schema": "jointid.estimate/2"}', "[" * 100_000, "\0", '{"schema": 1}']
)
def test_a_spoiled_answer_is_refused_in_a_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / "out.json").write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=r"is no (JSON file|estimate)"):
        answers.load_estimate(tmp_path / "out.json", LOOP)


def test_the_error_leaves_out_the_borders() -> None:
    predicted = TORQUE.copy()
    predicted[:50] = 1e6
    assert result.relative_error(TORQUE, predicted, (50, 0)) == 0.0
    assert result.relative_error(TORQUE, predicted, (49, 0)) > 1.0


@pytest.mark.parametrize("slow", [2e-3, 3.1e-3, 16e-3, 1.0])
def test_a_law_with_a_slower_loop_and_no_period_of_its_own_has_a_fingerprint(slow: float) -> None:
    """Whatever the slower period is: the one at which laws are compared need not divide it."""
    loops = [
        ClosedLoop(
            RigidJoint("prismatic"),
            Cascade(position_gain=position_gain, velocity_gain=2.0, position_period=slow, position_offset=offset),
        )
        for position_gain, offset in ((1.0, 0.0), (1.0, 0.0), (1.1, 0.0), (1.0, slow / 2))
    ]
    first, again, *others = (result.law_fingerprint(loop) for loop in loops)
    assert first == again
    assert first not in others


@pytest.mark.parametrize(
    ("value", "spread", "said"),
    [
        (94.903, 0.92, "94.90 ± 0.92"), (207.53, 27.3, "208 ± 27"), (802861.0, 7353.0, "802900 ± 7400"),
        (-3.1664, 0.89, "-3.17 ± 0.89"), (5.0, 0.0, "5.0000 ± 0"), (0.0, 1.0, "0.0 ± 1.0"),
        (94.903, 0.996, "94.9 ± 1.0"), (-0.3, 27.0, "0 ± 27"), (0.0031, 2e-5, "0.003100 ± 0.000020"),
        (30.0, 3e-13, "30.0000000 ± 3.0e-13"), (1234567.0, 12345.0, "1.235e+06 ± 0.012e+06"),
        (1e-7, 4e-6, "0.1e-06 ± 4.0e-06"),
    ],
)  # fmt: skip
def test_a_value_has_as_many_places_as_its_interval(value: float, spread: float, said: str) -> None:
    assert interval(value, spread) == said
