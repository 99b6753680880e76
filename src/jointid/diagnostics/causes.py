"""The causes of a record that does not fit the declared drive, as they are told."""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointid.common.document import Document, Documented, Listing, Table
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.diagnostics.cause_words import Explanation
from jointid.diagnostics.hypotheses import Cause
from jointid.uncertainty.verdict import Reason

_NOTHING_OF_IT = 0.8  # of the torque: a joint that is moved leaves less, whatever else moves it
_NO_RESPONSE = 0.1  # of the torque: so much that is no response to the reference may be another signal's


@dataclass(frozen=True, slots=True)
class Causes(Documented):
    """What explains a record that does not fit the declared drive.

    Attributes:
        declared_error: share of the filtered torque that is left as the drive is declared; infinite where its loop
            cannot be simulated.
        explanations: the likeliest first, three at most, which this record cannot tell apart; none where nothing that
            was tried explains it.
        nearest: the single causes that explain most, two at most, where more than one thing is wrong; else none.
        unexplained: share of the torque that free linear responses to the reference leave; 0 where it was not asked.
        tried: what was left by each cause that was put right, the least first.
        plain: what the samples show, or a motor at rest, where nothing else explains the record; else None.
    """

    declared_error: float
    explanations: tuple[Explanation, ...]
    tried: tuple[Explanation, ...]
    nearest: tuple[Explanation, ...] = ()
    unexplained: float = 0.0
    plain: Message | None = None

    @property
    def found(self) -> bool:
        """True if there is a cause to tell, be it the nearest one only."""
        return bool(self.explanations or self.nearest or self.plain)

    @property
    def message(self) -> Message:
        """The causes in a sentence, under the code of the likeliest one."""
        if self.plain is not None:
            return self.plain
        left = (
            "with the drive as declared the loop cannot be simulated"
            if math.isinf(self.declared_error)
            else f"as declared {number(100 * self.declared_error, 2)} % of the torque is not explained"
        )
        if self.nearest:
            first = self.nearest[0]
            clause = (
                "none of the usual causes alone explains it, so more than one thing may be wrong: the nearest are that "
            )
            clause = clause if len(self.nearest) > 1 else clause.replace("nearest are", "nearest is")
            clause += ", and that ".join(one.words for one in self.nearest)
            words = f"{clause}; the first still leaves {number(100 * first.error, 2)} % of the torque, of which "
            words += f"{number(100 * self.unexplained, 2)} % is no response to the reference; {left}"
            values = {"tried": self._names, "nearest": [str(one.cause) for one in self.nearest], "error": first.error}
            return Message(Reason.NO_CAUSE_FOUND, words, values, clause)
        if not self.explanations:
            clause = "the drive as declared does not fit, and none of the usual causes explains it"
            words = f"{left}, and none of the usual causes explains it ("
            words += f"{', '.join(name.replace('_', ' ') for name in self._names)})"
            if self.unexplained > _NO_RESPONSE:
                other = f"; {number(100 * self.unexplained, 2)} % of the torque is no response to the reference: "
                other += (
                    "check which column is the torque, and of which axis"
                    if self.unexplained > _NOTHING_OF_IT
                    else ("if a signal is injected, declare it (channel injected)")
                )
                clause, words = clause + other, words + other
            return Message(Reason.NO_CAUSE_FOUND, words, {"tried": self._names}, clause)
        best = self.explanations[0]
        clause = ", or ".join(one.words for one in self.explanations)
        if best.cause is Cause.REFERENCE_IS_POSITION:  # which explains whatever the controller does
            clause += ", or more than one thing is wrong with the controller"
        words = f"{clause}: with this put right {number(100 * best.error, 2)} % of the torque is left; {left}"
        values = {
            "causes": [{"cause": str(one.cause), "value": one.value, "error": one.error} for one in self.explanations],
            "declared_error": None if math.isinf(self.declared_error) else self.declared_error,
        }
        return Message(Reason.CAUSE_FOUND, words, values, clause)

    @property
    def _names(self) -> list[str]:
        return [str(one.cause) for one in self.tried]

    def document(self, *, details: bool = False) -> Document:
        """Return the causes, and the table of all that were tried; there are no further details."""
        del details
        rows = tuple((one.words, f"{number(100 * one.error, 2)} %") for one in self.tried)
        return Document("Cause", (Listing((str(self.message),)), Table(("put right", "torque left"), rows)))
