"""Results as JSON, with versioned schemas, and back as far as a later command needs them.

Every document has `schema` at its top level. A number that does not exist is null, never NaN.
"""

from jointid.common.document import dumps, write
from jointid.output.json.documents import plain, simulation_answer, to_dict
from jointid.output.json.reading import load_estimate, read_answer, read_choices, read_report

__all__ = [
    "dumps",
    "load_estimate",
    "plain",
    "read_answer",
    "read_choices",
    "read_report",
    "simulation_answer",
    "to_dict",
    "write",
]
