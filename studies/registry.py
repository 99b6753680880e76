"""All studies: what each judges, over which seeds, and the shares that the documentation claims of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal

from jointid.paper.tables import SYMBOLS
from jointid.paper.twin import TABLE_2
from jointid.tuning.margins import NAMES
from studies.forces import ASKED, ForceRun
from studies.loop_faults import NOTHING
from studies.margins import MarginRun
from studies.mechanics import RIGHT
from studies.random_plants import PlantRun
from studies.refusals import FACTORS, INVISIBLE, PLAIN, StiffnessRun
from studies.robots import Found
from studies.setpoints import Said
from studies.stiffness_bounds import BoundRun
from studies.study import Share, Study
from studies.unknown_timing import OTHERS, TRUE
from tests.faults import FAULTS
from tests.faults import PAIRS as FAULT_PAIRS
from tests.mistakes import PAIRS, axis, mistakes_of, more_mistakes_of

LEAST = {"motor_inertia": 0.207, "load_inertia": 0.114, "stiffness": 3003.0}
"""Deviations that no unbiased estimator betters on the twin's loop L19, under white noise for 8 % of the torque."""


def _symbol(name: str) -> str:
    return SYMBOLS.get(name, name)


def _within(name: str, limit: float = 2.0, key: str = "") -> Callable[[Any], bool | None]:
    """Return whether a number of an outcome, or of a part of it, is within a limit of 0; None where it has none."""

    def holds(outcome: Any) -> bool | None:
        numbers = outcome[key] if key else outcome
        return abs(numbers[name]) <= limit if name in numbers else None

    return holds


def _above(name: str, key: str = "") -> Callable[[Any], bool]:
    return lambda outcome: bool((outcome[key] if key else outcome)[name] > 0)


def _inside(deviation: str, name: str) -> Callable[[Any], bool]:
    return lambda outcome: abs(outcome["error"][name]) <= 2 * outcome[deviation][name]


def _is(key: str, expected: object = True) -> Callable[[Any], bool]:
    return lambda outcome: bool(outcome[key] == expected)


def _intervals(low: float, high: float, key: str = "") -> tuple[Share, ...]:
    """Return for each parameter the share within two deviations, and that above the truth, which shows a bias."""
    return tuple(
        one
        for name in TABLE_2
        for one in (
            Share(f"{_symbol(name)} within 2 sigma", _within(name, key=key), low, high),
            Share(f"{_symbol(name)} above the truth", _above(name, key), 0.4, 0.6),
        )
    )


def _coverage(loop: Literal["L19", "L30"], noise: Literal["white", "disturbance"], seeds: range) -> Study:
    white = noise == "white"
    shares = []
    for name in TABLE_2:
        # The offset is told by the mean alone: few degrees of freedom know its noise, and of two estimates of that the
        # larger counts.
        high, offset_high = (0.975, 0.99) if white else (0.985, 0.995)
        high = offset_high if name == "offset" else high
        shares.append(Share(f"{_symbol(name)} in the reported 2 sigma", _inside("sensitivities", name), 0.93, high))
        shares.append(Share(f"{_symbol(name)} above the truth", _above(name, "error"), 0.4, 0.6))
    shares += [
        Share("Fv1 + Fv2 in the reported 2 sigma", lambda run: abs(run["sum_error"]) <= 2, 0.93, 0.985),
        Share("Fv1 and Fv2 said to be known by their sum", _is("inseparable"), 0.98),
        Share("their correlation is -0.93 or stronger", lambda run: run["correlation"] <= -0.93, 0.99),
        Share("residual said to repeat with the motion", _is("repeats"), at_most=0.08),
    ]
    if white:
        shares += [
            Share(f"{_symbol(name)} in the paper's 2 sigma", _inside("inverse_model", name), at_most=high)
            for name, high in (("motor_viscous", 0.5), ("load_viscous", 0.5))
        ]
        shares += [
            Share(f"{_symbol(name)} within 2 of the least deviations", _least(name, best), 0.92)
            for name, best in LEAST.items()
        ]
        shares.append(Share("residual said to be coloured", _is("white", False), at_most=0.08))
    else:
        shares.append(Share("residual said to be coloured", _is("white", False), 0.98))
    words = "white noise on the log" if white else "a white force in the loop"
    return Study(
        f"coverage-{loop}-{'log' if white else 'force'}".lower(),
        f"Intervals of the twin (loop {loop}) under {words} for 8 % of the torque.",
        "studies.coverage:judge",
        seeds,
        tuple(shares),
        ({"loop": loop, "noise": noise},),
    )


