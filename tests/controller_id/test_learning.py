"""The controller learned: on the public record, on loops of known law, and what is said of what a record lacks."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import MethodError, RecordError
from jointid.config import Axis, File, controller_text, load
from jointid.controller_id.fitting import Fitter
from jointid.controller_id.learn import LearnedController, fill_from_declaration, learn_controller
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.search import Rival, simplest
from jointid.controller_id.structures import Structure
from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import Cascade, Controller
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Injection, InjectionPoint, Record, Timing
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.learned import loop_twin
from tests.learned_once import find_law

T = 1e-3


def made(controller: Controller, step: float = 1e-7, *, short: bool = False) -> Record:
    """A rigid axis of 5 kg under a law, with noise on the log and a rounded position."""
    long = trapezoids([0.1, 0.3, 0.5], 2.0, 0.2, T, 0.1, 6.0)
    reference = trapezoids([0.2, 0.5], 2.0, 0.05, T, 0.05, 2.0) if short else long
    values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}
    error = 0.02 * np.random.default_rng(3).standard_normal(reference.size)
    loop = ClosedLoop(RigidJoint("prismatic"), controller)
    return simulated_record(loop, reference, values, sample_time=T, encoder_step=step, torque_noise=error)


@pytest.mark.slow
def test_a_slower_position_loop_counts_from_the_first_sample_of_the_file() -> None:
    record = made(
        Cascade(position_gain=60.0, velocity_gain=500.0, position_period=4 * T, position_offset=T), short=True
    )
    learned = learn_controller(replace(record, begin=2 * T))
    assert learned.controller.position_period == pytest.approx(4 * T)
    assert learned.controller.position_offset == pytest.approx(3 * T)


@pytest.mark.parametrize("number", [pytest.param(600, marks=pytest.mark.slow), 601])
def test_what_is_told_of_a_law_that_a_search_found(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = loop_twin(number)
    find_law(monkeypatch, twin.structure, twin.numbers)
    learned = learn_controller(twin.record)
    assert str(learned.structure) == str(twin.structure)
    for name in ("position_gain", "velocity_gain"):
        if name in twin.numbers:
            assert abs(learned[name].value - twin.numbers[name]) <= 4 * learned[name].std, name
    assert learned.share < 0.05
    turned = replace(twin.record, torque=replace(twin.record.torque, values=-twin.record.torque.values))
    with pytest.raises(MethodError):
        learn_controller(turned)


GAINS = {"position_gain": 60.0, "velocity_gain": 500.0}


def test_an_interval_spans_the_laws_that_the_record_does_not_distinguish(monkeypatch: pytest.MonkeyPatch) -> None:
    record = made(Cascade(position_gain=60.0, velocity_gain=500.0))
    fitter = Fitter(prepare_loop_record(record))
    apart = fitter.law(Structure(velocity_filter="mean 2"), GAINS)
    filtered = fitter.law(Structure(velocity_filter="first order"), {**GAINS, "velocity_filter.time_constant": 2e-4})
    pd = fitter.law(Structure("PD", "difference", "mean 2"), {"position_gain": 3e4, "derivative_gain": 500.0})

    def found(*worse: float) -> LearnedController:
        rivals = [Rival(one, by, 0.01) for one, by in zip((apart, filtered, pd), worse, strict=True)]
        find_law(monkeypatch, Structure(), GAINS, *rivals)
        return learn_controller(record)

    alone = found(50.0, 50.0, 1.0)["velocity_gain"]  # a PD's gains are others
    assert (alone.lower, alone.upper) == pytest.approx((alone.value - 2 * alone.std, alone.value + 2 * alone.std))
    spanned = found(5.0, 5.0, 1.0)
    (best, _), *others = (fitter.finish(one) for one in (fitter.law(Structure(), GAINS), apart, filtered))
    for name in GAINS:
        one = spanned[name]
        for law, known in others:
            deviation = known.std[list(law.numbers).index(name)]
            assert one.lower <= best.numbers[name] <= one.upper, name
            assert one.lower <= law.numbers[name] - 1.99 * deviation < law.numbers[name] + 1.99 * deviation <= one.upper
    assert spanned["velocity_gain"].spread > 10 * 2 * alone.std
    assert {one.structure for one in spanned.alternatives} == {apart.structure, filtered.structure, pd.structure}
    assert [one.structure for one in found(5.0, 50.0, 70.0).alternatives] == [apart.structure]
    assert [(one.name, one.unit) for one in spanned.numbers] == [
        ("position_gain", "1/s"), ("velocity_gain", "N per m/s"),
    ]  # fmt: skip


def test_gains_come_out_in_controller_units(monkeypatch: pytest.MonkeyPatch) -> None:
    record = made(Cascade(position_gain=60.0, velocity_gain=250.0, gain=2.0, limit=9.5))
    find_law(monkeypatch, Structure(), GAINS)
    learned = learn_controller(record, gain=2.0)
    values = {"position_gain": 60.0, "velocity_gain": 250.0, "limit": 9.5}
    assert {one.name: one.value for one in learned.numbers} == pytest.approx(values, rel=2e-3)
    assert {name: getattr(learned.controller, name) for name in values} == pytest.approx(values, rel=2e-3)


def test_a_law_that_leaves_what_no_noise_leaves_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = loop_twin(601)
    find_law(monkeypatch, twin.structure, twin.numbers)
    torque = twin.record.torque
    rng, size = np.random.default_rng(4), torque.values.size
    pulses = np.repeat(rng.choice([-1.0, 0.0, 1.0], size // 20 + 1), 20)[:size]
    pulsed = replace(torque, values=torque.values + 0.5 * float(np.std(torque.values)) * pulses)
    with pytest.raises(MethodError, match=r"leaves 3\d\.?\d* % of it, 3\d.* averaged over 10 samples"):
        learn_controller(replace(twin.record, torque=pulsed))


@pytest.mark.slow
def test_no_law_is_made_up_where_the_record_shows_none(data_dir: Path) -> None:
    file = load(Path(__file__).resolve().parents[2] / "examples" / "kr300" / "axis3.toml")
    with pytest.raises(MethodError):
        learn_controller(file.record(data_dir / "kr300" / "rec_A.mat"))


def test_what_the_record_does_not_show_is_kept_as_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    record = made(Cascade(position_gain=60.0, velocity_gain=500.0))
    find_law(monkeypatch, Structure(), GAINS)
    declared = Cascade(position_gain=1.0, velocity_gain=1.0, limit=900.0, delay=5e-4)
    learned = learn_controller(record, declared=declared)
    assert (learned.controller.limit, learned.controller.delay) == (900.0, 5e-4)
    assert learned.kept == {"limit": 900.0, "delay": 5e-4}
    assert "limit = 900.0" in controller_text(learned.controller, learned.transmission)


@pytest.mark.slow
def test_a_law_that_averages_its_reference_is_learned_with_its_time() -> None:
    samples = 5
    law = Cascade(position_gain=40.0, velocity_gain=300.0, velocity_feedforward=1.0, reference_average=samples * T)
    learned = learn_controller(made(law)).controller
    assert learned.reference_average == pytest.approx(samples * T)
    assert learned.reference_delay == 0.0
    assert learned.position_gain == pytest.approx(40.0, rel=0.02)
    assert learned.velocity_gain == pytest.approx(300.0, rel=0.02)


def test_what_a_wrong_law_leaves_is_not_called_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    record = made(Cascade(position_gain=60.0, velocity_gain=500.0, velocity_filter=(0.1, 0.2, 0.3, 0.4)))
    find_law(monkeypatch, Structure(), GAINS)
    wrong = learn_controller(record)
    assert wrong.regression is not None and wrong.share > 3.0 * wrong.regression
    assert learn_controller(made(Cascade(position_gain=60.0, velocity_gain=500.0))).regression is None


def test_of_laws_alike_a_much_simpler_one_is_taken() -> None:
    fitter = Fitter(prepare_loop_record(made(Cascade(position_gain=60.0, velocity_gain=500.0), short=True)))
    laws = (
        Structure(velocity_filter="mean 6"),
        Structure(velocity_filter="first order"),
        Structure("P-P", "share", "second order", frozenset({"acceleration"})),
    )
    plain, filtered, wild = (fitter.fit(law, {}, fitter.shared, 0) for law in laws)
    assert plain is not None and filtered is not None and wild is not None
    assert simplest(wild, [Rival(filtered, 1.0, 0.01), Rival(plain, 7.0, 0.01)]) is plain
    assert simplest(wild, [Rival(plain, 12.0, 0.01)]) is wild  # that one is ruled out
    assert simplest(filtered, [Rival(plain, 7.0, 0.01)]) is filtered
    less = fitter.fit(replace(laws[2], feedforward=frozenset()), {}, fitter.shared, 0)
    assert less is not None
    assert simplest(wild, [Rival(less, 30.0, 5e-4)]) is less  # what the feed-forward carries is next to nothing


def _without_motion(record: Record) -> Record:
    return replace(record, reference=replace(record.reference, values=np.zeros(len(record.reference))))


def _all_injected(record: Record) -> Record:
    return replace(record, injected=Injection(replace(record.torque, timing=Timing.HELD), InjectionPoint.AFTER_LIMIT))


@pytest.mark.parametrize(
    ("change", "gain", "kind"),
    [
        (lambda record: record.without("motor_position"), 1.0, RecordError),
        (lambda record: replace(record, computed_by=Cascade(position_gain=1.0, velocity_gain=1.0)), 1.0, RecordError),
        (_without_motion, 1.0, RecordError),
        (_all_injected, 1.0, RecordError),
        (lambda record: record, 0.0, MethodError),
    ],
)
def test_a_record_that_cannot_tell_is_refused(
    change: Callable[[Record], Record], gain: float, kind: type[Exception]
) -> None:
    with pytest.raises(kind):
        learn_controller(change(made(Cascade(position_gain=60.0, velocity_gain=500.0))), gain=gain)


MOTOR = Cascade(position_gain=1.0, velocity_gain=1.0, gain=0.5, ratio=10.0, limit=40.0)  # 40 A, 20 N m, 200 on the load


@pytest.mark.parametrize(
    ("declared", "gain"), [(MOTOR, 5.0), (Cascade(position_gain=1.0, velocity_gain=1.0, ratio=10.0), 1.0), (None, 1.0)]
)
def test_a_unit_of_the_drive_is_the_same_on_the_load(declared: Controller | None, gain: float) -> None:
    axis = Axis(name=None, joint=RigidJoint("prismatic"), columns={}, controller=declared)
    assert File(axes=(axis,), method=DIDIM()).learn_settings["gain"] == gain


def test_a_declared_limit_stays_the_torque_that_it_is() -> None:
    amperes, _ = fill_from_declaration(Cascade(position_gain=1.0, velocity_gain=1.0, gain=5.0), MOTOR)
    newtons, _ = fill_from_declaration(Cascade(position_gain=1.0, velocity_gain=1.0), MOTOR)
    assert (amperes.limit, newtons.limit) == (40.0, 200.0)
