"""User-facing errors: one sentence per fault with fact, received, expected and remedy."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import Any, Self

from jointid.common.text import printable

_LONGEST = 4000  # characters of a sentence; longer ones quote files that are no records


class JointidError(Exception):
    """Base of all user-facing errors; the command line exits with 2."""

    def __init__(self, message: str = "", code: str = "") -> None:
        super().__init__(printable(message))
        self.code = code  # of the cause of a failed identification; empty if none was searched for


class Fault(str):
    """Sentence on a fault of a file, with place and code.

    Attributes:
        place: keys and indices of the faulty value; empty for a fault of the whole file.
        code: kind of fault, such as "missing" or "unknown".
    """

    place: tuple[int | str, ...]
    code: str

    def __new__(cls, sentence: str, place: tuple[int | str, ...] = (), code: str = "") -> Self:
        """Create a fault from its sentence."""
        made = super().__new__(cls, sentence)
        made.place, made.code = place, code
        return made


class FaultsError(JointidError):
    """An error that reports all faults at once, one sentence each."""

    def __init__(self, faults: str | Iterable[str]) -> None:
        kept = list[Fault]()
        for fault in (faults,) if isinstance(faults, str) else faults:
            said = printable(fault).replace("\n", "\\n")
            said = said if len(said) <= _LONGEST else f"{said[: _LONGEST // 2]} ... {said[-_LONGEST // 2 :]}"
            kept.append(Fault(said, fault.place, fault.code) if isinstance(fault, Fault) else Fault(said))
        self.faults: tuple[Fault, ...] = tuple(kept)
        super().__init__("\n".join(self.faults))


class RecordError(FaultsError):
    """An unreadable or inconsistent record."""


class JointFileError(FaultsError):
    """A joint file with faults; `faults` holds every one of them."""


class MethodError(JointidError):
    """The record, joint or controller lacks what a method needs."""


def extra(module: str, name: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Args:
        module: its dotted name.
        name: the extra that installs it.
        purpose: what needs it; the beginning of the error sentence.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise JointidError(
            f'{purpose} needs the package {package}, which is not there; install it: pip install "jointid[{name}]".'
        ) from error
