"""Keys that are deleted."""

from __future__ import annotations

import pytest

from jointid.common.errors import JointFileError
from jointid.config import deleted, loads

TEXT = '[joint]\nkind = "revolute"\n[method]\nfrequenzies = 30.0\n[record.channels.torque]\ncolumn = "i"\nbitz = 12\n'


def test_every_deleted_key_has_its_own_sentence_and_is_no_misspelling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deleted, "DELETED", {"method.frequenzies": "one.", "record.channels.*.bitz": "another."})
    with pytest.raises(JointFileError) as caught:
        loads(TEXT)
    found = {fault.place: (fault.code, fault.rpartition(": ")[2]) for fault in caught.value.faults}
    assert found[("method", "frequenzies")] == ("unknown", "one.")
    assert found[("record", "channels", "torque", "bitz")] == ("unknown", "another.")
    assert deleted.sentence_of(("joints", 1, "channels", "torque", "bitz")) == " is no longer a key: another."
