"""Mistakes in tables of rims and craters are named: the rims agree once they are undone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import axes_of_chart, chart_of_axes
from craternav_fg.estimators.base import Problem
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.pipeline.rim_mistakes import likely_rim_mistake
from craternav_fg.simulation.scenario import simulate
from factors.arrays import FloatArray
from tests.descents import scenario

QUARTER = np.array([0.0, 0.0, 0.0, 0.0, np.pi / 2])


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.open(simulate(scenario(duration_s=20.0), tmp_path_factory.mktemp("few") / "d"))


def with_ellipses(data: Dataset, change: Callable[[FloatArray], FloatArray]) -> Dataset:
    """Change rows of x, y, a, b, angle."""
    assert data.measurements is not None
    frames = [
        replace(one, rims=replace(one.rims, chart=chart_of_axes(change(axes_of_chart(one.rims.chart)))))
        for one in data.measurements
    ]
    return replace(data, measurements=tuple(frames))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda e: e * [1, 1, 1, 1, -1], "the angles of the ellipses are counted from x away from y"),
        (lambda e: np.add(e, QUARTER), "the angles of the ellipses are those of their minor axes"),
        (lambda e: e * [1, 1, 2, 2, 1], "the ellipses have diameters for semi-axes"),
        (lambda e: e * [1, -1, 1, 1, -1], "y of the image is upwards"),
        (
            lambda e: e[:, [1, 0, 2, 3, 4]] * [1, 1, 1, 1, -1] + [0, 0, 0, 0, np.pi / 2],
            "x and y of the image",
        ),
    ],
)
def test_a_mistake_in_the_ellipses_is_named(
    data: Dataset, change: Callable[[FloatArray], FloatArray], said: str
) -> None:
    (told,) = (w for w in reconstruct(with_ellipses(data, change), ["ekf"]).warnings if "most rims" in w)
    assert f"the likely cause, as they agree once it is undone: {said}" in told


def test_a_mistake_in_the_catalogue_is_named_and_an_unknown_one_is_not(data: Dataset) -> None:
    sound = reconstruct(data, ["dead_reckoning"]).problems[0]

    def likely(**change: FloatArray) -> str:
        problem: Problem = replace(sound, catalog=replace(sound.catalog, **change))
        return likely_rim_mistake(problem)

    catalog = sound.catalog
    assert likely(semi_major_m=catalog.semi_major_m / 2, semi_minor_m=catalog.semi_minor_m / 2) == (
        "the catalogue has radii for diameters"
    )
    assert likely(angle_rad=np.pi / 2 - catalog.angle_rad) == (
        "DIAM_ELLI_ANGLE_IMG is counted from north towards east"
    )
    west = "the catalogue's longitudes are positive west"
    assert likely(longitude_rad=2.0 * np.pi - catalog.longitude_rad) == west
    assert likely(latitude_rad=-catalog.latitude_rad) == "the catalogue's latitudes are positive south"
    assert likely(angle_rad=catalog.angle_rad + 0.7) == ""
    assert likely() == ""
