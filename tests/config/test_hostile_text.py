"""Whatever stands in a joint file, it is read or refused in sentences."""

from __future__ import annotations

import os
import sys
import time
import tomllib
from pathlib import Path

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from jointid.common.errors import JointFileError
from jointid.config import dumps, load, loads
from jointid.config.declaration import list_keys
from jointid.config.robot_model import load_robot
from jointid.config.tables import JOINT_FILE
from tests.joint_files import EXAMPLE, in_our_words


def test_spoiled_text_is_read_or_refused() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")

    @given(st.integers(0, len(text)), st.integers(0, 40), st.text(max_size=12) | st.sampled_from(list('"[]{}=,.\n-')))
    def spoiled(at: int, length: int, put: str) -> None:
        read_or_refused(text[:at] + put + text[at + length :])

    spoiled()


anything = st.recursive(
    st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.dates()
    | st.sampled_from(("cascade", "pd", "didim", "idim", "flexible", "asymmetric", "paper", "A", "deg"))
    | st.sampled_from(("inverse-model", "as-printed", "warned", "pid", "notch", "moving_average", "track")),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["numerator", "position", "kind", "samples"]), inner)
    ),
    max_leaves=6,
)


@settings(max_examples=50)
@given(st.data())
def test_any_value_at_any_key_is_read_or_refused(data: st.DataObject) -> None:
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from([*TABLES, *KEYS]))
        *above, key = path.replace("<name>", data.draw(st.sampled_from(("inertia", "offset", "x")))).split(".")
        table = tables
        for name in above:
            below = table.setdefault(name, {})
            table = below if isinstance(below, dict) else {}
        table[key] = data.draw(anything)
    try:
        file = loads(tomlkit.dumps(tables))
    except JointFileError as error:
        in_our_words(error)
    else:
        assert loads(dumps(file)) == file


TABLES = ("joint", "record", "controller", "filtering", "method", "parameters", "records", "together", "other")
KEYS = sorted({key.place for key in list_keys(JOINT_FILE) if "." in key.place})


def read_or_refused(text: str) -> None:
    try:
        loads(text)
    except JointFileError as error:
        in_our_words(error)


@pytest.mark.parametrize("line", ["x{} = [1, 2]", "[x{}]", "x = {{ y{} = 1, z = 2 }}", "x = [1,\n2]\ny{} = 'a, b'"])
def test_a_key_of_many_parts_is_refused_before_it_is_parsed(line: str) -> None:
    """The parser takes the square of the parts: half a minute for 120,000."""
    begin = time.process_time()
    with pytest.raises(JointFileError):
        loads(line.format(".a" * 120_000) + "\n")
    assert time.process_time() - begin < 5
    with pytest.raises(JointFileError):
        loads("", changes=[f"x{'.a' * 120_000}=1"])


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe has no path")
def test_a_device_or_a_pipe_is_no_joint_file_and_no_model(tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    path.symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    for read in (load, load_robot):
        for one in (path, tmp_path / "pipe"):
            with pytest.raises(JointFileError, match=r"cannot be opened \(it is a pipe or a device, no file\)"):
                read(one)
