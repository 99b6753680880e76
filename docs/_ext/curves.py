"""The curve of docs/how-well-it-works.md over a second mode, as SVG in docs/images.

python docs/_ext/curves.py        writes it again
"""

from __future__ import annotations

import math

import numpy as np
from diagrams import IMAGES, Drawing

from jointid.models.joints import FlexibleJoint
from jointid.models.springs import ElasticLoad

SHARES = (0.1, 0.25, 0.5, 0.75)
"""Parts of the load that swing on the second spring, a line each."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 500, 20, 290  # pixels
_RATIOS, _ERRORS = (1.5, 6.0), (0.3, 50.0)


def second_mode_errors(share: float, load: float = 1.0) -> tuple[list[float], list[float]]:
    """Return ratios of the second resonance to the first, and how much K12 is larger than that of two masses, in %.

    Args:
        share: of the load on the second spring.
        load: inertia of the load, times the motor's.
    """
    joint, found = FlexibleJoint("revolute", spring=ElasticLoad()), []
    values = {"motor_inertia": 1.0, "load_inertia": load, "stiffness": 1.0, "swinging_share": share}
    for stiffness in np.geomspace(100.0, 0.01, 400):  # of the second spring: the ratio falls with it, then rises again
        both = joint.frequencies(values | {"swinging_stiffness": float(stiffness)})
        found.append((both["second_free_free"] / both["free_free"], 100 * share**2 / float(stiffness)))
    least = min(range(len(found)), key=lambda k: found[k][0])
    seen = [one for one in found[: least + 1] if one[0] <= _RATIOS[1] and _ERRORS[0] <= one[1] <= _ERRORS[1]]
    return [ratio for ratio, _ in seen], [error for _, error in seen]


def second_mode() -> Drawing:
    """Error of the stiffness over the ratio of both modes, a line for each part of the load."""
    d = Drawing("How much stiffer the first spring is than the stiffness that is found", 640, 350)

    def at(ratio: float, error: float) -> tuple[float, float]:
        across = (ratio - _RATIOS[0]) / (_RATIOS[1] - _RATIOS[0])
        up = math.log(error / _ERRORS[0]) / math.log(_ERRORS[1] / _ERRORS[0])
        return round(_LEFT + across * (_RIGHT - _LEFT), 1), round(_BOTTOM - up * (_BOTTOM - _TOP), 1)

    for error in (0.3, 1.0, 3.0, 10.0, 30.0):
        y = at(_RATIOS[0], error)[1]
        d.wire((_LEFT, y), (_RIGHT, y), tip=False, dashed=True)
        d.text(_LEFT - 8, y + 4, f"{error:g} %", anchor="end")
    for ratio in (1.5, 2, 3, 4, 5, 6):
        x = at(ratio, 1.0)[0]
        d.wire((x, _BOTTOM), (x, _BOTTOM + 5), tip=False)
        d.text(x, _BOTTOM + 20, f"{ratio:g}")
    d.wire((_LEFT, _TOP), (_LEFT, _BOTTOM), (_RIGHT, _BOTTOM), tip=False)
    d.text((_LEFT + _RIGHT) / 2, _BOTTOM + 44, "second resonance, times the first")
    for share in SHARES:
        points = [at(*one) for one in zip(*second_mode_errors(share), strict=True)]
        d.wire(*points, tip=False)
        d.text(_RIGHT + 8, points[0][1] + 4, f"{100 * share:g} % of the load", anchor="start")
    return d


CURVES = {"second-mode": second_mode}
"""By the name of the file, what draws it."""


if __name__ == "__main__":
    for name, draw in CURVES.items():
        (IMAGES / f"{name}.svg").write_text(draw().svg(), encoding="utf-8")
