"""A joint file becomes the objects that the verbs take."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.config import Axis, File, Run, Source, dumps, load, loads
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.records.record import Tap, Timing
from jointid.records.resampling import Resampling
from tests.joint_files import BOTH_ENCODERS, CASCADE, CHANNELS, FLEXIBLE, JOINT, LINK, ROOT, SMALLEST, told


def test_every_default() -> None:
    axis = Axis(
        name=None,
        joint=ji.RigidJoint("prismatic", ji.friction.Friction()),
        columns={"torque": ji.Column("i"), "reference": ji.Column("r"), "motor_position": ji.Column("q")},
        controller=ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0),
    )
    assert loads(SMALLEST) == File(axes=(axis,), method=ji.DIDIM())
    assert loads(SMALLEST).path == Path("joint.toml")


def test_all_of_a_file() -> None:
    """Controllers are in the test of their writing, filters in that of units, parameters and gravity further down."""
    file = loads(
        """
        [joint]
        kind = "revolute"
        model = "flexible"
        friction = "asymmetric"
        name = "axis 3"
        [record]
        file = "runs/run1.csv"
        time = "stamp"
        time_unit = "ms"
        sample_time = 0.001
        resample = { sample_time = 0.001, method = "cubic", longest_gap = 0 }
        delimiter = ";"
        decimal = ","
        header = true
        [record.channels]
        torque = { column = "i", unit = "mA", gain = 0.5, sign = -1, timing = "averaged", tap = "measured" }
        load_position = { column = "p", optional = true, sample_time = 0.002 }
        injected = { column = "x", unit = "A", at = "after_limit", in_torque = false }
        [filtering]
        position_cutoff = 100.0
        cutoff = 20.0
        decimation = 5
        borders = [10, 0]
        timing = "as_sampled"
        [method]
        name = "idim"
        estimator = "iv"
        [parameters]
        stiffness = { start = 8e5, lower = 1e3, upper = 1e7 }
        motor_inertia = { value = 0.1, upper = 1.0 }
        """,
        folder="here",
    )
    joint = ji.FlexibleJoint("revolute", ji.friction.Friction("asymmetric"), "A")
    known = {parameter.name: parameter for parameter in joint.parameters}
    columns = {
        "torque": ji.Column("i", "mA", 0.5, -1, Timing.AVERAGED, tap=Tap.MEASURED),
        "load_position": ji.Column("p", optional=True, sample_time=0.002),
        "injected": ji.Column("x", "A", in_torque=False),
    }
    known = {
        "stiffness": dataclasses.replace(known["stiffness"], start=8e5, lower=1e3, upper=1e7),
        "motor_inertia": dataclasses.replace(known["motor_inertia"].fix(0.1), upper=1.0),
    }
    options, resample = {"delimiter": ";", "decimal": ",", "header": True}, Resampling(1e-3, "cubic", longest_gap=0)
    source = Source("runs/run1.csv", "stamp", "ms", 0.001, options=options, resample=resample)
    axis = Axis(name="axis 3", joint=joint, columns=columns, parameters=known, source=source)
    filtering = ji.Filtering(100.0, 20.0, 5, (10, 0), "as_sampled")
    method = ji.IDIM("iv")
    assert file == File(axes=(axis,), method=method, filtering=filtering, parameters=known, name="axis 3")
    assert file.path == Path("here/joint.toml")


def test_gravity() -> None:
    file = loads(
        LINK + "angle = 0.01\ncounterbalance = { cos = 0.2, rate = 1e-3 }\n[parameters]\ngravity_sin = { start = 0.5 }"
    )
    assert file.joint == ji.RigidJoint("revolute", gravity=Gravity("link", Counterbalance(cos=0.2, rate=1e-3), 0.01))
    assert file.parameters["gravity_sin"].start == 0.5
    loaded = loads(FLEXIBLE + '[gravity]\nload = "constant"').joint
    assert loaded == ji.FlexibleJoint("prismatic", gravity=Gravity("constant"))
    assert [p.name for p in loaded.parameters[-2:]] == ["offset", "gravity_constant"]
    assert [p.free for p in loaded.parameters[-2:]] == [False, True]


def test_ripple() -> None:
    file = loads(FLEXIBLE + '[ripple]\nperiod = 0.005\nside = "load"\n[parameters]\nload_harmonic_1_sine = 0.5')
    assert file.joint == ji.FlexibleJoint("prismatic", ripple=PositionHarmonics(0.005, side="load"))
    assert file.parameters["load_harmonic_1_sine"].start == 0.5
    assert [p.name for p in file.joint.parameters[-2:]] == ["load_harmonic_1_cosine", "load_harmonic_1_sine"]
    assert file.joint.rigid == ji.RigidJoint("prismatic", ripple=PositionHarmonics(0.005))


@pytest.mark.parametrize("model", ["rigid", "flexible"])
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (BOTH_ENCODERS + CASCADE, ji.DIDIM()),  # even though there are both positions
        (BOTH_ENCODERS, ji.IDIM()),
        (BOTH_ENCODERS.replace("reference", "injected") + CASCADE, ji.IDIM()),
        (BOTH_ENCODERS + CASCADE + '[method]\nname = "idim"\nestimator = "iv"', ji.IDIM("iv")),
        (CHANNELS + CASCADE + "[method]\ntolerance = 1e-3", ji.DIDIM(tolerance=1e-3)),
    ],
)
def test_the_method(model: str, text: str, expected: object) -> None:
    file = loads(f'{JOINT}model = "{model}"\n{text}')
    assert file.method == expected
    assert loads(dumps(file)) == file


def test_values_are_those_fixed_and_those_started_from() -> None:
    file = loads(SMALLEST + "[parameters]\ninertia = {start = 90.0}\nviscous = 200\ncoulomb = 20\noffset = {start = 1}")
    assert file.axis.values() == {"inertia": 90.0, "viscous": 200.0, "coulomb": 20.0, "offset": 1.0}
    with pytest.raises(ji.MethodError, match=r"every parameter; without one: inertia, viscous, coulomb, offset"):
        loads(SMALLEST).axis.values()


def test_the_files_on_the_pages_are_right() -> None:
    pages = [(ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("joint-file.md", "drives.md")]
    assert len([loads(text) for text in re.findall(r"```toml\n(.*?)```", "".join(pages), re.DOTALL)]) >= 5


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A short record in a folder below the joint file's."""
    time = np.arange(400) * 1e-3
    table = np.column_stack([time, 300 * np.sin(20 * time), 0.1 * np.sin(20 * time), 0.1 * np.sin(20 * time - 0.1)])
    (tmp_path / "runs").mkdir()
    np.savetxt(tmp_path / "runs" / "run.csv", table, delimiter=";", header="t;i;r;q", comments="")
    return tmp_path / "runs" / "run.csv"