def _least(name: str, best: float) -> Callable[[Any], bool]:
    return lambda run: abs(run["error"][name]) <= 2 * best


def _margins(loop: str) -> Callable[[Any], bool | None]:
    def holds(outcome: Any) -> bool | None:
        run = MarginRun(**outcome)
        return all(run.holds(loop, name) for name in NAMES) if loop in run.stated else None

    return holds


def _stiffness(of: Callable[[StiffnessRun], bool | None]) -> Callable[[Any], bool | None]:
    return lambda outcome: of(StiffnessRun(**outcome))


def _within_force(name: str) -> Callable[[Any], bool | None]:
    return lambda outcome: ForceRun(**outcome).within(name)


def _bounds(of: Callable[[BoundRun], bool | None]) -> Callable[[Any], bool | None]:
    return lambda outcome: of(BoundRun(**outcome))


def _robot(of: Callable[[Found], bool | None]) -> Callable[[Any], bool | None]:
    return lambda outcome: of(Found(**outcome))


def _mostly_within(z: Iterable[float]) -> bool:
    """Return whether at least 85 % of the parameters of a robot lie within two deviations."""
    inside = [abs(one) < 2 for one in z]
    return sum(inside) >= 0.85 * len(inside)


def _silent(run: Any) -> bool:
    """Return whether a stiffness may be relied on and is more than three deviations off."""
    return run["z"] is not None and abs(run["z"]) > 3 and run["trust"].startswith("reliable")


def _is_right(run: Any) -> bool:
    """Return whether the fault is named first, or the stiffness holds in spite of it, or is refused."""
    named = bool(run["named"]) and run["named"][0] in RIGHT[run["fault"]]
    return named or run["z"] is None or abs(run["z"]) <= 2


def _stiffness_within_2(run: Any) -> bool | None:
    return None if run["z"] is None else abs(run["z"]) <= 2


def _robots(kind: str, flexible: bool, seeds: range) -> Study:
    return Study(
        f"robots-{kind}",
        f"Random robots of {kind} joints, from torques and references, without a start.",
        "studies.robots:judge",
        seeds,
        (
            Share("the search ends at the noise", _robot(lambda run: run.at_noise), 0.95),
            Share(
                "85 % of the parameters or more within 2 sigma",
                _robot(lambda run: _mostly_within(run.z) if run.at_noise else None),
                0.93,
            ),
        ),
        ({"flexible": flexible},),
    )


def _mistakes() -> tuple[Mapping[str, Any], ...]:
    """Return the mistakes that are made, one at a time on two axes, and more or two at a time on some."""
    one = [(name, mistake) for name in ("rigid", "flexible") for mistake in mistakes_of(axis(name))]
    more = [(name, mistake) for name in ("rigid", "screw", "fast") for mistake in more_mistakes_of(axis(name))]
    two = [("rigid", mistake) for mistake in PAIRS]
    return tuple({"name": name, "mistake": mistake.name} for name, mistake in (*one, *more, *two))


def _is_named(outcome: Any) -> bool:
    return bool({*outcome["right"]} & {*outcome["named"]}) and outcome["worded"]


def _fault(fault: str) -> Share:
    named_first = _is("named", fault)
    return Share(
        f"{fault} is named first", lambda run: named_first(run) if run["fault"] == fault else None, 0.8, tested=False
    )


