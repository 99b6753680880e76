"""What the tests of joint files share."""

from __future__ import annotations

import pytest

from jointid.common.errors import JointFileError
from jointid.config import loads


def faults(text: str) -> tuple[str, ...]:
    """Return the sentences with which a joint file is refused."""
    with pytest.raises(JointFileError) as caught:
        loads(text)
    return caught.value.faults
