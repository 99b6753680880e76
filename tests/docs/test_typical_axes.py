"""The joint files of the typical axes identify what their records are simulated with."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import jointid as ji
from examples.axes import make_records as axes
from tests.docs.blocks import ROOT

FOLDER = ROOT / "examples" / "axes"
QUICK = "leg"
NAMES = [QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in axes.AXES if name != QUICK)]


@pytest.mark.parametrize("name", NAMES)
def test_a_typical_axis_is_identified_from_its_record(name: str, tmp_path: Path) -> None:
    axes.make(name, tmp_path / "run.csv", 12.0 if name != QUICK else 6.0)
    file = ji.load(FOLDER / f"{name}.toml")
    estimate = file.identify(file.record(tmp_path / "run.csv"))
    assert estimate.answer.reliable, estimate.answer
    truth = axes.AXES[name].values
    for row in (row for row in estimate.params.rows if row.of_joint):
        assert row.value == pytest.approx(truth[row.name], abs=5.0 * row.stderr), row.name
    asked = estimate.answer.found.values["parameter"]
    assert estimate[asked].value == pytest.approx(truth[asked], rel=0.03)


def test_the_page_has_every_file_and_its_mode() -> None:
    page = (ROOT / "docs" / "typical-axes.md").read_text(encoding="utf-8")
    assert {path.stem for path in FOLDER.glob("*.toml")} == set(axes.AXES)
    for name, axis in axes.AXES.items():
        assert page.count(f"../examples/axes/{name}.toml\n") == 1
        if "stiffness" in axis.values:
            mode = ji.FlexibleJoint.frequencies(axis.values)["free_free"]
            cutoff = ji.load(FOLDER / f"{name}.toml").filtering.cutoff
            assert math.isclose(cutoff, 2.0 * mode, rel_tol=0.1), (name, mode)
