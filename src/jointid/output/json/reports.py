"""A report as JSON: the estimate, and all that its page tells beside it."""

from __future__ import annotations

from typing import Protocol

from jointid.diagnostics.report_data import ReportData
from jointid.output.json.assessments import loop_answer, revealing_answer, validation_answer
from jointid.output.json.estimates import estimate_answer
from jointid.output.json.parts import Json
from jointid.uncertainty.profile import Profile

REPORT_SCHEMA = "jointid.report/1"
REPORT_ELEMENT = "jointid-answer"
"""The id of the element of a page that carries the answer."""


class Repeated(Protocol):
    """The files and the command that repeat an estimate; see `jointid.output.report.reproducibility`."""

    @property
    def version(self) -> str:
        """Of this program."""

    @property
    def record_name(self) -> str:
        """File of the record."""

    @property
    def record_sha256(self) -> str:
        """Of that file."""

    @property
    def joint_name(self) -> str:
        """File of the joint."""

    @property
    def joint_file(self) -> str:
        """Its text."""

    @property
    def command(self) -> str:
        """That writes the report again."""


def report_answer(given: ReportData, repeated: Repeated) -> Json:
    """Return a report as its page carries it."""
    return {
        "schema": REPORT_SCHEMA,
        "version": repeated.version,
        "estimate": estimate_answer(given.estimate),
        "validation": None if given.validation is None else validation_answer(given.validation),
        "checks": [validation_answer(check) for check in given.checks],
        "loop": None if given.loop is None else loop_answer(given.loop),
        "profiles": [profile_answer(one) for one in given.profiles],
        "frequencies": {} if given.response is None else dict(given.response.modes),
        "revealing": None if given.stiffness_test is None else revealing_answer(given.stiffness_test),
        "absent": dict(given.absent),
        "record_file": repeated.record_name or None,
        "record_file_sha256": repeated.record_sha256 or None,
        "joint_file_name": repeated.joint_name or None,
        "joint_file": repeated.joint_file or None,
        "command": repeated.command or None,
    }


def profile_answer(one: Profile) -> Json:
    """Return a profile as it is written to JSON."""
    return {
        "name": one.name,
        "formula": one.formula,
        "unit": one.unit,
        "estimate": one.estimate,
        "level": one.level,
        "interval": list(one.interval),
        "reached": list(one.reached),
        "values": [float(value) for value in one.points],
        "rise": [float(value) for value in one.rise],
        "threshold": one.threshold,
        "estimate_was_minimum": not one.improved,
    }
