"""Digital twin of the paper's flexible axis, the EMPS of Table 2.

The paper gives the parameters (Tables 2 and 4), the kind of motion (trapezoidal velocity with pulses), the encoder
(100,000 counts) and the remaining error (8 %). Other choices are marked "ours":

- speeds 0.042, 0.083 and 0.125 m/s, acceleration 0.83 m/s2, travel 0.2 m, 24 s (ours);
- pulses of 150 N for 20 ms, about every 0.4 s, added to the motor force (ours);
- offset -3.16 N: not in the paper, found on the real axis;
- loop L19: the gains of the public EMPS benchmark, 18.2 Hz on this mass, no delay;
- loop L30: 30 Hz as the paper says, damping 0.7 and one period of delay (ours);
- the noise: a white force on the motor, inside the loop, by default; or white noise on the log (ours).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib.resources import files
from types import MappingProxyType
from typing import Literal

import numpy as np

from jointid import ClosedLoop, Filtering, FlexibleJoint, Record, excitation, simulated_record
from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.controller import Cascade
from jointid.paper.tables import TABLES

SAMPLE_TIME = 1e-3
DURATION = 24.0
ENCODER_STEP = 5e-8  # m: 100,000 counts on a screw of 5 mm
RESIDUAL = 0.08  # of the filtered, decimated torque
_GAIN = 35.15065188  # N per volt, the drive chain of the EMPS benchmark
_OFFSET = -3.16  # N

TABLE_2 = MappingProxyType({**TABLES[2].values, "offset": _OFFSET})
"""Table 2 of the paper (IDIM, no added mass), with the offset of the real axis."""

TABLE_4 = MappingProxyType({**TABLES[4].values, "offset": _OFFSET})
"""Table 4 of the paper (IDIM, 10 kg added to the load), with the offset of the real axis."""

_L19 = Cascade(
    position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=_GAIN, limit=1e3, undeclared="none"
)

CONTROLLERS = MappingProxyType(
    {
        "L19": _L19,
        "L30": replace(_L19, position_gain=134.7, velocity_gain=27.7e3 / _GAIN, delay=SAMPLE_TIME),
    }
)
"""The two loops: L19 of the public benchmark, L30 as the paper describes its own."""


JOINT_FILE = files("jointid.paper").joinpath("twin.toml").read_text(encoding="utf-8")
"""The joint file that identifies a run of loop L19 from torque alone; `examples/twin/joint.toml` is the same."""


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """One run of the twin.

    Attributes:
        record: torque, reference, both positions and the pulses.
        loop: the flexible joint under its controller.
        truth: the parameters it was simulated with.
        noise: standard deviation in N, at 1 kHz, of the force (or of the log's noise) that was added.
    """

    record: Record
    loop: ClosedLoop
    truth: dict[str, float]
    noise: float


def twin(
    loop: Literal["L19", "L30"] = "L19",
    *,
    added_mass: bool = False,
    noise: Literal["disturbance", "white", "none"] = "disturbance",
    residual: float = RESIDUAL,
    seed: int = 1,
    pulses_seed: int = 0,
    stiffer: float = 1.0,
) -> Twin:
    """Return one seeded run of the digital twin.

    Args:
        loop: which controller.
        added_mass: Table 4 (10 kg on the load) instead of Table 2.
        noise: a white force inside the loop, white noise on the logged torque, or none.
        residual: the noise's share of the torque, both filtered at 60 Hz and decimated: the paper's 8 %.
        seed: of the noise, 0 or more.
        pulses_seed: of the pulses' times, likewise; another one makes another experiment on the same axis.
        stiffer: K12 times this, and F12 times its root: the mode keeps its damping ratio. With the F12 of the table a
            mode of 220 to 300 Hz would be damped by 0.3 % and make loop L19 unstable.

    Raises:
        MethodError: a seed is negative, or `stiffer` is not positive.
    """
    if min(seed, pulses_seed) < 0:
        raise MethodError(f"A seed is a whole number, 0 or more; received {min(seed, pulses_seed)}.")
    if not stiffer > 0:
        raise MethodError(f"A spring is made stiffer by a positive factor; received {stiffer}.")
    truth = dict(TABLE_4 if added_mass else TABLE_2)
    truth |= {"stiffness": stiffer * truth["stiffness"], "damping": math.sqrt(stiffer) * truth["damping"]}
    closed = ClosedLoop(FlexibleJoint("prismatic"), CONTROLLERS[loop])
    reference = excitation.trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, SAMPLE_TIME, duration=DURATION)
    known = excitation.pulses(reference.size, SAMPLE_TIME, height=150.0, width=0.02, every=0.4, seed=pulses_seed)
    white = np.random.default_rng(seed).standard_normal(reference.size)

    def run(disturbance: FloatArray | None = None, torque_noise: FloatArray | None = None) -> Record:
        return simulated_record(
            closed, reference, truth, sample_time=SAMPLE_TIME, injected=known, disturbance=disturbance,
            torque_noise=torque_noise, encoder_step=ENCODER_STEP, name=f"twin {loop}{' +10 kg' * added_mass}",
        )  # fmt: skip

    clean = run()
    if noise == "none":
        return Twin(clean, closed, truth, 0.0)
    target = residual * np.linalg.norm(_filter_torque(_get_torque(clean)))
    if noise == "white":
        sd = float(target / np.linalg.norm(_filter_torque(white)))
        return Twin(run(torque_noise=sd * white), closed, truth, sd)
    # The response to a small force is almost linear: one proportional step, taken at the target size, is enough.
    sd = 1.0
    for _ in range(2):
        response = _get_torque(run(disturbance=sd * white)) - _get_torque(clean)
        sd *= float(target / np.linalg.norm(_filter_torque(response)))
    return Twin(run(disturbance=sd * white), closed, truth, sd)


def _get_torque(record: Record) -> FloatArray:
    assert record.torque is not None
    return record.torque.values


def _filter_torque(torque: FloatArray) -> FloatArray:
    """Filter a torque like the flexible identification: 60 Hz, decimated by six."""
    return Filtering(cutoff=60.0).resolve(SAMPLE_TIME).decimate(torque, SAMPLE_TIME)
