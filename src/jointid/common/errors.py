"""The few errors a user can meet; each is one clear sentence per fault: fact, received, expected, remedy."""

from __future__ import annotations

from collections.abc import Iterable

from jointid.common.text import printable

_LONGEST = 4000  # characters of a sentence; what is longer quotes a file that is no record


class JointidError(Exception):
    """Base of every error that is the user's to mend; the command line prints it and exits with 2."""

    def __init__(self, message: str = "") -> None:
        super().__init__(printable(message))


class FaultsError(JointidError):
    """An error that reports all the faults found at once, one sentence each."""

    def __init__(self, faults: str | Iterable[str]) -> None:
        each = (faults,) if isinstance(faults, str) else tuple(faults)
        self.faults: tuple[str, ...] = tuple(_sentence(fault) for fault in each)
        super().__init__("\n".join(self.faults))


def _sentence(fault: str) -> str:
    """Return a fault on one line, of a length that can be read."""
    said = printable(fault).replace("\n", "\\n")
    return said if len(said) <= _LONGEST else f"{said[: _LONGEST // 2]} ... {said[-_LONGEST // 2 :]}"


class RecordError(FaultsError):
    """A record that cannot be read, or cannot be what it is declared to be."""


class JointFileError(FaultsError):
    """A joint file with faults; `faults` holds every one of them."""


class MethodError(JointidError):
    """A method asked for what the record, the joint or the controller does not have."""


class SimulationError(JointidError):
    """A simulation that was asked for by itself (not as one candidate of many) and failed."""


class ExtraError(JointidError):
    """An optional package is missing; the sentence names the extra that brings it."""
