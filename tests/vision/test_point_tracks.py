"""Points tracked through rendered images: where they are, how long they last, what they tell."""

from dataclasses import replace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.dataset import Dataset
from craternav_fg.ellipse import points_on
from craternav_fg.estimators.point_features import linearise_points, lines_of_sight, triangulated
from craternav_fg.measurements import FrameMeasurement, RimSet
from craternav_fg.pipeline.reconstruct import reconstruct
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.guided_options import GuidedOptions
from craternav_fg.vision.point_tracks import GroundMotion, PointTrackOptions, track_points

OPTIONS = PointTrackOptions(count=60)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Eight images of 512 x 512 px from 12 km on."""
    case = load_scenario("lunar_descent")
    camera = case.camera.model_copy(update={"width_px": 512, "height_px": 512})
    trajectory = case.trajectory.model_copy(
        update={
            "duration_s": 28.0,
            "start": case.trajectory.start.model_copy(
                update={"altitude_m": 12e3, "downrange_m": -4e3, "ground_speed_m_s": 180.0}
            ),
            "end": case.trajectory.end.model_copy(update={"altitude_m": 9e3, "ground_speed_m_s": 100.0}),
        }
    )
    case = case.model_copy(update={"camera": camera, "trajectory": trajectory})
    return Dataset.open(simulate(case, tmp_path_factory.mktemp("d") / "data"))


def bare(data: Dataset) -> list[FrameMeasurement]:
    return [FrameMeasurement(stamp, RimSet.empty(), None) for stamp in data.stamps_ns.tolist()]


def images(data: Dataset) -> list[np.ndarray]:
    return [data.image(k) for k in range(len(data))]


def test_tracks_are_of_fixed_ground_points_within_the_stated_noise(data: Dataset) -> None:
    tracks = track_points(images(data), bare(data), data.camera, OPTIONS)
    assert data.truth is not None
    sigma = OPTIONS.sigma_px / data.camera.focal_px
    rows = np.searchsorted(data.stamps_ns, tracks.stamps_ns)
    assert (np.bincount(rows, minlength=len(data)) > 0.5 * OPTIONS.count).all()
    squares, lengths = [], []
    for track in np.unique(tracks.tracks):
        mine = np.flatnonzero(tracks.tracks == track)
        lengths.append(len(mine))
        gTb = data.truth.gTb[rows[mine]]
        u = data.camera.normalised(tracks.points_px[mine])
        gTc = data.camera.gTc(gTb)
        point = triangulated(gTc[:, :3, 3], lines_of_sight(u, gTc), sigma)
        if point is None or len(mine) < 4:
            continue
        residual, of_point, _ = linearise_points(np.tile(point, (len(u), 1)), gTb, u, data.camera, sigma)
        null = np.linalg.qr(of_point.reshape(-1, 3), mode="complete")[0][:, 3:]
        squares.append(np.mean((null.T @ residual.ravel()) ** 2))
    assert np.median(lengths) >= 4
    assert len(squares) > 30
    # A few are of shadows' edges or of slopes whose look changes.
    assert np.median(squares) < 1.0
    assert np.mean(np.array(squares) > 4.0) < 0.2


def test_tracks_end_in_time_and_keep_away_from_rims(data: Dataset) -> None:
    chart = np.array([[0.0, 0.0, *np.log([0.1, 0.1]), 0.0]])
    short = replace(OPTIONS, longest_frames=3)
    frame = bare(data)[0]
    covariance = 1e-6 * np.eye(5)[None]
    seen = FrameMeasurement(frame.stamp_ns, RimSet(np.array([0]), chart, covariance), None)
    tracks = track_points(images(data), [seen, *bare(data)[1:]], data.camera, short)
    assert np.bincount(tracks.tracks).max() <= 3
    first = tracks.at(frame.stamp_ns)[1]
    outline = data.camera.pixels(points_on(seen.rims.chart, 200)[0])
    away = np.linalg.norm(first[:, None] - outline[None], axis=2).min(axis=1)
    assert away.min() > 0.9 * OPTIONS.distance_px


def test_an_image_of_noise_gives_no_long_track(data: Dataset) -> None:
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 255, (512, 512), dtype=np.uint8) for _ in range(5)]
    tracks = track_points(noise, bare(data)[:5], data.camera, OPTIONS)
    # Of five times sixty.
    assert len(tracks.tracks) < 30


def test_reconstruction_uses_them_when_asked_to(data: Dataset) -> None:
    result = reconstruct(data, ["online"], front_end=GuidedOptions(points=OPTIONS))
    assert result.problems[0].features is not None
    assert data.truth is not None
    found = result.trajectories["online"]
    assert found.pose_covariance is not None
    away = np.linalg.norm(found.gP[-1] - data.truth.gP[-1])
    assert away < 4.0 * np.sqrt(np.trace(found.pose_covariance[-1, 3:, 3:]))
    assert result.options["front_end"]["points"]["count"] == OPTIONS.count


def test_rough_poses_lead_to_points_that_have_moved_far(data: Dataset) -> None:
    """Two images 12 s apart: the ground moves by a fifth of the image, and the poses are 100 m wrong."""
    assert data.truth is not None
    ends = [0, 3]
    pair = [data.image(k) for k in ends], [bare(data)[k] for k in ends]
    gTb = data.truth.gTb[ends].copy()
    gTb[1, :3, 3] += 100.0 * frames.up(np.array(0.3), np.array(1.0))
    options = replace(OPTIONS, levels=1)
    motion = GroundMotion(gTb, data.body.radius_m)
    led, lost = (track_points(*pair, data.camera, options, one) for one in (motion, None))
    assert len(led.tracks) >= 10
    assert len(led.tracks) > 2 * len(lost.tracks)
    first, second = (led.at(int(data.stamps_ns[k]))[1] for k in ends)
    expected = GroundMotion(data.truth.gTb[ends], data.body.radius_m).predicted(data.camera, 1, first)
    assert np.median(np.linalg.norm(second - expected, axis=1)) < 6.0
    assert np.median(np.linalg.norm(second - first, axis=1)) > 60.0
