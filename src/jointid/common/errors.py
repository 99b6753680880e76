"""The few errors a user can meet; each is one clear sentence per fault: fact, received, expected, remedy."""

from __future__ import annotations

from collections.abc import Iterable


class JointidError(Exception):
    """Base of every error that is the user's to mend; the command line prints it and exits with 2."""


class FaultsError(JointidError):
    """An error that reports all the faults found at once, one sentence each."""

    def __init__(self, faults: str | Iterable[str]) -> None:
        self.faults: tuple[str, ...] = (faults,) if isinstance(faults, str) else tuple(faults)
        super().__init__("\n".join(self.faults))


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
