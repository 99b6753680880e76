"""Options that commands share."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from cyclopts import Parameter

Changes: TypeAlias = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
"""`--set key=value`: keys of the joint file that are changed before it is checked; every setting can be reached."""
