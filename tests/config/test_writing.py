"""A joint file that is written is read back as it was."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jointid.common.errors import JointFileError
from jointid.common.parameters import Parameter
from jointid.common.transmission import SIDES, Transmission
from jointid.config import (
    JointFile,
    Run,
    Source,
    Together,
    controller_text,
    dumps,
    load,
    load_to_learn,
    loads,
    with_paths,
    with_record,
    with_table,
)
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.models.controllers import (
    PD,
    PID,
    Cascade,
    Controller,
    DigitalFilter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    StateSpaceController,
)
from jointid.models.disturbances import Drift
from jointid.models.friction import AsymmetricFriction, SymmetricFriction
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.models.springs import ElasticLoad
from jointid.records.columns import Column, known_units
from jointid.records.drives import Drive, profile_names
from jointid.records.record import InjectionPoint, Tap, Timing
from jointid.records.signals.filtering import Filtering
from tests.joint_files import (
    CASCADE,
    CHANNELS,
    JOINT,
    SMALLEST,
    told,
)

positive = st.floats(1e-9, 1e9)
hertz, seconds, none_or_more = st.floats(0.01, 40.0), st.floats(0.0, 1e-4), positive | st.just(0.0)
words = st.text(min_size=1, max_size=8)
row = st.lists(positive, min_size=1, max_size=3).map(tuple)
filters = st.one_of(
    st.builds(DigitalFilter, row, row),
    st.builds(MovingAverage, st.integers(1, 9)),
    st.builds(FirstOrder, none_or_more),
    st.builds(SecondOrder, hertz, positive, st.none() | hertz, st.floats(-0.5, 1.0)),
    st.builds(Notch, hertz, positive, none_or_more),
)
law = {
    "gain": positive,
    "limit": positive | st.just(np.inf),
    "period": st.none() | st.floats(1e-6, 1e-2),
    "delay": none_or_more,
    "interpolation": st.sampled_from((None, "hold", "linear", "cubic")),
    "reference_average": seconds,
    "reference_delay": seconds,
    "position_gain": positive,
    "velocity_filter": row | filters,
    "torque_filters": st.lists(filters, max_size=3).map(tuple),
    "acceleration_feedforward": none_or_more,
    "viscous_feedforward": none_or_more,
    "coulomb_feedforward": none_or_more,
    "constant_feedforward": st.floats(-1e9, 1e9),
    "undeclared": st.sampled_from(("possible", "none")),
}
windups = st.sampled_from(("hold", "track", "none"))
velocities = st.sampled_from(("difference", "channel", "none"))


def controllers(ratio: st.SearchStrategy[float]) -> st.SearchStrategy[Controller]:
    shared = law | {"ratio": ratio}
    return st.one_of(
        st.builds(
            Cascade,
            velocity_gain=positive,
            integral_gain=none_or_more,
            anti_windup=windups,
            velocity_feedforward=none_or_more,
            reference_velocity=st.sampled_from(("difference", "channel")),
            velocity_limit=positive | st.just(np.inf),
            **shared,
        ),
        st.builds(PD, derivative_gain=positive, reference_velocity=velocities, **shared),
        st.builds(
            PID,
            derivative_gain=positive,
            integral_gain=none_or_more,
            anti_windup=windups,
            reference_velocity=velocities,
            **shared,
        ),
    )


def columns(channel: str, geared: bool) -> st.SearchStrategy[Column]:
    choices: dict[str, Any] = {"side": st.sampled_from((None, "motor", "load"))} if geared else {}
    if channel == "torque":
        choices |= {"tap": st.sampled_from(Tap), "unit": st.sampled_from(("N", "kN"))}
    elif channel == "injected":
        choices |= {"at": st.sampled_from(InjectionPoint), "unit": st.just("mN")}
    else:
        choices |= {"unit": st.sampled_from(known_units(channel, "prismatic"))}
    return st.builds(
        Column,
        words,
        gain=positive,
        sign=st.sampled_from((1, -1)),
        timing=st.none() | st.sampled_from(Timing),
        sample_time=st.none() | positive,
        optional=st.booleans(),
        **choices,
    )


JOINTS: list[Joint] = [
    RigidJoint("prismatic"),
    RigidJoint("prismatic", friction=AsymmetricFriction()),
    RigidJoint("prismatic", gravity=Gravity("constant", Counterbalance(constant=3.0, rate=-0.5))),
    FlexibleJoint("prismatic"),
    FlexibleJoint("prismatic", friction=AsymmetricFriction()),
    FlexibleJoint("prismatic", gravity=Gravity("constant")),
    RigidJoint("prismatic", ripple=PositionHarmonics(0.005, 3)),
    FlexibleJoint("prismatic", spring=ElasticLoad(), ripple=PositionHarmonics(0.02, side="load")),
]


@st.composite
def joint_files(draw: st.DrawFn) -> JointFile:
    side = st.sampled_from(SIDES)
    gear = draw(
        st.none()
        | st.builds(Transmission, load=st.just("prismatic"), ratio=positive, sign=st.sampled_from((1, -1)), side=side)
    )
    joint = dataclasses.replace(draw(st.sampled_from(JOINTS)), transmission=gear)
    if joint.gravity is not None and gear is not None:  # a file says the angle of the load, whatever the side
        weight = dataclasses.replace(joint.gravity, angle=gear.torque("load"))
        joint = dataclasses.replace(joint, gravity=weight)
    ratio = st.just(1.0) if gear is None else side.map(gear.torque)
    names = ["torque", "reference", "reference_velocity", "motor_position", "load_position"]
    names += draw(st.lists(st.just("injected"), max_size=1))
    whole = st.integers(1, 50)
    rigid = st.builds(
        DIDIM,
        form=st.sampled_from(("residual", "paper")),
        scaled_iterations=whole,
        tolerance=positive,
        iterations=whole,
    )
    flexible = st.just(DIDIM.paper("flexible")) | st.builds(
        DIDIM,
        minimiser=st.sampled_from(("least-squares", "nelder-mead")),
        frequency=st.none() | positive,
        rigid_cutoff=st.none() | positive,
        tolerance=positive,
        simulations=whole,
        restarts=whole,
        statistics=st.sampled_from(("sensitivities", "inverse-model")),
        free=st.sampled_from(((), ("position_gain",), ("position_gain", "delay"))),
    )
    estimators = st.sampled_from(("ols", "weighted", "iv"))
    ripple = st.builds(PositionHarmonics, positive, st.integers(1, 9))
    drift = st.builds(Drift, st.sampled_from(("force", "viscous", "both")))
    effects = st.just(()) | st.tuples(ripple) | st.tuples(drift) | st.tuples(ripple, drift)
    return JointFile(
        joint=joint,
        columns={name: draw(columns(name, gear is not None)) for name in names},
        method=draw(st.builds(IDIM, estimators, effects) | (flexible if joint.model == "flexible" else rigid)),
        controller=draw(controllers(ratio)),
        filtering=draw(
            st.sampled_from((Filtering.published(), Filtering.as_in_paper()))
            | st.builds(
                Filtering,
                st.none() | positive,
                borders=st.tuples(whole, whole),
                timing=st.just("as_sampled"),
                aliasing=st.sampled_from(("refused", "warned")),
            )
        ),
        drive=draw(
            st.builds(
                Drive,
                profile=st.none() | st.sampled_from(profile_names()),
                axis=st.none() | whole,
                rated_torque=st.none() | positive,
                counts_per_metre=positive,
                load_counts_per_metre=positive,
            )
        ),
        parameters={
            p.name: draw(
                st.sampled_from((p, p.fix(min(3.0, p.upper)), dataclasses.replace(p, upper=min(5.0, p.upper))))
            )
            for p in joint.parameters
            if p.free and draw(st.booleans())
        },
        source=draw(
            st.builds(
                Source,
                st.sampled_from(("run.csv", "runs/run 1.TXT", "../run.dat")),
                time=st.none() | words,
                sample_time=st.none() | positive,
                options=st.fixed_dictionaries({}, optional={"decimal": st.just(","), "header": st.booleans()}),
            )
        ),
        name=draw(st.none() | words),
        runs=draw(
            st.lists(
                st.builds(
                    Run,
                    st.sampled_from(("run.csv", "runs/run 2.TXT")),
                    added_inertia=st.just(0.0) | positive,
                    own=st.lists(st.sampled_from([p.name for p in joint.parameters])).map(tuple),
                    controller=st.fixed_dictionaries({}, optional={"position_gain": positive}),
                ),
                max_size=2,
            ).map(tuple)
        ),
        together=Together(
            free=draw(st.sampled_from(((), ("drive_gain",)))), weighting=draw(st.sampled_from(("spectrum", "level")))
        ),
    )


@settings(max_examples=25)  # one takes 40 ms
@given(joint_files())
def test_what_is_written_is_read_back(file: JointFile) -> None:
    assert loads(dumps(file)) == file


SLOW = Cascade(position_gain=1.0, velocity_gain=2.0, period=125e-6, position_period=1e-3, position_offset=250e-6)
NOTCHED = PID(
    position_gain=1.0, integral_gain=2.0, derivative_gain=3.0, torque_filters=(FirstOrder(1e-3), Notch(80.0, 20.0, 0.1))
)


@pytest.mark.parametrize("controller", [SLOW, NOTCHED, Cascade(position_gain=1.0, velocity_gain=2.0)])
def test_a_controller_is_put_into_the_text_of_a_file(controller: Cascade | PID) -> None:
    before = f"# a joint\n{JOINT}{CHANNELS}"
    nested = '[controller]  # drive\nlaw = "state_space"\nC = [1.0]\nA = [\n  [0.5]\n]\n[controller.B]\n'
    nested += "position = [1.0]\n[controller.D]\nreference = 1.0\n\n"
    after = "[parameters]\noffset = 0.0  # kept\n"
    for old in ("", CASCADE, nested, '[[controller.torque_filters]]\nkind = "notch"\n'):
        made = with_table(before + old + after, controller_text(controller))
        assert loads(made) == dataclasses.replace(loads(before + after), controller=controller, method=DIDIM())
        assert made.startswith(before)
        assert "# kept" in made
    inline = with_table("controller = { law = 'pd' }\n" + before, controller_text(controller))
    assert loads(inline).controller == controller
    assert tomllib.loads(with_table("", controller_text(controller))) == tomllib.loads(controller_text(controller))
    with pytest.raises(JointFileError, match="is not TOML"):
        with_table("[joint", controller_text(controller))


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
        (
            "[record] # two\nfiles = [\"a.csv\",\n  'sub/[b].csv'] # of one run\noffsets = [0, 1]\n",
            '[record] # two\nfiles = ["../runs/a.csv", "../runs/sub/[b].csv"] # of one run\noffsets = [0, 1]\n',
        ),
        ('record = { file = "a.csv" }\n', '[record]\nfile = "../runs/a.csv"\n'),
        ('[record]\nfile = """a.csv"""\n', '[record]\nfile = "../runs/a.csv"\n'),
        ('[joint]\nfile = "a.csv"\n', '[joint]\nfile = "a.csv"\n'),
    ],
)
def test_paths_lead_to_the_same_files_from_another_folder(text: str, expected: str, tmp_path: Path) -> None:
    assert with_paths(text, tmp_path / "runs", tmp_path / "there") == expected
    assert with_paths(text, tmp_path / "runs", tmp_path / "there" / ".." / "runs") == text


def test_numbers_of_filters_are_named_with_points() -> None:
    notched = CASCADE + 'torque_filters = [{ kind = "notch", frequency = 80, bandwidth = 20 }]\n'
    runs = '[[records]]\nfile = "a.csv"\n[[records]]\nfile = "b.csv"\ncontroller = '
    name, free = "torque_filters.0.frequency", '[method]\nfree = ["torque_filters.0.frequency"]\n'
    for written in ("{ torque_filters.0.frequency = 90.0 }", '{ "torque_filters.0.frequency" = 90.0 }'):
        file = loads(JOINT + CHANNELS + notched + free + runs + written)
        assert isinstance(file.method, DIDIM)
        assert file.method.free == (name,)
        assert [one.controller.torque_filters[0].frequency for one in file.each()] == [80.0, 90.0]  # type: ignore[union-attr]
        assert loads(dumps(file)) == file
    for wrong in ("{ torque_filters.1.frequency = 90.0 }", "{ torque_filters.0.frequency = -9 }"):
        (said,) = told(JOINT + CHANNELS + notched + runs + wrong)
        assert said.startswith("records.2.controller")


@pytest.mark.parametrize(
    "record",
    [
        "[record]\nfile = 'old.csv'  # of Monday\ntime = 't'\n",
        "[record]  # a log\ntime = 't'\n",
        "[record]\nfiles = ['q.csv', 'tau.csv']  # of Monday\n",
        "",
    ],
)
def test_a_file_is_made_to_name_another_record(record: str) -> None:
    before = f"# an axis\n[joint]\nkind = 'prismatic'\n\n{record}"
    text = f"{before}[record.channels]\ntorque = {{ unit = 'N' }}\n[drive]\nprofile = 'generic'\n"
    made = with_record(text, "logs/run 1.csv")
    expected = tomllib.loads(text)
    expected["record"].pop("files", None)
    expected["record"]["file"] = "logs/run 1.csv"
    assert tomllib.loads(made) == expected
    assert made.startswith("# an axis\n") and ("# of Monday" in made) == ("# of Monday" in record)


def test_units_stand_beside_the_gains_of_a_written_controller() -> None:
    law = Cascade(position_gain=40.0, velocity_gain=2.0, velocity_filter=FirstOrder(2e-3), gain=3.0)
    joint = loads(f"{JOINT}{CHANNELS}").joint
    text = controller_text(law, joint=joint)
    assert "position_gain = 40.0  # 1/s\n" in text
    assert "velocity_gain = 2.0  # controller units per " in text
    assert "time_constant = 0.002  # s\n" in text
    assert tomllib.loads(text) == tomllib.loads(controller_text(law))
    plain = controller_text(dataclasses.replace(law, gain=1.0), joint=joint)
    assert f"velocity_gain = 2.0  # {joint.force_unit} per " in plain


@pytest.mark.parametrize(
    ("table", "gain"),
    [("", 1.0), ("[controller]\ngain = 35.0\n", 35.0), ("[controller]\nlaw = 'pid'\ngain = 2.0\n", 2.0)],
)
def test_a_file_whose_controller_is_to_be_learned_needs_no_gains(table: str, gain: float, tmp_path: Path) -> None:
    """Nor a method that does without a controller: a flexible joint has none from torque and motor position."""
    path = tmp_path / "joint.toml"
    path.write_text(
        "[joint]\nkind = 'revolute'\nmodel = 'flexible'\n[record.channels]\n"
        "torque = { column = 'u', unit = 'N m', timing = 'held', tap = 'command' }\n"
        "reference = { column = 'r', unit = 'rad' }\n"
        f"motor_position = {{ column = 'q', unit = 'rad' }}\n{table}",
        encoding="utf-8",
    )
    file = load_to_learn(path)
    assert isinstance(file.controller, Cascade | PID) and file.controller.gain == gain
    with pytest.raises(JointFileError, match=r"controller"):
        load(path)


def test_a_state_space_law_is_written() -> None:
    law = StateSpaceController(A=np.eye(1) / 2, B={"position": np.ones(1)}, C=[1.0], D={"reference": 1.0})
    file = dataclasses.replace(loads(SMALLEST), controller=law)
    again = loads(dumps(file)).controller
    assert again is not None
    for name in ("A", "B", "C", "D", "F"):
        np.testing.assert_array_equal(getattr(again.law(1.0), name), getattr(law.law(1.0), name))


class Other(Cascade):
    """A law that no word is for."""


class OtherFriction(SymmetricFriction):
    """A friction that no word is for."""


@pytest.mark.parametrize(
    "changes",
    [
        {"controller": Other(position_gain=1.0, velocity_gain=1.0)},
        {"method": IDIM(effects=(PositionHarmonics(0.1, side="load"),))},
        {"joint": RigidJoint("prismatic", friction=OtherFriction())},
        {"joint": RigidJoint("prismatic", torque_unit="A")},
        {"joint": RigidJoint("prismatic"), "method": DIDIM(frequency=9.0)},
        {"joint": FlexibleJoint("prismatic"), "method": DIDIM("paper")},
        {"parameters": {"mass": Parameter("mass", "M", RigidJoint("prismatic").parameters[0].quantity)}},
    ],
)
def test_what_a_joint_file_cannot_say_is_not_written(changes: dict[str, Any]) -> None:
    with pytest.raises(JointFileError):
        dumps(dataclasses.replace(loads(SMALLEST), **changes))
