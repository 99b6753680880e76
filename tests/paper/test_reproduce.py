"""The paper, end to end: what the reproduction must find, and the document it becomes."""

import re
from pathlib import Path

import pytest

import jointid as ji
from jointid.common.charts import render
from jointid.common.document import Table
from jointid.diagnostics.validation import Validation
from jointid.output.figures import torque
from jointid.output.report.sections import page as html
from jointid.output.report.sections import save
from jointid.paper.reproduce import Reproduction, report_reproduction, reproduce
from jointid.paper.tables import TABLES
from jointid.paper.twin import TABLE_2, TABLE_4


@pytest.fixture(scope="module")
def run() -> Reproduction:
    return reproduce(seed=1)


@pytest.mark.slow
def test_the_rigid_joint_is_the_sum_of_its_sides(run: Reproduction) -> None:
    for name, truth in (("inertia", 105.0), ("viscous", 202.0), ("coulomb", 20.4)):
        found = run.first.rigid[name]
        assert abs(found.value - truth) <= 3 * float(found.stderr or 0.0)
        assert run.first.iterated[0][name] == pytest.approx(truth, rel=0.01)
    assert run.first.iterated[1] == TABLES[1].iterations["text"]
    assert run.first.iterated[0]["inertia"] != run.first.rigid["inertia"].value


@pytest.mark.slow
@pytest.mark.parametrize("method", ["idim", "didim", "best"])
def test_ten_kilograms_are_found_on_the_load(run: Reproduction, method: str) -> None:
    changes = run.variations(method)
    assert changes["load_inertia"] == pytest.approx(10.0, abs=0.6)
    assert changes["load_inertia"] == pytest.approx(TABLE_4["load_inertia"] - TABLE_2["load_inertia"], abs=0.3)
    for name in ("motor_inertia", "motor_coulomb", "stiffness", "load_coulomb"):
        first, second = (
            getattr(part, method if method == "idim" else "best")[name] for part in (run.first, run.second)
        )
        spread = (float(first.stderr or 0.0) ** 2 + float(second.stderr or 0.0) ** 2) ** 0.5
        assert abs(changes[name] - (TABLE_4[name] - TABLE_2[name])) <= 3 * spread, name


@pytest.mark.slow
def test_the_simplex_and_least_squares_end_together(run: Reproduction) -> None:
    for part in (run.first, run.second):
        # A simplex may stop early even after a restart: on the second experiment it does, a little.
        assert (part.didim.fit.filtered_error / part.best.fit.filtered_error) ** 2 - 1 <= 5e-3
        assert part.didim.fit.simulations > part.best.fit.simulations
        assert part.didim.fit.filtered_error == pytest.approx(0.08, abs=0.001)
        assert part.idim_simulated.test == "cross"
        assert part.didim_direct.test == "direct"
        assert part.idim_simulated.filtered_error == pytest.approx(0.08, abs=0.003)


@pytest.mark.slow
def test_f12_is_not_without_influence(run: Reproduction) -> None:
    """The paper found less than 1 % everywhere; without it Fv1 and Fv2 take its place."""
    assert 0.005 < run.damping_residual < 0.04
    assert run.damping_shifts["motor_viscous"] < -0.5
    assert run.damping_shifts["load_viscous"] > 0.3
    assert abs(run.damping_shifts["stiffness"]) < 0.01


def torque_png(answer: ji.Estimate | Validation) -> bytes:
    """The figures of the page, as `jointid reproduce` has them."""
    return render(torque(answer), "png", 100)


@pytest.mark.slow
def test_the_report_has_every_table_printed_recomputed_and_run(run: Reproduction, tmp_path: Path) -> None:
    document = report_reproduction(run, torque_png)
    written = save(document, tmp_path / "out", "reproduction")
    assert {path.name for path in written} == {"reproduction.html", "figure4.png", "figure5.png"}
    page = written[0].read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!data:|#)', page)  # nothing is loaded from elsewhere
    tables = [block for block in document.blocks if isinstance(block, Table) and block.header[1].startswith("printed")]
    assert len(tables) == 7
    for table in tables:
        assert any(text.startswith("recomputed") for text in table.header)
        assert any(text.startswith("this run") for text in table.header)
        assert {len(row) for row in table.rows} == {len(table.header)}
    assert not re.search(r"\b(nan|inf|None)\b", re.sub(r'src="[^"]*"', "", page))
    assert html(document) == html(report_reproduction(run, torque_png))
