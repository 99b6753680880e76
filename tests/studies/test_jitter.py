"""What the page on timing says of clocks that jitter: which remedy is right for which fault."""

from __future__ import annotations

import pytest

from studies.jitter import Jittered, jitter


@pytest.mark.slow
def test_each_fault_has_one_right_remedy() -> None:
    found = {(run.late, run.remedy): run for run in jitter((0.3,)).runs}

    def worst(late: str, remedy: str) -> tuple[float, float]:
        run: Jittered = found[late, remedy]  # type: ignore[index]
        return max(map(abs, run.didim.values())), max(map(abs, run.idim.values()))

    for late in ("samples", "stamps"):
        assert worst(late, "cubic, reference held")[0] < 1e-8
        assert worst(late, "taken as uniform")[0] < 1e-8
        assert 2e-3 < worst(late, "cubic")[0] < 1e-2
    assert worst("samples", "taken as uniform")[1] > 0.1
    assert worst("samples", "cubic")[1] < 5e-3
    assert worst("stamps", "taken as uniform")[1] < 5e-4
    assert worst("stamps", "cubic")[1] > 0.1
