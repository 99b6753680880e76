"""A joint file that is written is read back as it was."""

from dataclasses import replace
from pathlib import Path

import pytest

from jointid.common.errors import JointFileError
from jointid.config import controller_text, edit, load, loads, move_paths, replace_table, save_with_controller
from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import PID, Cascade, FirstOrder, Notch
from tests.joint_files import CASCADE, CHANNELS, JOINT, SMALLEST

SLOW = Cascade(position_gain=1.0, velocity_gain=2.0, period=125e-6, position_period=1e-3, position_offset=250e-6)
NOTCHED = PID(
    position_gain=1.0, integral_gain=2.0, derivative_gain=3.0, torque_filters=(FirstOrder(1e-3), Notch(80.0, 20.0, 0.1))
)
FAST = [replace(SLOW, position_gain=one, velocity_filter=FirstOrder(one)) for one in (2.0, 500.0, 500.5, 1e16, 1e300)]


@pytest.mark.parametrize("controller", [SLOW, NOTCHED, *FAST])
def test_a_controller_is_put_into_the_text_of_a_file(controller: Cascade | PID) -> None:
    before = f"# a joint\n{JOINT}{CHANNELS}"
    nested = '[controller]  # drive\nlaw = "pd"\n[controller.velocity_filter]\nnumerator = [\n  0.5\n]\n\n'
    after = "[parameters]\noffset = 0.0  # kept\n"
    for old in ("", CASCADE, nested, '[[controller.torque_filters]]\nkind = "notch"\n'):
        made = edit(before + old + after, replace_table(controller_text(controller)))
        file = loads(before + after)
        assert loads(made) == replace(file, axes=(replace(file.axis, controller=controller),), method=DIDIM())
        assert made.startswith(before)
        assert "# kept" in made
    inline = edit("controller = { law = 'pd' }\n" + before, replace_table(controller_text(controller)))
    assert loads(inline).controller == controller
    with pytest.raises(JointFileError):
        edit("[joint", replace_table(controller_text(controller)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[record]\nfile = "a.csv" # mine\n', '[record]\nfile = "../runs/a.csv" # mine\n'),
        ("[record]\ntime = 't'\n  file='sub/a.csv'\n", "[record]\ntime = 't'\n  file=\"../runs/sub/a.csv\"\n"),
        ('[record]\nfile = "../there/a.csv"\n', '[record]\nfile = "a.csv"\n'),
        ('[record]\nfile = "/data/a.csv"\n', '[record]\nfile = "/data/a.csv"\n'),
        ('[record]\nfile = "Größe \\"1\\".csv"\n', '[record]\nfile = "../runs/Größe \\"1\\".csv"\n'),
        (
            '[[records]]\nfile = "a.csv"\n[[records]]\nown = ["file"]\nfile = "b.csv"\n',
            '[[records]]\nfile = "../runs/a.csv"\n[[records]]\nown = ["file"]\nfile = "../runs/b.csv"\n',
        ),
        ('record = { file = "a.csv" }\n', 'record = { file = "../runs/a.csv" }\n'),
        ('[record]\nfile = """a.csv"""\n', '[record]\nfile = "../runs/a.csv"\n'),
        ('[joint]\nfile = "a.csv"\n', '[joint]\nfile = "a.csv"\n'),
    ],
)
def test_paths_lead_to_the_same_files_from_another_folder(text: str, expected: str, tmp_path: Path) -> None:
    assert edit(text, move_paths(tmp_path / "runs", tmp_path / "there")) == expected
    assert edit(text, move_paths(tmp_path / "runs", tmp_path / "there" / ".." / "runs")) == text


def test_a_file_is_made_to_name_another_record(tmp_path: Path) -> None:
    law = Cascade(position_gain=1.0, velocity_gain=2.0)
    for record in ('file = "old.csv"  # of Monday', 'time = "t"'):
        file = loads(f"# an axis\n[record]\n{record}\n{SMALLEST}", tmp_path)
        save_with_controller(file, law, tmp_path / "new.toml", tmp_path / "logs" / "run 1.csv")
        again = load(tmp_path / "new.toml")
        assert (again.source.file, again.controller) == (str(tmp_path / "logs" / "run 1.csv"), law)
        assert again.text.startswith("# an axis\n")


class Other(Cascade):
    """A law that no word is for."""


def test_a_controller_that_a_joint_file_cannot_say_is_not_written() -> None:
    with pytest.raises(JointFileError):
        controller_text(Other(position_gain=1.0, velocity_gain=1.0))
