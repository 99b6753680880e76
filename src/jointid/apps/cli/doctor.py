"""`jointid doctor`: what a report of a wrong answer needs, without the data of the record."""

from __future__ import annotations

import contextlib
import os
import platform
import re
from importlib import metadata
from pathlib import Path
from typing import Any

from jointid import __version__
from jointid.apps.cli.console import Changes, Inputs, show
from jointid.apps.cli.places import Outputs
from jointid.common.document import dumps, write


def doctor(joint: Path | None = None, /, *, changes: Changes = (), json: Path | None = None) -> None:
    """List versions, machine and channels for a report of a fault.

    Of the record it tells the channels, their units, numbers of samples and sample times. It tells no sample, no name
    of a column and no path.

    Args:
        joint: the joint file or robot file (TOML) whose record is described.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        json: also write the answer as JSON to this file.
    """
    from jointid.common.parallel import BLAS_THREADS, THREADS

    outputs = Outputs({"--json": json})
    found: dict[str, Any] = {
        "schema": "jointid.doctor/1",
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "threads": {name: os.environ.get(name) for name in (THREADS, *BLAS_THREADS)},
        "packages": _versions(),
    }
    if joint is not None:
        found["record"] = [
            {
                name: {"unit": channel.unit, "samples": len(channel), "sample_time": channel.sample_time}
                for name, channel in record.items()
            }
            for record in Inputs(changes=changes).load(joint, outputs).records()
        ]
    show(dumps(found))
    if json is not None:
        write(found, json)


def _versions() -> dict[str, str | None]:
    """Return the version of this package and of each one that it can use; None if it is not installed."""
    found: dict[str, str | None] = {"jointid": __version__}
    needed: list[re.Match[str] | None] = []
    with contextlib.suppress(metadata.PackageNotFoundError):  # a source tree that is not installed
        needed = [re.match(r"[\w.-]+", line) for line in metadata.requires("jointid") or ()]
    for name in sorted({one[0] for one in needed if one is not None}):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found
