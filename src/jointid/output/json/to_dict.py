"""Any result as the dict that is written to JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from jointid.common.errors import MethodError
from jointid.controller_id.learned import LearnedLoop
from jointid.diagnostics.compare_estimates import EstimateComparison
from jointid.diagnostics.experiment_design import Advice
from jointid.diagnostics.loop_check import LoopCheck
from jointid.diagnostics.method_comparison import MethodComparison
from jointid.diagnostics.stiffness_test_design import StiffnessTestDesign
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.output.json.assessments import (
    advice_answer,
    comparison_answer,
    loop_answer,
    revealing_answer,
    validation_answer,
)
from jointid.output.json.estimates import estimate_answer
from jointid.output.json.inspected import inspection_answer
from jointid.output.json.learned import learned_answer
from jointid.output.json.parts import Json
from jointid.output.json.reported import drift_answer
from jointid.output.json.tuning import detectable_answer, tuning_answer
from jointid.records.inspection import Inspection
from jointid.tuning.minimum_detectable_change import MinimumDetectableChange
from jointid.tuning.tuned import Tuned

_WRITERS: Mapping[type, Callable[[Any], Json]] = {
    Advice: advice_answer,
    MethodComparison: comparison_answer,
    MinimumDetectableChange: detectable_answer,
    Estimate: estimate_answer,
    Inspection: inspection_answer,
    LearnedLoop: learned_answer,
    LoopCheck: loop_answer,
    EstimateComparison: drift_answer,
    StiffnessTestDesign: revealing_answer,
    Tuned: tuning_answer,
    Validation: validation_answer,
}


def to_dict(result: object) -> Json:
    """Return a result as a dict of numbers, words, lists and dicts, with its `schema`: what `--json` writes.

    Args:
        result: of `identify`, `validate`, `compare`, `check_loop`, `advise`, `tune`, `learn_loop`, `inspect`,
            `compare_estimates`.

    Raises:
        MethodError: it is no such result.

    Example:
        >>> import jointid as ji
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(kp=100.0, kv=2000.0))
        >>> reference = ji.trapezoids(speeds=(0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> ji.to_dict(ji.identify(record, loop))["schema"]
        'jointid.estimate/1'
    """
    writer = _WRITERS.get(type(result))
    if writer is None:
        raise MethodError(
            f"Only a result is written as JSON; received {type(result).__name__}: give what a verb returned."
        )
    return writer(result)
