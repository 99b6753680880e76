"""What the tests of joint files share."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.config import json_schema, loads


def faults(text: str) -> tuple[Fault, ...]:
    """Return the sentences with which a joint file is refused."""
    with pytest.raises(JointFileError) as caught:
        loads(text)
    return caught.value.faults


def told(text: str) -> list[str]:
    """Return place and code of each fault of a joint file."""
    return [f"{dot_path(fault.place)} {fault.code}".strip() for fault in faults(text)]


ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "emps" / "joint.toml"

JOINT = '[joint]\nkind = "prismatic"\n'
CHANNELS = """
[record.channels]
torque = { column = "i" }
reference = { column = "r" }
motor_position = { column = "q" }
"""
CASCADE = '[controller]\nlaw = "cascade"\nposition_gain = 100.0\nvelocity_gain = 2000.0\n'
SMALLEST = JOINT + CHANNELS + CASCADE
FLEXIBLE = SMALLEST.replace(JOINT, JOINT + 'model = "flexible"\n')


BOTH_ENCODERS = CHANNELS + 'load_position = { column = "p" }\n'
LINK = SMALLEST.replace("prismatic", "revolute") + '[gravity]\nload = "link"\n'


schema = cache(json_schema)


def table(name: str) -> dict[str, Any]:
    """Return the keys of a table in the schema; one with a shorthand is an alternative."""
    described = schema()["$defs"][name]
    return dict(described.get("anyOf", [described])[-1]["properties"])


@cache
def schema_keys() -> dict[str, set[str]]:
    """Return every key below the tables of the file, as the page writes it, with its defaults."""
    whole = schema()
    found: dict[str, set[str]] = {}

    def walk(described: dict[str, Any], path: str) -> None:
        if "$ref" in described:
            walk(whole["$defs"][described["$ref"].rsplit("/", 1)[1]], path)
        for one in (*described.get("anyOf", ()), *described.get("oneOf", ())):
            walk(one, path)
        if "$ref" in described.get("items", {}):
            walk(described["items"], path)
        if described.get("additionalProperties"):
            found[f"{path}.<name>"] = {"—"}
            walk(described["additionalProperties"], f"{path}.<name>")
        for key, below in described.get("properties", {}).items():
            at = f"{path}.{key}" if path else key
            default = f"`{json.dumps(below['default'])}`" if "default" in below else "—"
            if "." in at:
                found.setdefault(at, set()).add("required" if key in described.get("required", ()) else default)
            walk(below, at)

    walk(whole, "")
    channels = [key.rsplit(".", 1)[1] for key in found if re.fullmatch(r"record\.channels\.\w+", key)]
    shared = {key.rsplit(".", 1)[1] for key in found if key.startswith("record.channels.reference.")}
    for channel in channels:
        for key in shared:
            found[f"record.channels.<channel>.{key}"] = found.pop(f"record.channels.{channel}.{key}")
    for key in [key for key in found if re.match(r"controller\.(velocity_filter|torque_filters)\.", key)]:
        found[f"controller.<filter>.{key.rsplit('.', 1)[1]}"] = found.pop(key)
    return found


def in_our_words(error: JointFileError) -> None:
    for sentence in error.faults:
        assert sentence.endswith((".", "?"))
        assert "\n" not in sentence
        assert not re.search("Input should|Field required|Extra inputs|Value error|pydantic|_type", sentence)
