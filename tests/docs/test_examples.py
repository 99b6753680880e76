"""The joint files of the examples identify what their records are made with; the examples of docstrings hold."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import jointid as ji
from examples.axes import make_records as axes
from tests.docs.blocks import ROOT

QUICK = "leg"
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in axes.AXES if name != QUICK]
SOURCE = ROOT / "src"
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
    for path in SOURCE.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", [QUICK, *SLOW])
def test_a_typical_axis_is_identified_from_its_record(name: str, tmp_path: Path) -> None:
    axes.make(name, tmp_path / "run.csv", 12.0 if name != QUICK else 6.0)
    file = ji.load(ROOT / "examples" / "axes" / f"{name}.toml")
    estimate = file.identify(file.record(tmp_path / "run.csv"))
    assert estimate.answer.reliable, estimate.answer
    truth = axes.AXES[name].values
    for row in (row for row in estimate.rows if row.of_joint):
        assert row.value == pytest.approx(truth[row.name], abs=5.0 * row.stderr), row.name
    asked = estimate.answer.found.values["parameter"]
    assert estimate[asked].value == pytest.approx(truth[asked], rel=0.03)


@pytest.mark.docs
@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_examples_of_the_docstrings_hold(module: str) -> None:
    found = doctest.testmod(import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert found.failed == 0
    assert found.attempted > 0
