"""The schema of the joint file: a description of every key, and no null."""

from __future__ import annotations

import json

from tests.joint_files import (
    schema,
    table,
)


def test_the_schema_has_no_null_and_a_description_of_every_key() -> None:
    assert "null" not in json.dumps(schema())
    for name in schema()["$defs"]:
        assert all("description" in key for key in table(name).values())
