"""The contents of a file as JSON."""

from __future__ import annotations

from jointid.output.json.parts import Json
from jointid.records.inspection import InspectedChannel, Inspection

INSPECTION_SCHEMA = "jointid.inspection/1"


def inspection_answer(inspection: Inspection) -> Json:
    """Return what is in a file as it is written to JSON."""
    return {
        "schema": INSPECTION_SCHEMA,
        "file": inspection.file,
        "format": inspection.format,
        "bytes": inspection.size,
        "channels": [_channel(channel) for channel in inspection.channels],
        "scalars": dict(inspection.scalars),
        "not_read": dict(inspection.passed),
    }


def _channel(channel: InspectedChannel) -> Json:
    outline = channel.outline
    return {
        "name": channel.name,
        "rows": outline.rows,
        "unit": channel.unit,
        "minimum": outline.minimum,
        "maximum": outline.maximum,
        "missing": outline.missing,
        "time": channel.time,
        "sample_time": channel.sample_time,
        "jitter": channel.jitter,
    }
