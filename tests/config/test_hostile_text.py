"""Whatever stands in a joint file, it is read or refused in sentences."""

from __future__ import annotations

import tomllib

from hypothesis import given
from hypothesis import strategies as st

from jointid.common.errors import JointFileError
from jointid.config import (
    JointFile,
    loads,
)
from jointid.models.controllers import (
    StateSpaceController,
)
from tests.joint_files import (
    EXAMPLE,
    in_our_words,
    schema_keys,
)


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
    | st.sampled_from(("cascade", "pd", "state_space", "didim", "idim", "flexible", "asymmetric", "paper", "A", "deg"))
    | st.sampled_from(
        ("nelder-mead", "inverse-model", "as-printed", "warned", "pid", "notch", "moving_average", "track")
    ),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["numerator", "position", "kind", "samples"]), inner)
    ),
    max_leaves=6,
)


@given(st.data())
def test_any_value_at_any_key_is_read_or_refused(data: st.DataObject) -> None:
    tables = tomllib.loads(EXAMPLE.read_text(encoding="utf-8"))
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from([*TABLES, *sorted(schema_keys())]))
        path = path.replace("<channel>", data.draw(st.sampled_from(CHANNELS_NAMED)))
        path = path.replace("<filter>", "velocity_filter")
        *above, key = path.replace("<name>", data.draw(st.sampled_from(("inertia", "offset", "x")))).split(".")
        table = tables
        for name in above:
            below = table.setdefault(name, {})
            table = below if isinstance(below, dict) else {}
        table[key] = data.draw(anything)
    try:
        file = JointFile.of(tables)
    except JointFileError as error:
        in_our_words(error)
    else:
        assert JointFile.of(file.tables()) == file or isinstance(file.controller, StateSpaceController)


TABLES = ("joint", "record", "controller", "filtering", "method", "parameters", "records", "together", "other")
CHANNELS_NAMED = ("torque", "reference", "motor_position", "injected", "other")


def read_or_refused(text: str) -> None:
    try:
        loads(text)
    except JointFileError as error:
        in_our_words(error)
