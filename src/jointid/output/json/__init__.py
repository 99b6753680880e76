"""Answers as JSON, with versioned schemas, and back as far as a later command needs them.

Every answer has `schema` at its top level. A number that does not exist is null, never NaN.
"""

from jointid.common.json_file import dumps, write
from jointid.output.json.assessments import (
    ADVICE_SCHEMA,
    COMPARISON_SCHEMA,
    LOOP_SCHEMA,
    REVEALING_SCHEMA,
    VALIDATION_SCHEMA,
    advice_answer,
    comparison_answer,
    loop_answer,
    revealing_answer,
    validation_answer,
)
from jointid.output.json.estimates import ESTIMATE_SCHEMA, LONG_SCHEMA, TOGETHER_SCHEMA, estimate_answer
from jointid.output.json.inspected import INSPECTION_SCHEMA, inspection_answer
from jointid.output.json.learned import LEARNED_SCHEMA, learned_answer
from jointid.output.json.reading import read_answer, read_friction, read_identified
from jointid.output.json.reported import DRIFT_SCHEMA, drift_answer, read_report
from jointid.output.json.reports import REPORT_SCHEMA, report_answer
from jointid.output.json.simulations import SIMULATION_SCHEMA, simulation_answer
from jointid.output.json.to_dict import to_dict
from jointid.output.json.tuning import TUNING_SCHEMA, detectable_answer, tuning_answer

__all__ = [
    "ADVICE_SCHEMA",
    "COMPARISON_SCHEMA",
    "DRIFT_SCHEMA",
    "ESTIMATE_SCHEMA",
    "INSPECTION_SCHEMA",
    "LEARNED_SCHEMA",
    "LONG_SCHEMA",
    "LOOP_SCHEMA",
    "REPORT_SCHEMA",
    "REVEALING_SCHEMA",
    "SIMULATION_SCHEMA",
    "TOGETHER_SCHEMA",
    "TUNING_SCHEMA",
    "VALIDATION_SCHEMA",
    "advice_answer",
    "comparison_answer",
    "detectable_answer",
    "drift_answer",
    "dumps",
    "estimate_answer",
    "inspection_answer",
    "learned_answer",
    "loop_answer",
    "read_answer",
    "read_friction",
    "read_identified",
    "read_report",
    "report_answer",
    "revealing_answer",
    "simulation_answer",
    "to_dict",
    "tuning_answer",
    "validation_answer",
    "write",
]