def saved(folder: Path, text: str) -> File:
    (folder / "joint.toml").write_text(text, encoding="utf-8")
    return load(folder / "joint.toml")


def test_the_record_lies_beside_the_joint_file(run: Path) -> None:
    folder = run.parents[1]
    record = saved(folder, "[record]\nfile = 'runs/run.csv'\ndelimiter = ';'\n" + SMALLEST).record()
    assert record.channels == ("torque", "reference", "motor_position")
    assert record.name == "run"
    assert saved(folder, SMALLEST).record(run).channels == record.channels
    with pytest.raises(
        ji.RecordError, match=r"joint.toml names no record in \[record\]; add file to it, or name one by --record"
    ):
        saved(folder, SMALLEST).record()


def test_a_channel_that_the_method_does_not_need_may_be_absent(run: Path) -> None:
    without_motor = SMALLEST.replace('"q"', '"nowhere"')
    assert loads(without_motor).record(run).channels == ("torque", "reference")
    with pytest.raises(ji.RecordError, match=r'has no column "nowhere" \(for motor_position\)'):
        loads(without_motor, changes=["method.name=idim"]).record(run)
    without_reference = SMALLEST.replace('"r"', '"nowhere"')
    assert loads(without_reference, changes=["method.name=idim"]).record(run).channels == ("torque", "motor_position")
    with pytest.raises(ji.RecordError, match=r'has no column "nowhere" \(for reference\)'):
        loads(without_reference).record(run)


def test_an_injected_signal_may_be_absent_only_if_it_is_optional(run: Path) -> None:
    injected = SMALLEST.replace("[controller]", 'injected = { column = "x" }\n[controller]')
    with pytest.raises(ji.RecordError, match=r'has no column "x" \(for injected\)'):
        loads(injected).record(run)
    optional = injected.replace('"x"', '"x", optional = true')
    assert loads(optional).record(run).injected is None


def test_a_torque_beyond_the_limit_is_refused(run: Path) -> None:
    with pytest.raises(ji.RecordError):
        loads(SMALLEST + "gain = 2.0\nlimit = 100.0").record(run)
    assert loads(SMALLEST + "gain = 2.0\nlimit = 160.0").record(run).torque is not None
    slow = (loads(f'{SMALLEST}integral_time = "{time}"').record(run).remarks for time in ("30 s", "1 ms"))
    assert list(map(len, slow)) == [2, 1], "an integral time longer than the record"


SEVERAL = """
[[records]]
file = "a.csv"

[[records]]
file = "b.csv"
added_inertia = 10.0
own = ["coulomb"]

[together]
free = ["drive_gain"]
"""


def test_several_records(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = run.parents[1]
    file = saved(folder, "[record]\ndelimiter = ';'\n" + SMALLEST + SEVERAL.replace("a.csv", "runs/run.csv"))
    assert file.runs == (Run("runs/run.csv"), Run("b.csv", 10.0, ("coulomb",)))
    assert file.together == ("drive_gain",) and file.only_lists
    with pytest.raises(ji.RecordError, match=r"b\.csv"):
        file.identify_together()
    (folder / "b.csv").write_bytes(run.read_bytes())
    asked = list[object]()
    monkeypatch.setattr(File, "identify", lambda *_, several, **__: asked.append(several))
    other = folder / "other.csv"
    other.write_bytes(run.read_bytes())
    for paths in ((), (other, folder / "runs" / ".." / "b.csv")):  # one is known by its path
        file.identify_together(paths)
    both = {"added_inertia": [0.0, 10.0], "own": [(), ("coulomb",)], "free": ("drive_gain",)}
    assert asked == [both, both]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SEVERAL.replace('"coulomb"', '"colomb"'), "records.2.own unknown"),
        (SEVERAL.replace('file = "a.csv"', ""), "records.1.file missing"),
        (SEVERAL.replace("10.0", "-10.0"), "records.2.added_inertia value"),
        ("records = 3\n", "records value"),
    ],
)
def test_a_fault_of_several_records_has_its_place(text: str, said: str) -> None:
    assert told(text + SMALLEST if text.startswith("records") else SMALLEST + text) == [said]
