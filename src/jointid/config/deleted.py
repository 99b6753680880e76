"""Deleted keys of joint, robot and campaign files, with their replacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

DELETED: Mapping[str, str] = {
    "record.channels.*.bits": "decode the frames by the motor's own library, and log numbers.",
    "drive.motor": "it named ranges of raw CAN frames; decode these by the motor's own library, and log numbers.",
    "drive.*_range": "it was of raw CAN frames; decode these by the motor's own library, and log numbers.",
    "method.highpass": 'it was of the open loop; take method.name = "drive_side", which compares the torque.',
    "method.encoders": "the difference of two encoders' zeros is estimated where the record shows it; leave it out.",
    "controller.filters_at": "the torque's filters stand before its limit; leave it out.",
    "controller.torque_feedforward_delay": "reference_delay delays the whole law's reference.",
    "controller.velocity_feedforward_delay": "reference_delay delays the whole law's reference.",
    "bootstrap": "follow the criterion to its rise in Python, by jointid.intervals(estimate, record).",
    "monte_carlo": "write the records of simulated runs in Python, and list them in [fleet].",
    "multistart": "identify once, as the search has several starts of its own.",
}
"""What to do instead of each deleted key, by its path; * stands for any name.

In a robot file the same path is looked for below its [[joints]], whose own keys are those of ``joint``.
"""


def sentence_of(place: Sequence[int | str]) -> str | None:
    """Return the rest of the sentence on a deleted key; None for any other key.

    Example:
        >>> from jointid.config.deleted import sentence_of
        >>> sentence_of(("method", "frequency")) is None
        True
    """
    names = [part for part in place if isinstance(part, str)]
    if names[:1] == ["joints"]:
        own = names[1:]
        names = ["record", *own] if own[:1] == ["channels"] else own if len(own) > 1 else ["joint", *own]
    path = ".".join(names)
    return next(
        (f" is no longer a key: {said}" for pattern, said in DELETED.items() if fnmatchcase(path, pattern)), None
    )
