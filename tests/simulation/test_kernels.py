"""The kernels against an independent event-driven oracle, and against physics."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.simulation.kernels import drive as kernels
from tests.simulation.kernel_case import run
from tests.simulation.oracle import Law, Plant, random_case, simulate

NO_LAW = Law(A=np.zeros((0, 0)), Bq=np.zeros(0), Be=np.zeros(0), C=np.zeros(0), D=0.0, limit=np.inf, z0=np.zeros(0))
FLEXIBLE = Plant(
    inertia1=70.2, fv1=(92.0, 92.0), fc1=(10.0, 10.0), offset=-3.16, inertia2=34.8, fv2=(110.0, 110.0),
    fc2=(10.4, 10.4), stiffness=8e5, damping=126.0,
)  # fmt: skip
T = 1e-3


@pytest.mark.parametrize("seed", [*range(12), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(12, 50))])
def test_agrees_with_the_oracle_on_random_joints_loops_and_references(seed: int) -> None:
    plant, law, w, post, period, delay, before, x0 = case = random_case(seed)
    expected = simulate(*case)
    status, u, states, _ = run(plant, law, w, post, period, delay, before, x0)
    assert status == kernels.FINISHED
    assert np.max(np.abs(u - expected.u)) <= 1e-9 * np.max(np.abs(expected.u))
    width = expected.x.shape[1]
    size = np.maximum(np.ptp(expected.x, axis=0), 1e-12)
    assert np.all(np.abs(states[:, :width] - expected.x) <= 1e-8 * size)


@pytest.mark.slow
def test_the_random_cases_cover_the_hard_parts() -> None:
    """The 50 cases above are worth something only if they stick, saturate, and delay by fractions of a period."""
    cases = [random_case(seed) for seed in range(50)]
    fractions = [case[5] / case[4] % 1.0 for case in cases]
    assert sum(1e-3 < fraction < 0.999 for fraction in fractions) >= 10
    assert sum(case[5] > case[4] for case in cases) >= 5
    assert sum(case[0].inertia2 is None for case in cases) >= 8
    assert sum(case[0].fv1[0] != case[0].fv1[1] for case in cases) >= 15
    results = [simulate(*case) for case in cases[:20]]
    assert sum(np.any((r.mode[:, 0] == 0) & (r.mode[:, 1] != 0)) for r in results) >= 3
    assert sum(np.any(np.abs(r.u) == case[1].limit) for r, case in zip(results, cases[:20], strict=True)) >= 3


def test_stands_exactly_still_at_rest() -> None:
    force = np.linspace(-13.0, 6.8, 500)  # within the motor's cone, shifted by the offset of -3.16
    x0 = np.array([0.1234567, 0.0, 0.1234567, 0.0])
    status, _, states, counts = run(FLEXIBLE, NO_LAW, force, np.zeros(500), T, 0.0, force[0], x0)
    assert status == kernels.FINISHED
    assert counts[0] == 0
    assert np.array_equal(states, np.tile(x0, (500, 1)))


def test_comes_loose_beyond_the_cone_and_not_before() -> None:
    plant = Plant(inertia1=2.0, fc1=(5.0, 4.0))
    for force, moves in ((5.0, False), (5.0 + 1e-9, True), (-4.0, False), (-4.0 - 1e-9, True)):
        _, _, states, _ = run(plant, NO_LAW, np.full(20, force), np.zeros(20), T, 0.0, force, np.zeros(4))
        assert bool(np.any(states != 0.0)) is moves


def test_a_mass_sticks_while_the_other_slides() -> None:
    plant = Plant(**{**vars(FLEXIBLE), "fc2": (500.0, 500.0)})
    force = 150.0 * np.sin(2 * np.pi * 5.0 * np.arange(2000) * T)
    _, _, states, counts = run(plant, NO_LAW, force, np.zeros(2000), T, 0.0, 0.0, np.zeros(4))
    assert np.ptp(states[:, 0]) > 1e-4
    assert np.array_equal(states[:, 2:], np.zeros((2000, 2)))
    assert counts[0] >= 15


@pytest.mark.parametrize("seed", range(20))
def test_unforced_energy_never_grows(seed: int) -> None:
    random = np.random.default_rng(seed)
    masses, stiffness = random.uniform(1, 100, 2), 10 ** random.uniform(4, 6)
    plant = Plant(
        inertia1=masses[0], fv1=(1.0, 3.0), fc1=(2.0, 1.0), inertia2=masses[1], fv2=(2.0, 2.0), fc2=(3.0, 3.0),
        stiffness=stiffness, damping=random.uniform(0, 50),
    )  # fmt: skip
    x0 = np.array([0.0, random.normal(), random.normal() * 1e-2, random.normal()])
    _, _, x, _ = run(plant, NO_LAW, np.zeros(4000), np.zeros(4000), T, 0.0, 0.0, x0)
    energy = 0.5 * (masses[0] * x[:, 1] ** 2 + masses[1] * x[:, 3] ** 2 + stiffness * (x[:, 2] - x[:, 0]) ** 2)
    assert np.all(np.diff(energy) <= 1e-12 * energy[0])
    assert energy[-1] < 0.9 * energy[0]


@pytest.mark.parametrize("masses", [1, 2])
def test_anti_windup_acts_while_sliding_and_at_rest(masses: int) -> None:
    """A PI law with back-calculation, saturated both while the joint moves and while friction holds it."""
    plant = FLEXIBLE if masses == 2 else Plant(inertia1=100.0, fv1=(200.0, 150.0), fc1=(20.0, 25.0))
    law = Law(
        A=np.array([[1.0]]), Bq=np.array([-0.2]), Be=np.array([1e-5]), C=np.array([3000.0]), D=-4e4, limit=60.0,
        z0=np.zeros(1),
    )  # fmt: skip
    time = np.arange(900) * T
    w = 4e4 * 0.02 * ((time > 0.05) * 1.0 - (time > 0.45) * 1.0)
    w[:50] = 500.0  # at the limit, and pushed back by what follows
    post = np.zeros(900)
    post[:50] = -55.0  # nothing moves while the law winds up
    case = (plant, law, w, post, T, 0.0, 0.0, np.zeros(2 * masses))
    expected = simulate(*case)
    _, u, _, counts = run(*case)
    assert np.max(np.abs(u - expected.u)) <= 1e-9 * np.max(np.abs(expected.u))
    assert counts[3] > 100
    without = Law(**{**vars(law), "Be": np.zeros(1)})
    _, wound, _, _ = run(plant, without, *case[2:])
    assert np.max(np.abs(wound - u)) > 1.0


def test_an_unstable_loop_returns_a_status_and_finite_numbers() -> None:
    wild = Law(**{**vars(NO_LAW), "D": 1e9})  # positive feedback
    w = np.full(2000, 100.0)
    status, u, states, counts = run(FLEXIBLE, wild, w, np.zeros(2000), T, 0.0, 0.0, np.zeros(4), far=10.0)
    done = int(counts[2])
    assert status == kernels.DIVERGED
    assert done < 100
    assert np.all(np.isfinite(u[:done]))
    assert np.all(np.isfinite(states[:done]))


def test_a_joint_far_too_stiff_returns_a_status_in_bounded_work() -> None:
    force = 200.0 * np.sin(2 * np.pi * 5.0 * np.arange(500) * T)
    x0 = np.array([0.0, 0.1, 0.0, -0.1])
    for stiffness in 10.0 ** np.arange(7, 21):
        plant = Plant(**{**vars(FLEXIBLE), "stiffness": stiffness, "damping": 0.0})
        status, u, _, counts = run(plant, NO_LAW, force, np.zeros(500), T, 0.0, 0.0, x0)
        assert counts[1] <= 20 * 500 + 10_000 + 5_000
        assert np.all(np.isfinite(u[: counts[2]]))
    assert status == kernels.TOO_STIFF
