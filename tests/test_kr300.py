"""What examples/kr300/README.md says of the real record is what comes out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import jointid as ji
from jointid.config import File
from jointid.estimation.result.answer import Trust

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "kr300"
PAGE = (EXAMPLE / "README.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (\d) \| ([AB]) \| (.*) \|$", PAGE, re.MULTILINE)


def axis(number: int, data_dir: Path, record: str) -> tuple[File, ji.Record]:
    file = ji.load(EXAMPLE / f"axis{number}.toml")
    return file, file.record(data_dir / "kr300" / f"rec_{record}.mat")


@pytest.mark.parametrize(("number", "name", "cells"), ROWS)
def test_the_table_is_what_comes_out(data_dir: Path, number: str, name: str, cells: str) -> None:
    file, record = axis(int(number), data_dir, name)
    estimate = ji.identify(record, file.joint, file.method)
    said = [float(text) for text in re.findall(r"-?[\d.]+", cells)]
    values = [estimate[each] for each in ("inertia", "viscous", "coulomb", "offset")]
    found = [part for one in values for part in (one.value or 0.0, 2 * (one.stderr or 0.0))]
    found.append(100 * estimate.fit.filtered_error)
    assert len(said) == len(found)
    for text, value in zip(said, found, strict=True):
        assert text == pytest.approx(value, rel=0.01, abs=1.0)


@pytest.mark.parametrize(("number", "name"), [(1, "A"), (3, "A")])
def test_both_encoders_are_refused_with_the_reason(data_dir: Path, number: int, name: str) -> None:
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
    spring = estimate["K12"]
    assert (spring.value, 2 * (spring.stderr or 0.0)) == pytest.approx((stiffness, two_sigma), rel=0.05)
    assert any("a stiffness from both encoders is not to be trusted" in text for text in estimate.checks.warnings)
    trust = estimate.answer.trust
    assert trust.code == Trust.NOT_YET
    assert "encoder_lag" in trust.values["reasons"]