def _all_within_3(outcome: Any) -> bool | None:
    z = outcome["deviations"]
    return all(abs(one) <= 3 for one in z) if z else None


STUDIES: tuple[Study, ...] = (
    _coverage("L19", "white", range(1, 601)),
    _coverage("L19", "disturbance", range(1, 301)),
    _coverage("L30", "disturbance", range(1, 301)),
    Study(
        "forces",
        "Drives measured under a force in the loop of 0.5 to 5 % of the torque: the drive side and IDIM.",
        "studies.forces:judge",
        range(50),
        tuple(Share(f"{_symbol(name)} in the reported 2 sigma", _within_force(name), 0.91, 0.985) for name in ASKED),
        ({"method": "drive_side"}, {"method": "idim"}),
    ),
    Study(
        "refusals",
        "The twin with its spring made up to 10,000 times stiffer: a stiffness, or a bound of it.",
        "studies.refusals:judge",
        range(1, 3),
        (
            Share("what is said of the stiffness is true", _stiffness(lambda run: run.holds), 0.93),
            Share(
                "a value where K12 can be known to 3 %",
                _stiffness(lambda run: run.value is not None if run.predicted < PLAIN else None),
                0.98,
            ),
            Share(
                "no value where 2 sigma would be as large as K12",
                _stiffness(lambda run: run.value is None if run.predicted > INVISIBLE else None),
                0.98,
            ),
            Share(
                "a bound where the value is refused",
                _stiffness(lambda run: run.bound is not None if run.value is None else None),
                0.95,
            ),
        ),
        tuple({"factor": factor, "noise": noise} for factor in FACTORS for noise in ("disturbance", "white")),
    ),
    Study(
        "bounds",
        "Random drives of unknown load friction and damping: a stiffness, or a bound of it.",
        "studies.stiffness_bounds:identify_plant",
        range(20),
        (
            Share("the drive is answered", _bounds(lambda run: not run.error), 0.97),
            Share(
                "the spring is at least as stiff as its bound",
                _bounds(lambda run: None if run.bound is None else not run.violated),
                0.9,
            ),
            Share(
                "a value where K12 can be known to 3 %",
                _bounds(lambda run: not run.refused if run.predicted < PLAIN and not run.error else None),
                0.94,
            ),
            Share(
                "a refusal within 300 simulations",
                _bounds(lambda run: run.simulations <= 300 if run.refused else None),
                0.5,
            ),
        ),
    ),
    Study(
        "margins",
        "Margins that are stated of random flexible drives, beside those of the true joint.",
        "studies.margins:judge",
        range(20),
        (
            Share("margins are stated", lambda run: bool(run["stated"]), 0.95),
            Share("all of the present loop hold", _margins("present"), 0.95),
            Share("all of the proposed loop hold", _margins("proposed"), 0.95),
        ),
    ),
    Study(
        "false-alarms",
        "The twin with nothing wrong, on both loops with either noise.",
        "studies.loop_faults:name_first",
        range(25),
        (Share("nothing is named", lambda named: named == NOTHING, 0.95),),
        tuple(
            {"loop": loop, "noise": noise, "fault": NOTHING}
            for loop in ("L19", "L30")
            for noise in ("white", "disturbance")
        ),
    ),
    Study(
        "faults",
        "The twin with one thing wrong in loop or log.",
        "studies.loop_faults:judge_fault",
        range(1, 4),
        (
            Share("the fault is named first", lambda run: run["named"] == run["fault"], 0.85),
            *map(_fault, FAULTS),
        ),
        tuple(
            {"loop": loop, "noise": noise, "fault": fault}
            for fault in FAULTS
            for loop, noise in (("L19", "disturbance"), ("L30", "white"))
        ),
    ),
    Study(
        "two-faults",
        "The twin with two things wrong in loop or log.",
        "studies.loop_faults:judge_pair",
        range(1, 2),
        (
            Share("one of them is named first", lambda run: bool({*run["named"][:1]} & {*run["faults"]}), 0.95),
            Share("both are named, and nothing else", lambda run: sorted(run["named"]) == sorted(run["faults"]), 0.8),
        ),
        tuple({"pair": pair} for pair in FAULT_PAIRS),
    ),
    Study(
        "mistakes",
        "Mistakes that a user makes in telling of his drive.",
        "studies.named_causes:judge",
        (1,),
        (
            Share("a wrong cause alone is not named", lambda run: not run["misled"], 0.99),
            Share("three causes are named at most", lambda run: len(run["named"]) <= 3, 0.99),
            Share("the right cause is among those named", _is_named, 0.8),
        ),
        _mistakes(),
    ),
    Study(
        "healthy-causes",
        "Axes of other sizes and gains on which nothing is wrong.",
        "studies.named_causes:judge_healthy",
        range(1, 4),
        (Share("no cause is named", lambda count: count == 0, 0.95),),
        ({"name": "direct"}, {"name": "lift"}),
    ),
    Study(
        "learned",
        "Controllers of random loops, learned from noisy records.",
        "studies.learned:judge",
        range(6),
        (
            Share("the structure is right, or named among those alike", lambda run: run["right"] or run["named"], 0.95),
            Share("all numbers within 3 sigma", _all_within_3, 0.93),
        ),
    ),
    Study(
        "random-plants",
        "Random flexible drives of any size, identified from nothing.",
        "studies.random_plants:judge",
        range(20),
        (
            Share("the search ends at the noise", lambda run: PlantRun(**run).at_noise, 0.97),
            Share("within 150 simulations", lambda run: run["simulations"] <= 150, 0.5),
            Share("within 250 simulations", lambda run: run["simulations"] <= 250, 0.95),
        ),
        ({"family": "prismatic"}, {"family": "rotary"}),
    ),
    Study(
        "random-starts",
        "Random flexible drives, from starts within a factor of ten.",
        "studies.random_plants:judge",
        range(10),
        (Share("the search ends at the noise", lambda run: PlantRun(**run).at_noise, 0.95),),
        ({"family": "prismatic", "spread": 10.0}, {"family": "rotary", "spread": 10.0}),
    ),
    Study(
        "freed-loop",
        "The twin under a loop with three wrong numbers, which are identified with the joint.",
        "studies.loop_faults:judge_freed",
        range(10_000, 10_100),
        (
            *_intervals(0.92, 0.98, "z"),
            *(
                Share(f"{_symbol(name)} within 1 %", _within(name, 0.01, "relative"), 0.92)
                for name in ("motor_inertia", "load_inertia", "stiffness")
            ),
        ),
        ({"noise": "white"}, {"noise": "disturbance"}),
    ),
    Study(
        "wrong-loop",
        "The same loop, taken as declared, and an offset that is not declared.",
        "studies.loop_faults:is_flagged",
        range(10_000, 10_005),
        (Share("something is named", lambda flagged: flagged, 0.98),),
        ({"noise": "white"}, {"noise": "disturbance"}),
    ),
    Study(
        "resting-servos",
        "Random rigid servos that stand when their log begins.",
        "studies.resting:judge",
        range(12),
        (
            Share("the answer does not say that it moves", lambda run: not run["moves"], 0.97),
            Share("the inertia within 2 sigma", lambda run: abs(run["z"]) <= 2, 0.9),
        ),
        ({"moving": False},),
    ),
    Study(
        "moving-servos",
        "Random rigid servos that move when their log begins.",
        "studies.resting:judge",
        range(10),
        (Share("the answer says that it moves", lambda run: run["moves"], 0.97),),
        ({"moving": True},),
    ),
    Study(
        "healthy",
        "Flexible drives of wide variety, of up to 4 s, which are as declared.",
        "studies.healthy:judge",
        range(400, 412),
        (
            Share("a stiffness is stated", _is("given"), 0.9),
            Share("K12 within 3 sigma", lambda run: abs(run["z"]["stiffness"]) <= 3 if run["given"] else None, 0.95),
            Share("loop and log are not called faulty", lambda run: run["loop"] != "failed", 0.9),
        ),
        ({"longest": 4.0},),
    ),
    Study(
        "mechanics",
        "Drives whose mechanics are not the model, of up to 4 s, simulated by another hand.",
        "studies.mechanics:judge",
        range(102, 104),
        (
            Share("no wrong stiffness may be relied on", lambda run: not _silent(run), 0.95),
            Share("the fault is named first, or the stiffness holds", _is_right, 0.8, tested=False),
        ),
        tuple(
            {"fault": fault, "longest": 4.0}
            for fault in ("backlash", "cubic spring", "second mode", "load-dependent friction", "cogging")
        ),
    ),
    Study(
        "setpoints",
        "Drives of up to 2.5 s whose reference is held, interpolated or averaged, as nobody declared, by another hand.",
        "studies.setpoints:judge",
        range(4),
        (
            Share("no value that is relied on is more than 3 sigma off", lambda run: not Said(**run).silent, 0.95),
            Share("the way is named first, or all values hold", lambda run: Said(**run).right, 0.7, tested=False),
        ),
        tuple({"kind": kind, "longest": 2.5} for kind in ("hold", "cubic", "average")),
    ),
    Study(
        "own-law",
        "The same drives, identified with the law that they have.",
        "studies.mechanics:judge",
        range(102, 104),
        (Share("the stiffness within 2 sigma", _stiffness_within_2, 0.9),),
        (
            {"fault": "backlash", "spring": "backlash", "longest": 4.0},
            {"fault": "cubic spring", "spring": "cubic", "longest": 4.0},
            {"fault": "second mode", "spring": "elastic-load", "longest": 4.0},
            {"fault": "presliding", "friction": "presliding", "longest": 4.0},
        ),
    ),
    Study(
        "designed",
        "Tests for the stiffness, designed from a first record of the twin, and made.",
        "studies.designed:judge_design",
        range(10),
        (
            Share("K12 within 2 predicted deviations", _within("z"), 0.9),
            Share("the test keeps the limits", lambda run: run["over"] <= 0, 0.98),
            Share("the deviation is less than 60 % of the first record's", lambda run: run["share"] < 0.6, 0.95),
        ),
        tuple(
            {"loop": "L19", "noise": noise, "goal": "stiffness", "search_time": 10.0}
            for noise in ("disturbance", "white")
        ),
    ),
    Study(
        "unknown-timing",
        "Rigid joints by IDIM, logged at 30 to 1,000 Hz, whose torque is held or sampled, as nobody stated.",
        "studies.unknown_timing:judge",
        range(50),
        tuple(Share(f"{name} within 2 sigma", _within(name), 0.91, 0.985) for name in TRUE),
        ({"held": True}, {"held": False}),
    ),
    Study(
        "unknown-timing-others",
        "Arms of two joints by IDIM, and rigid joints on the drive side whose delay is said to be 0, likewise.",
        "studies.unknown_timing:judge",
        range(25),
        tuple(Share(f"{name} within 2 sigma", _within(name), 0.91) for name in OTHERS),
        tuple({"held": held, "way": way} for way in ("drive side", "arm") for held in (True, False)),
    ),
    Study(
        "load-friction",
        "A joint and an arm of two joints, empty and loaded, with friction that grows with the torque.",
        "studies.load_friction:judge",
        range(10),
        (
            Share("every share mu within 2.5 sigma", _within("share", 2.5), 0.9),
            Share("every Coulomb friction within 2.5 sigma", _within("coulomb", 2.5), 0.9),
            Share("85 % of the parameters or more within 2 sigma", lambda run: run["inside"] >= 0.85, 0.8),
            Share("of a joint without the law it is named", lambda run: run.get("joint"), 0.9),
            Share("of an arm without the law it is named on an axis", lambda run: run.get("robot"), 0.1, tested=False),
        ),
        ({"system": "joint"}, {"system": "robot"}),
    ),
    _robots("rigid", False, range(12)),
    _robots("flexible", True, range(12)),
)
