"""Nonlinear regressions with certified values, of the Statistical Reference Datasets of NIST.

Data, starts, parameters and residual sums of squares are those of https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml,
where the certified values are given to 11 digits. The first start is far away, the second near.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jointid.common.parameters import Parameter, Quantity

Array = np.ndarray
Model = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Certified:
    """A regression of y on x.

    Attributes:
        name: at NIST.
        model: parameters and x in, the prediction, (rows,), and its derivatives, (rows, parameters), out.
        x, y: the data.
        starts: far and near.
        values: certified.
        square: certified residual sum of squares.
    """

    name: str
    model: Model
    x: Array
    y: Array
    starts: tuple[tuple[float, ...], tuple[float, ...]]
    values: tuple[float, ...]
    square: float

    @property
    def free(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"b{i + 1}", f"b{i + 1}", Quantity.RATIO) for i in range(len(self.values)))

    def linearise(self, b: Array) -> tuple[Array, Array]:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            predicted, slopes = self.model(b, self.x)
        if not (np.all(np.isfinite(predicted)) and np.all(np.isfinite(slopes))):
            return np.full(self.y.size, 1e6 * np.max(np.abs(self.y))), np.zeros_like(slopes)
        return self.y - predicted, -slopes

    def digits(self, b: Array) -> float:
        """Return how many digits of the worst parameter are those certified, at most the 11 that there are."""
        values = np.array(self.values)
        off = float(np.max(np.abs(b - values) / np.abs(values)))
        return min(11.0, -np.log10(max(off, 1e-300)))


def _columns(*columns: Array) -> Array:
    return np.column_stack(columns)


def _misra1a(b: Array, x: Array) -> tuple[Array, Array]:
    decay = np.exp(-b[1] * x)
    return b[0] * (1 - decay), _columns(1 - decay, b[0] * x * decay)


def _lanczos(b: Array, x: Array) -> tuple[Array, Array]:
    decays = [np.exp(-b[i] * x) for i in (1, 3, 5)]
    slopes = [part for i, decay in zip((0, 2, 4), decays, strict=True) for part in (decay, -b[i] * x * decay)]
    return sum(b[i] * decay for i, decay in zip((0, 2, 4), decays, strict=True)), _columns(*slopes)


def _rat42(b: Array, x: Array) -> tuple[Array, Array]:
    growth = np.exp(b[1] - b[2] * x)
    slope = b[0] * growth / (1 + growth) ** 2
    return b[0] / (1 + growth), _columns(1 / (1 + growth), -slope, x * slope)


def _mgh09(b: Array, x: Array) -> tuple[Array, Array]:
    top, below = x * x + x * b[1], x * x + x * b[2] + b[3]
    by = b[0] * top / below**2
    return b[0] * top / below, _columns(top / below, b[0] * x / below, -x * by, -by)


def _thurber(b: Array, x: Array) -> tuple[Array, Array]:
    powers = _columns(np.ones_like(x), x, x**2, x**3)
    below = 1 + powers[:, 1:] @ b[4:]
    found = powers @ b[:4] / below
    return found, np.hstack([powers / below[:, np.newaxis], -(found / below)[:, np.newaxis] * powers[:, 1:]])


_MISRA_X = (77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0)
_MISRA_Y = (10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78)
_LANCZOS_Y = (
    2.5134, 2.0443, 1.6684, 1.3664, 1.1232, 0.9269, 0.7679, 0.6389, 0.5338, 0.4479, 0.3776, 0.3197,
    0.2720, 0.2325, 0.1997, 0.1723, 0.1493, 0.1301, 0.1138, 0.1000, 0.0883, 0.0783, 0.0698, 0.0624,
)  # fmt: skip
_THURBER_X = (
    -3.067, -2.981, -2.921, -2.912, -2.840, -2.797, -2.702, -2.699, -2.633, -2.481, -2.363, -2.322, -1.501, -1.460,
    -1.274, -1.212, -1.100, -1.046, -0.915, -0.714, -0.566, -0.545, -0.400, -0.309, -0.109, -0.103, 0.010, 0.119,
    0.377, 0.790, 0.963, 1.006, 1.115, 1.572, 1.841, 2.047, 2.200,
)  # fmt: skip
_THURBER_Y = (
    80.574, 84.248, 87.264, 87.195, 89.076, 89.608, 89.868, 90.101, 92.405, 95.854, 100.696, 101.060, 401.672, 390.724,
    567.534, 635.316, 733.054, 759.087, 894.206, 990.785, 1090.109, 1080.914, 1122.643, 1178.351, 1260.531, 1273.514,
    1288.339, 1327.543, 1353.863, 1414.509, 1425.208, 1421.384, 1442.962, 1464.350, 1468.705, 1447.894, 1457.628,
)  # fmt: skip

REGRESSIONS = (
    Certified(
        "Misra1a", _misra1a, np.array(_MISRA_X), np.array(_MISRA_Y), ((500.0, 1e-4), (250.0, 5e-4)),
        (2.3894212918e02, 5.5015643181e-04), 1.2455138894e-01,
    ),
    Certified(
        "Lanczos3", _lanczos, 0.05 * np.arange(24), np.array(_LANCZOS_Y),
        ((1.2, 0.3, 5.6, 5.5, 6.5, 7.6), (0.5, 0.7, 3.6, 4.2, 4.0, 6.3)),
        (8.6816414977e-02, 9.5498101505e-01, 8.4400777463e-01, 2.9515951832e00, 1.5825685901e00, 4.9863565084e00),
        1.6117193594e-08,
    ),
    Certified(
        "Rat42", _rat42, np.array([9.0, 14.0, 21.0, 28.0, 42.0, 57.0, 63.0, 70.0, 79.0]),
        np.array([8.930, 10.800, 18.590, 22.330, 39.350, 56.110, 61.730, 64.620, 67.080]),
        ((100.0, 1.0, 0.1), (75.0, 2.5, 0.07)),
        (7.2462237576e01, 2.6180768402e00, 6.7359200066e-02), 8.0565229338e00,
    ),
    Certified(
        "BoxBOD", _misra1a, np.array([1.0, 2.0, 3.0, 5.0, 7.0, 10.0]),
        np.array([109.0, 149.0, 149.0, 191.0, 213.0, 224.0]), ((1.0, 1.0), (100.0, 0.75)),
        (2.1380940889e02, 5.4723748542e-01), 1.1680088766e03,
    ),
    Certified(
        "MGH09", _mgh09, np.array([4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]),
        np.array([0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]),
        ((25.0, 39.0, 41.5, 39.0), (0.25, 0.39, 0.415, 0.39)),
        (1.9280693458e-01, 1.9128232873e-01, 1.2305650693e-01, 1.3606233068e-01), 3.0750560385e-04,
    ),
    Certified(
        "Thurber", _thurber, np.array(_THURBER_X), np.array(_THURBER_Y),
        ((1000.0, 1000.0, 400.0, 40.0, 0.7, 0.3, 0.03), (1300.0, 1500.0, 500.0, 75.0, 1.0, 0.4, 0.05)),
        (1.2881396800e03, 1.4910792535e03, 5.8323836877e02, 7.5416644291e01, 9.6629502864e-01, 3.9797285797e-01,
         4.9727297349e-02), 5.6427082397e03,
    ),
)  # fmt: skip
