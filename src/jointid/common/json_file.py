"""An answer as text, and as a file; a number that does not exist is null, never NaN."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from jointid.common.errors import RecordError


def dumps(answer: dict[str, Any]) -> str:
    """Return an answer as JSON text, the same bytes for the same answer."""
    return json.dumps(_finite(answer), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write(answer: dict[str, Any], path: str | Path) -> None:
    """Write an answer as JSON.

    Raises:
        RecordError: the file cannot be written.
    """
    try:
        Path(path).write_text(dumps(answer), encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path} cannot be written ({error.strerror}); choose another place.") from None


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
