"""What no factor accepts: every field of every factor, spoilt in every way that applies."""

from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X

from factors.conic_shape import conic_shape_factor
from factors.crater_centre import crater_centre_factor
from factors.crater_los import crater_los_factor
from factors.errors import FactorError
from factors.implicit_shape import implicit_shape_factor
from factors.imu import imu_factor, integrate, parameters
from factors.imu_noise import ImuNoise
from factors.rim_points import rim_points_factor
from factors.sun_tilt import sun_tilt_factor
from tests.factors.conftest import make_view, rim_points

VIEW = make_view(0, n=3)
RIMS = {
    "bTc": VIEW.bTc,
    "centres": VIEW.catalog.centres,
    "axes": VIEW.catalog.axes,
    "charts": VIEW.charts,
    "covariances": VIEW.covariances,
}
DENSITIES = {name: np.array(1e-4) for name in ImuNoise.__dataclass_fields__}


def imu(key: int, **arguments: Any) -> gtsam.CombinedImuFactor:
    """IMU factor from an interval of which every field, of the noise too, is given by name."""
    noise = ImuNoise(**{name: arguments.pop(name) for name in DENSITIES})
    params = parameters(noise, arguments.pop("spin"), arguments.pop("gravity"))
    return imu_factor([key, V(0), X(1), V(1), B(0), B(1)], integrate(params, **arguments))


GOOD: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "shape": (conic_shape_factor, RIMS),
    "implicit": (implicit_shape_factor, RIMS),
    "los": (
        crater_los_factor,
        {k: v for k, v in RIMS.items() if k != "axes"}
        | {"normals": VIEW.catalog.normals, "gRc_nominal": (VIEW.gTb @ VIEW.bTc)[:3, :3]},
    ),
    "centre": (
        crater_centre_factor,
        {
            "bTc": VIEW.bTc,
            "centres": VIEW.catalog.centres,
            "points": VIEW.charts[:, :2],
            "covariances": VIEW.covariances[:, :2, :2],
        },
    ),
    "rim": (
        rim_points_factor,
        {
            "bTc": VIEW.bTc,
            "centres": VIEW.catalog.centres,
            "axes": VIEW.catalog.axes,
            "points": np.array([rim_points(VIEW, i, np.arange(6.0)) for i in range(3)]),
            "sigmas": np.full((3, 6), 1e-3),
        },
    ),
    "sun": (
        sun_tilt_factor,
        {
            "bTc": VIEW.bTc,
            "direction": np.ones(3),
            "tilt_rad": np.array(0.3),
            "sigma_rad": np.array(0.1),
            "point": np.zeros(2),
        },
    ),
    "imu": (
        imu,
        {
            **DENSITIES,
            "spin": np.array([0.0, 0.0, 3e-6]),
            "gravity": np.array([0.0, 0.0, -1.6]),
            "dt_s": np.full(3, 0.01),
            "gyro": np.full((3, 3), 0.02),
            "accelerometer": np.full((3, 3), 1.0),
            "bias": np.zeros(6),
        },
    ),
}


def last(value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Spoil the last element."""

    def change(a: np.ndarray) -> np.ndarray:
        out = np.array(a, dtype=float)
        out.flat[-1] = value
        return out

    return change


ANY = {
    "nan": last(np.nan),
    "infinite": last(np.inf),
    "complex": lambda a: a + 1j,
    "words": lambda a: np.asarray(a).astype(str),
    "masked": lambda a: np.ma.masked_array(a, np.ones(np.shape(a), dtype=bool)),
    "a word": lambda a: np.array("crater"),
    "one dimension more": lambda a: np.asarray(a)[None],
    "one column less": lambda a: a[..., :-1] if np.ndim(a) > 0 else np.zeros(0),
}
ROTATION = {
    "scaled": lambda a: a * np.diag([2.0, 2.0, 2.0, 1.0])[: len(a), : len(a)],
    "mirrored": lambda a: a @ np.diag([1.0, 1.0, -1.0, 1.0])[: len(a), : len(a)],
    "zero": lambda a: 0.0 * a,
}
SPECIAL: dict[str, dict[str, Callable[[np.ndarray], np.ndarray]]] = {
    "charts": {
        "wide": lambda a: a + np.array([0, 0, 400, 0, 0]),
        "thin": lambda a: a - np.array([0, 0, 0, 0, 400]),
        "far": lambda a: a + np.array([1e200, 0, 0, 0, 0]),
        "none": lambda a: a[:0],
    },
    "points": {"none": lambda a: a[:0]},
    "bTc": ROTATION,
    "gRc_nominal": ROTATION,
    "axes": {
        "swapped": lambda a: a[:, ::-1],
        "zero": lambda a: 0.0 * a,
        "oblique": lambda a: a + 0.1 * a[:, ::-1],
        "one less": lambda a: a[:-1],
    },
    "covariances": {
        "negative": lambda a: -a,
        "zero": lambda a: 0.0 * a,
        "indefinite": lambda a: a - 1.1 * np.linalg.eigvalsh(a[-1])[0] * np.eye(a.shape[-1]),
        "tiny": lambda a: 1e-305 * a,
        "singular": lambda a: a - np.linalg.eigvalsh(a[-1])[0] * np.eye(a.shape[-1]),
        "of rank 1": lambda a: np.ones_like(a),
        "asymmetric": lambda a: a + 0.1 * np.triu(np.abs(a), 1),
    },
    "normals": {"long": lambda a: 2.0 * a, "zero": lambda a: 0.0 * a},
    "sigmas": {"negative": lambda a: -a, "zero": lambda a: 0.0 * a, "tiny": lambda a: 1e-300 * a},
    "sigma_rad": {"negative": lambda a: -a, "zero": lambda a: 0.0 * a, "tiny": lambda a: 1e-300 * a},
    "direction": {"zero": lambda a: 0.0 * a},
    "dt_s": {"negative": lambda a: -a, "zero": lambda a: 0.0 * a, "empty": lambda a: a[:0]},
    **{name: {"negative": lambda a: -a, "zero": lambda a: 0.0 * a} for name in DENSITIES},
}
CASES = [
    pytest.param(factor, field, change, id=f"{factor}-{field}-{name}")
    for factor, (_, arguments) in GOOD.items()
    for field in arguments
    for name, change in (ANY | SPECIAL.get(field, {})).items()
]


@pytest.mark.parametrize("factor", GOOD)
def test_what_is_good_is_accepted(factor: str) -> None:
    build, arguments = GOOD[factor]
    assert build(X(0), **arguments).dim() > 0


@pytest.mark.parametrize(("factor", "field", "change"), CASES)
def test_spoilt_field_is_refused_by_name(factor: str, field: str, change: Callable) -> None:
    build, arguments = GOOD[factor]
    spoilt = arguments | {field: change(arguments[field])}
    # A field that sets the number of craters may show as another's wrong length.
    with pytest.raises(FactorError, match=r"expected") as caught:
        build(X(0), **spoilt)
    assert ":" in str(caught.value)
    if np.shape(spoilt[field])[:1] == np.shape(arguments[field])[:1]:
        assert str(caught.value).startswith(field)
