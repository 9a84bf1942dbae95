"""Rims of georeferenced images on the ground, against closed forms."""

import numpy as np
import pytest
import rasterio

from craternav_fg import frames
from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.image_projection import ground_rims, read_projection
from craternav_fg.catalogs.map_projection import directions_of, frame_of, plane_of
from craternav_fg.ellipse import chart_of_axes

MOON_M = 1_737_400.0


def image(path, crs, step, corner, size=(40, 60)):
    """Write an empty image."""
    transform = rasterio.Affine(step, 0.0, corner[0], 0.0, -step, corner[1])
    with rasterio.open(
        path, "w", driver="GTiff", height=size[0], width=size[1], count=1, dtype="uint8", crs=crs,
        transform=transform,
    ) as raster:  # fmt: skip
        raster.write(np.zeros((1, *size), np.uint8))
    return path


@pytest.mark.parametrize(
    ("crs", "step", "corner", "unit_m"),
    [
        ("+proj=stere +lat_0=-90 +lon_0=20 +k=1 +R=1737400 +units=m", 300.0, (2e5, 3e5), 1.0),
        ("+proj=stere +lat_0=90 +lon_0=0 +k=1 +R=1737400 +units=km", 0.3, (-2e2, 3e2), 1000.0),
        ("+proj=eqc +lat_ts=40 +lon_0=180 +R=1737400 +units=m", 300.0, (-2e5, 1.3e6), 1.0),
    ],
)
def test_pixels_lie_where_the_closed_forms_put_them(tmp_path, crs, step, corner, unit_m):
    projection = read_projection(image(tmp_path / "a.tif", crs, step, corner), None)
    parameters = rasterio.crs.CRS.from_string(crs).to_dict()
    plane = plane_of(parameters, MOON_M, unit_m)
    first = (corner[0] + 0.5 * step, corner[1] - 0.5 * step)
    frame = frame_of(plane, first, (step, -step), 60)
    xy = np.random.default_rng(0).uniform(0.0, 40.0, (50, 2))
    expected = MOON_M * directions_of(frame, xy[:, 0], xy[:, 1])
    np.testing.assert_allclose(projection.ground(xy), expected, atol=1e-3)
    assert projection.body.name == "Moon"


def test_latitudes_of_a_flattened_body_are_planetocentric(tmp_path):
    """Mars: a planetographic latitude of 45 deg is a planetocentric one of 44.66 deg."""
    crs = "+proj=longlat +a=3396190 +b=3376200 +no_defs"
    projection = read_projection(image(tmp_path / "a.tif", crs, 0.01, (10.0, 45.005)), None)
    latitude, longitude = frames.latitude_longitude(projection.ground(np.zeros((1, 2))))
    np.testing.assert_allclose(np.degrees(longitude), 10.005, atol=1e-9)
    np.testing.assert_allclose(np.degrees(latitude), 44.6617, atol=1e-4)
    assert projection.body.name == "Mars"


def test_an_ellipse_of_the_map_is_a_circle_on_the_ground(tmp_path):
    """At 60 deg a degree of longitude is half as long as one of latitude."""
    crs = "+proj=longlat +R=1737400 +no_defs"
    projection = read_projection(image(tmp_path / "a.tif", crs, 0.001, (30.0, 60.0), (1000, 1000)), None)
    step_m = MOON_M * np.radians(0.001)
    # The middle of pixel (500, 0) is at 30.5005 E, 59.9995 N.
    chart = chart_of_axes(np.array([[500.0, 0.0, 20.0, 10.0, 0.0]]))
    covariance = np.diag([0.2, 0.1, 0.02, 0.03, 0.01])[None] ** 2
    found = ground_rims(projection, chart, covariance, "map")
    catalog = found.catalog
    np.testing.assert_allclose(np.degrees(catalog.longitude_rad), 30.5005, atol=1e-6)
    np.testing.assert_allclose(np.degrees(catalog.latitude_rad), 59.9995, atol=2e-6)
    np.testing.assert_allclose([catalog.semi_major_m[0], catalog.semi_minor_m[0]], 10.0 * step_m, rtol=1e-3)
    sigma = np.sqrt(np.diag(found.covariance[0]))
    np.testing.assert_allclose(sigma[:2], [0.1 * step_m, 0.1 * step_m], rtol=1e-3)
    np.testing.assert_allclose(sigma[[2, 4]], [0.02, 0.01], rtol=2e-2)
    np.testing.assert_allclose(catalog.errors.place_m, 0.1 * step_m, rtol=1e-3)
    np.testing.assert_allclose(catalog.errors.size_share, np.sqrt(0.5 * (0.02**2 + 0.01**2)), rtol=2e-2)
    assert catalog.identifiers == ("map_000001",)


def test_longitude_and_latitude_of_the_earth_are_those_of_the_named_body(tmp_path):
    path = image(tmp_path / "a.tif", "EPSG:4326", 0.01, (10.0, 20.0))
    projection = read_projection(path, named_body("Ceres"))
    np.testing.assert_allclose(np.linalg.norm(projection.ground(np.zeros((3, 2))), axis=1), 470e3)
    assert read_projection(image(tmp_path / "b.tif", None, 1.5, (0.0, 0.0)), None) is None


def test_rims_beyond_the_projection_are_left_out(tmp_path):
    crs = "+proj=ortho +lat_0=0 +lon_0=0 +R=1737400 +units=m"
    projection = read_projection(image(tmp_path / "a.tif", crs, 1e4, (-2e6, 2e6), (400, 400)), None)
    chart = chart_of_axes(np.array([[200.0, 200.0, 5.0, 5.0, 0.0], [2.0, 200.0, 5.0, 5.0, 0.0]]))
    found = ground_rims(projection, chart, np.tile(1e-4 * np.eye(5), (2, 1, 1)), "map")
    assert found.rows.tolist() == [True, False]
    assert len(found.catalog) == 1
