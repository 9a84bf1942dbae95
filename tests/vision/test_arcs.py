"""Rims that the image's border cuts: measured as points along the part that is seen."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from craternav_fg.catalogs.map_errors import MapErrors
from craternav_fg.estimators.base import Descent
from craternav_fg.estimators.graph import FactorGraph, GraphOptions, add_frame
from craternav_fg.estimators.optimise import levenberg_marquardt
from craternav_fg.imu import ImuLog, ImuNoise
from craternav_fg.measurements import ArcSet
from craternav_fg.trajectory import InitialState
from craternav_fg.vision.error_model.correlated import (
    CorrelatedErrorOptions,
    correlated_roots,
    shared_of_arcs,
)
from craternav_fg.vision.error_model.systematic import RimErrors
from craternav_fg.vision.guided import GuidedFrontEnd
from factors.kernels.conic import project_rims
from tests.vision import scene


@pytest.fixture(scope="module")
def frames():
    """Craters up to and beyond the border: true poses and what the front end gives, several images."""
    out = []
    for seed in range(4):
        rng = np.random.default_rng(20 + seed)
        catalog = scene.craters(rng, 26, 14.0, 40.0, half=0.48)
        gTb, sun_g = scene.pose(rng.uniform(0.0, 6.0)), scene.sun(rng.uniform(20.0, 50.0))
        image = scene.render(catalog, gTb, sun_g, rng)
        front_end = GuidedFrontEnd(scene.camera(), catalog)
        out.append((catalog, gTb, front_end.measure(image, 0, gTb, scene.covariance(0.5), sun_g)))
    return out


def distances_px(points, chart):
    """Distances of normalised points to the rim of a chart, px, by a fine polygon."""
    t = np.linspace(0.0, 2.0 * np.pi, 4000)
    x = chart[0] + np.exp(chart[2]) * np.cos(t)
    y = chart[1] + chart[3] * np.exp(chart[2]) * np.cos(t) + np.exp(chart[4]) * np.sin(t)
    step = points[:, None] - np.stack([x, y], axis=-1)
    nearest = np.argmin(np.sum(step**2, axis=-1), axis=1)
    off = step[np.arange(len(points)), nearest]
    outward = np.sum(off * (np.stack([x, y], axis=-1)[nearest] - chart[:2]), axis=1)
    return np.sign(outward) * np.linalg.norm(off, axis=1) * scene.camera().focal_px


def test_cut_rims_are_arcs_that_lie_on_their_rims(frames):
    whitened, covered = [], 0
    for catalog, gTb, frame in frames:
        # In a single frame the whole error that the points share counts.
        arcs = frame.arcs.inflate_correlated(1.0)
        assert len(np.intersect1d(arcs.craters, frame.rims.craters)) == 0
        truth = project_rims(gTb, np.eye(4), catalog.centres[arcs.craters], catalog.axes[arcs.craters])[0]
        for points, sigmas, chart in zip(arcs.points, arcs.sigmas, truth, strict=True):
            pixels = scene.camera().pixels(points)
            assert np.all((pixels > 0.0) & (pixels < scene.SIZE_PX - 1.0))
            sigma_px = sigmas * scene.camera().focal_px
            off = distances_px(points, chart)
            assert np.max(np.abs(off)) < 2.5
            assert abs(np.mean(off)) < 0.6
            weight = sigma_px**-2
            whitened.append(weight @ off / np.sqrt(weight.sum()))
            covered += 1
    assert covered >= 12
    # Outward shifts of whole arcs over the standard deviations that their points claim together. Measured
    # over 76 arcs of other images: below 1, as these rims are smoother than the model allows for. Three
    # standard errors of the difference.
    margin = 3.0 * np.sqrt(0.5 / covered + 0.5 / 76)
    assert abs(np.sqrt(np.mean(np.square(whitened))) / 0.375 - 1.0) < margin


def pose_error(catalog, gTb, frame, rows):
    """Whitened and plain position error of the pose from some rims, and the arcs, with a weak prior."""
    some = replace(frame, rims=frame.rims.take(rows), sun=None)
    initial = InitialState(0, gTb, np.zeros(3), 0.01, 300.0, 1.0, 0.01, 1e-6, 1e-3)
    imu = ImuLog(np.arange(2), np.zeros((2, 3)), np.zeros((2, 3)))
    descent = Descent(scene.MOON, scene.camera(), catalog, imu, ImuNoise(1e-5, 1e-4, 1e-8, 1e-7), initial)
    graph = FactorGraph()
    sigmas = np.repeat([0.01, 300.0], 3)
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(gTb), gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    add_frame(graph, descent, GraphOptions(variance_inflation=1.0), X(0), some)
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(gTb))
    result = levenberg_marquardt(graph, values).values
    covariance = np.linalg.inv(graph.linearize(result).hessian()[0])
    error = gtsam.Pose3(gTb).localCoordinates(result.atPose3(X(0)))
    return float(error @ np.linalg.solve(covariance, error)), np.linalg.norm(error[3:]), covariance


def test_arcs_help_and_are_consistent(frames):
    """Beside two whole rims."""
    distance2, errors, smaller = [], [], []
    for catalog, gTb, frame in frames:
        rows = np.argsort(frame.rims.craters)[:2]
        without = pose_error(catalog, gTb, replace(frame, arcs=ArcSet.empty()), rows)
        helped = pose_error(catalog, gTb, frame, rows)
        distance2.append(helped[0])
        errors.append((without[1], helped[1]))
        smaller.append(np.trace(helped[2][3:, 3:]) / np.trace(without[2][3:, 3:]))
    assert np.max(smaller) < 0.7
    before, after = np.sqrt(np.mean(np.square(errors), axis=0))
    assert after < 0.6 * before
    assert np.mean(distance2) / 6.0 < 2.0


def test_arcs_share_what_the_rims_beside_them_share(frames):
    """But for the growth, of which they are freed, and the reference brightness."""
    for catalog, gTb, frame in frames:
        rows = np.concatenate([frame.arcs.craters, frame.rims.craters])
        sun_g = scene.sun(35.0)
        camera, options = scene.camera(), CorrelatedErrorOptions()
        shared = shared_of_arcs(rows, gTb, sun_g, camera, catalog, options)
        none = np.zeros((len(rows), 5, 5)) + 1e-9 * np.eye(5)
        errors = RimErrors(none, none, np.full((len(rows), 5), 1e-5))
        of_rims = correlated_roots(errors, rows, gTb, sun_g, camera, catalog, options)[1]
        np.testing.assert_allclose(shared[:, :, :5], of_rims[:, :, :5])
        assert (shared[:, :, 5:] == 0.0).all()
        assert frame.arcs.shared.shape == (len(frame.arcs), 5, 8)
        assert np.abs(frame.arcs.shared[:, :, :5]).max(axis=(1, 2)).min() > 0.0


def test_no_arcs_without_whole_rims_to_tell_the_pose():
    rng = np.random.default_rng(3)
    catalog = scene.craters(rng, 24, half=0.48)
    gTb, sun_g = scene.pose(), scene.sun()
    noise = np.clip(rng.normal(110.0, 3.0, (scene.SIZE_PX, scene.SIZE_PX)), 0, 255).astype(np.uint8)
    out = GuidedFrontEnd(scene.camera(), catalog).measure(noise, 0, gTb, scene.covariance(1.0), sun_g)
    assert len(out.arcs) == 0


def test_the_errors_of_the_map_are_in_the_error_that_the_points_of_an_arc_share(frames):
    """A shift of the rim moves its points across it as far as itself, growth by that share of the radius."""
    rng = np.random.default_rng(20)
    catalog = scene.craters(rng, 26, 14.0, 40.0, half=0.48)
    gTb, sun_g = scene.pose(rng.uniform(0.0, 6.0)), scene.sun(rng.uniform(20.0, 50.0))
    image = scene.render(catalog, gTb, sun_g, rng)
    range_m = np.linalg.norm(gTb[:3, 3] - catalog.centres, axis=1)
    place_px, size = 6.0, 0.1
    place_m = place_px * range_m / scene.camera().focal_px
    none = np.zeros(len(catalog))

    def of_map_px(errors):
        arcs = (
            GuidedFrontEnd(scene.camera(), replace(catalog, errors=errors))
            .measure(image, 0, gTb, scene.covariance(0.5), sun_g)
            .arcs
        )
        both, i, j = np.intersect1d(exact.craters, arcs.craters, return_indices=True)
        assert len(both) >= 3
        variance = arcs.correlated_sigmas[j] ** 2 - exact.correlated_sigmas[i] ** 2
        return both, scene.camera().focal_px * np.sqrt(variance)

    exact = frames[0][2].arcs
    shifted = of_map_px(MapErrors(place_m, none, none))[1]
    np.testing.assert_allclose(shifted, place_px, rtol=0.15)
    craters, grown = of_map_px(MapErrors(none, np.full(len(catalog), size), none))
    radius_px = scene.camera().focal_px * np.linalg.norm(catalog.axes[craters], axis=2).mean(axis=1)
    radius_px /= range_m[craters]
    np.testing.assert_allclose(grown, size * radius_px, rtol=0.25)
