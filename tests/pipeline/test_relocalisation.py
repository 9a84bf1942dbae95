"""Descents of which no beginning is known, and such as lose track."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from craternav_fg import frames
from craternav_fg.catalogs.files import read_catalog, write_catalog
from craternav_fg.dataset import Dataset, layout
from craternav_fg.ellipse import matrix_of_chart, normalised_chart, pixel_chart
from craternav_fg.errors import EstimationError
from craternav_fg.estimators import filter_state
from craternav_fg.estimators.base import Descent
from craternav_fg.matching.gate import match_rims
from craternav_fg.matching.identify.triple_index import TripleIndex, index_path
from craternav_fg.measurements import RimSet
from craternav_fg.pipeline import relocalisation
from craternav_fg.pipeline.initial_state import find_initial, propagated_back
from craternav_fg.pipeline.reconstruct import _joined, reconstruct
from craternav_fg.pipeline.relocalisation import Relocaliser
from craternav_fg.pipeline.tracking import Tracker
from craternav_fg.simulation.scenario import simulate
from craternav_fg.simulation.scenario_file import load_scenario
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.grey import on_8_bit_scale
from craternav_fg.vision.guided_options import GuidedOptions
from tests.descents import scenario
from tests.shared_data import FOLDER, shared


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    case = scenario(duration_s=40.0)
    return simulate(case, folder / "known"), simulate(case, folder / "lost", with_initial=False)


def final_error_m(data, result, name="smoother"):
    return float(np.linalg.norm(result.trajectories[name].gP[-1] - data.truth.gP[-1]))


def test_measured_rims_without_an_initial_state(folders):
    known, lost = (Dataset.open(folder) for folder in folders)
    assert known.initial is not None
    assert lost.initial is None
    assert "[initial]" not in (folders[1] / "dataset.toml").read_text()
    for a, b in zip(known.measurements, lost.measurements, strict=True):
        np.testing.assert_array_equal(a.rims.chart, b.rims.chart)
    reference, result = (reconstruct(data, ["smoother", "online"]) for data in (known, lost))
    assert (reference.origin, result.origin) == ("given", "found")
    for name in ("smoother", "online"):
        sigma_m = np.sqrt(np.trace(reference.trajectories[name].pose_covariance[-1][3:, 3:]))
        away = result.trajectories[name].gP[-1] - reference.trajectories[name].gP[-1]
        assert np.linalg.norm(away) < sigma_m
        assert final_error_m(lost, result, name) < 4.0 * sigma_m


def detected(lost, monkeypatch):
    """Let the rims of the first frame be what is detected in its image."""
    chart = lost.measurements[0].rims.chart
    charts = pixel_chart(chart, lost.camera.pinhole)
    S = matrix_of_chart(pixel_chart(chart, lost.camera))
    (b, a), turns = np.sqrt(np.linalg.eigvalsh(S)).T, np.linalg.eigh(S)[1][:, :, 1]
    found = SimpleNamespace(
        ellipses_px=np.column_stack([charts[:, :2], a, b, np.arctan2(turns[:, 1], turns[:, 0])]),
        charts_px=charts,
        covariance_px=np.tile(0.01 * np.diag([1.0, 1.0, 1e-4, 1e-4, 1e-4]), (len(charts), 1, 1)),
        traced=np.ones(len(charts), bool),
    )
    monkeypatch.setattr(Relocaliser, "_rims", lambda self, number: found)
    return dataclasses.replace(lost, measurements=None)


def test_identification_among_some_craters(folders, monkeypatch):
    data = detected(Dataset.open(folders[1]), monkeypatch)
    monkeypatch.setattr(Relocaliser, "_image", lambda self, index: None)
    monkeypatch.setattr(relocalisation, "find_rims_network", lambda *_: Relocaliser._rims(None, 0))
    relocaliser, everything = Relocaliser(data), np.arange(len(data.catalog))
    whole = relocaliser.locate(0)
    shown = Dataset.open(folders[1]).measurements[0].rims.craters
    some = relocaliser.locate(0, None, np.union1d(shown, everything[::2]))
    assert some.rims == whole.rims
    np.testing.assert_allclose(some.gTb, whole.gTb, rtol=1e-9)
    assert relocaliser.locate(0, None, np.setdiff1d(everything, shown)) is None
    assert relocaliser.locate(0, None, everything[:0]) is None


def test_the_index_of_a_large_catalogue_is_kept_in_the_cache(folders, tmp_path, monkeypatch):
    lost = Dataset.open(folders[1])
    write_catalog(tmp_path / layout.LARGE_CRATERS, lost.catalog)
    catalog = read_catalog(tmp_path / layout.LARGE_CRATERS, lost.body)
    data = dataclasses.replace(detected(lost, monkeypatch), path=tmp_path, catalog=catalog)
    relocaliser = Relocaliser(data)
    first = relocaliser.locate(0)
    kept = index_path(tmp_path / layout.LARGE_CRATERS)
    assert not kept.is_relative_to(tmp_path)
    assert index_path(tmp_path / "other" / layout.LARGE_CRATERS) != kept
    assert np.linalg.norm(first.gTb[:3, 3] - lost.truth.gP[0]) < 500.0
    assert kept.is_file()
    assert relocaliser.index_note == f"{kept} is built, once for this catalogue"
    monkeypatch.setattr(TripleIndex, "build", lambda catalog: pytest.fail("built again"))
    np.testing.assert_array_equal(Relocaliser(data).locate(0).gTb, first.gTb)


def test_identification_knows_how_well_the_camera_is(folders, monkeypatch):
    lost = Dataset.open(folders[1])
    camera = dataclasses.replace(lost.camera, focal_sigma_percent=2.0, principal_sigma_px=7.0)
    asked = []

    def spy(ellipses_px, camera, index, *, options, traced):
        assert len(traced) == len(ellipses_px)
        asked.append(options)
        return SimpleNamespace(identified=False)

    monkeypatch.setattr(relocalisation, "identify", spy)
    none = SimpleNamespace(ellipses_px=np.empty((0, 5)), traced=np.empty(0, bool))
    for data in (lost, dataclasses.replace(lost, camera=camera)):
        assert Relocaliser(data)._identified(none) is None
    assert (asked[0].focal_sigma_share, asked[0].principal_sigma_px, asked[0].focal_stated) == (
        0.003,
        0.5,
        False,
    )
    assert (asked[1].focal_sigma_share, asked[1].principal_sigma_px, asked[1].focal_stated) == (
        0.02,
        7.0,
        True,
    )


def test_too_few_frames_with_craters(folders):
    lost = Dataset.open(folders[1])
    empty = tuple(
        dataclasses.replace(one, rims=RimSet.empty()) if k != 3 else one
        for k, one in enumerate(lost.measurements)
    )
    with pytest.raises(
        EstimationError, match=r"no initial state, and of .* the craters of 1 were identified"
    ):
        reconstruct(dataclasses.replace(lost, measurements=empty), ["smoother"])


def test_an_initial_state_from_later_frames(folders):
    known, lost = (Dataset.open(folder) for folder in folders)
    late = tuple(
        dataclasses.replace(one, rims=RimSet.empty()) if k < 4 else one
        for k, one in enumerate(lost.measurements)
    )
    data = dataclasses.replace(lost, measurements=late)
    looked: list[int] = []
    initial = find_initial(data, Relocaliser(data), looked.append)
    assert looked == [1, 2, 3, 4, 5, 6]
    assert initial.stamp_ns == data.stamps_ns[0]
    assert np.linalg.norm(initial.gTb[:3, 3] - known.truth.gP[0]) < initial.position_sigma_m
    assert np.linalg.norm(initial.gV - known.truth.gV[0]) < initial.velocity_sigma_m_s
    turn = frames.rotation_log(initial.gTb[:3, :3].T @ known.truth.gRb[0])
    assert np.linalg.norm(turn) < initial.attitude_sigma_rad


def test_earlier_states_lead_to_the_later_ones(folders):
    data = Dataset.open(folders[0])
    descent = Descent.of(data)
    later_ns = int(data.stamps_ns[7])
    later = dataclasses.replace(descent.initial, stamp_ns=later_ns)
    begin = propagated_back(descent, later, int(data.stamps_ns[0]))
    state = dataclasses.replace(filter_state.prior(descent), gTb=begin.gTb, gV=begin.gV)
    ahead = filter_state.propagate(state, descent, int(data.stamps_ns[0]), later_ns)
    np.testing.assert_allclose(ahead.gTb[:3, 3], later.gTb[:3, 3], atol=1e-3)
    np.testing.assert_allclose(ahead.gV, later.gV, atol=1e-5)
    np.testing.assert_allclose(ahead.gTb[:3, :3], later.gTb[:3, :3], atol=1e-9)
    assert begin.position_sigma_m > later.position_sigma_m


def test_parts_of_a_trajectory_are_one(folders):
    whole = reconstruct(Dataset.open(folders[0]), ["smoother"]).trajectories["smoother"]
    cut = [
        dataclasses.replace(
            whole, rim_weights=None,
            **{
                name: getattr(whole, name)[part]
                for name in ("stamps_ns", "gTb", "gV", "bias", "pose_covariance", "velocity_covariance",
                             "bias_covariance")
            },
        )
        for part in (slice(0, 4), slice(4, None))
    ]  # fmt: skip
    joined = _joined(cut)
    np.testing.assert_array_equal(joined.gTb, whole.gTb)
    np.testing.assert_array_equal(joined.pose_covariance, whole.pose_covariance)


def few_rims(data, monkeypatch, found, expected, sigma_m):
    """Number of rims kept, of those found, where a prediction is poor and nothing explains the image."""
    gTb, limits = data.truth.gTb[0], GuidedOptions()
    rows, _ = data.catalog.visible(
        data.camera, gTb, min_semi_minor_px=limits.min_semi_minor_px, margin_px=limits.margin_px
    )
    rims = data.measurements[0].rims.take(np.resize(np.arange(3), found))
    tracker = Tracker.__new__(Tracker)
    tracker._images = SimpleNamespace(image=lambda index: None)
    tracker.dataset = SimpleNamespace(
        camera=data.camera, body=data.body, catalog=data.catalog.take(np.resize(rows, expected)),
        sun=data.sun, stamps_ns=data.stamps_ns,
    )  # fmt: skip
    tracker.front_end = SimpleNamespace(options=limits)
    tracker.relocaliser = SimpleNamespace(match=lambda *_: None)
    monkeypatch.setattr("craternav_fg.pipeline.tracking.acquire", lambda *_: None)
    frame = dataclasses.replace(data.measurements[0], rims=rims)
    monkeypatch.setattr(tracker, "_guided", lambda *_: SimpleNamespace(frame=frame))
    spread = np.diag([1e-3] * 3 + [sigma_m] * 3) ** 2
    return len(tracker._measure(0, gTb, spread).frame.rims)


@pytest.mark.parametrize(
    ("found", "expected", "sigma_m", "kept"),
    [
        (6, 40, 4e3, 0), (7, 40, 4e3, 7),
        # Where few craters are expected, chance finds most of them as well.
        (4, 4, 4e3, 0), (4, 6, 4e3, 0),
        # Not so near a better prediction.
        (6, 40, 400.0, 0), (7, 40, 400.0, 7), (4, 4, 400.0, 4), (2, 4, 400.0, 0),
    ],
)  # fmt: skip
def test_few_rims_are_discarded_after_a_poor_prediction(folders, monkeypatch, found, expected, sigma_m, kept):
    """With a poor prediction, chance puts some rims near the many craters of a real catalogue."""
    assert few_rims(Dataset.open(folders[0]), monkeypatch, found, expected, sigma_m) == kept


def test_the_network_is_asked_with_the_predicted_sun_where_clear_rims_do_not_tell(folders, monkeypatch):
    data = dataclasses.replace(Dataset.open(folders[0]), measurements=None)
    asked: list[float | None] = []

    def network(image, sun_angle_rad):
        asked.append(sun_angle_rad)
        return "rims of the network"

    monkeypatch.setattr(Relocaliser, "_image", lambda self, index: None)
    monkeypatch.setattr("craternav_fg.pipeline.relocalisation.find_rims", lambda image: "clear rims")
    monkeypatch.setattr("craternav_fg.pipeline.relocalisation.find_rims_network", network)
    known = "clear rims", "rims of the network"
    monkeypatch.setattr(Relocaliser, "_identified", lambda self, rims, *_: rims if rims in known else None)
    relocaliser = Relocaliser(data)
    assert (relocaliser.locate(0, 0.3), asked) == ("clear rims", [])
    known = ("rims of the network",)
    assert (relocaliser.locate(0, 0.3), asked) == ("rims of the network", [0.3])

    tracker = Tracker.__new__(Tracker)
    tracker.dataset = data
    state = filter_state.prior(Descent.of(data))
    for sigma_deg, told in ((5.0, True), (20.0, False)):
        covariance = state.covariance.copy()
        covariance[:3, :3] = np.deg2rad(sigma_deg) ** 2 * np.eye(3)
        angle = tracker._sun_angle_rad(0, dataclasses.replace(state, covariance=covariance))
        assert (angle is not None) == told


@pytest.mark.slow
def test_a_descent_over_real_ground_from_a_prior_that_is_10_km_off(tmp_path):
    """Worn rims: only the network, told where the sun is, finds enough of them to identify an image."""
    shared("gld100/gld100_256ppd_posidonius.tif"), shared("gld100/gld100_16ppd_global.tif")
    shared("lu1319381.parquet")
    case = load_scenario("gld100_mixed").with_data(FOLDER)
    # Longer, the few rims of one image would not predict the next: the map states what it errs.
    few = case.trajectory.model_copy(update={"frame_interval_s": 28.0})
    data = Dataset.open(simulate(case.model_copy(update={"trajectory": few}), tmp_path / "d"))
    gTb = data.initial.gTb.copy()
    up = gTb[:3, 3] / np.linalg.norm(gTb[:3, 3])
    # Eastwards, by 2.5 sigma.
    gTb[:3, 3] = data.truth.gP[0] + 10e3 * np.cross([0.0, 0.0, 1.0], up)
    data = dataclasses.replace(data, initial=dataclasses.replace(data.initial, gTb=gTb))
    result = reconstruct(data, ["smoother"])
    assert result.origin == "given"
    assert sum(len(frame.rims) for frame in result.frames) >= 8
    assert final_error_m(data, result) < 2e3


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    demo = load_scenario("lunar_descent")
    trajectory = demo.trajectory.model_copy(update={"frame_interval_s": 10.0})
    folder = tmp_path_factory.mktemp("rendered") / "d"
    return Dataset.open(simulate(demo.model_copy(update={"trajectory": trajectory}), folder))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma_deg", "sigma_share", "sigma_least_m", "first_only"),
    [
        (0.1, 0.002, 0.0, False),
        (2.0, 0.02, 0.0, False),
        (25.0, 0.08, 0.0, True),
        (2.0, 0.0, 1000.0, False),
        (25.0, 0.0, 4000.0, False),
    ],
)
def test_prior_matching_with_the_prior_wrong_by_three_sigma(
    rendered: Dataset, sigma_deg, sigma_share, sigma_least_m, first_only
):
    """Rims found blindly in the demo's images; the data set's own prior, 25 deg and 4 km, is of the first.

    A position's standard deviation is a share of the altitude, 50 to 4 km, or the same everywhere: then of
    images with three rims of known craters, as two name no place among so many that are possible.
    """
    camera, catalog = rendered.camera, rendered.catalog
    rng = np.random.default_rng(7)
    right = wrong = real = 0
    images = {k: find_rims(on_8_bit_scale(rendered.image(k), camera)) for k in range(0, len(rendered), 2)}
    for number in [0] * 20 if first_only else images:
        found = images[number]
        charts, scale = normalised_chart(found.charts_px, camera.pinhole)
        gTb = rendered.truth.gTb[number]
        rows, true = catalog.visible(camera, gTb, min_semi_minor_px=3.0, margin_px=-1e4)
        # A rim is a crater's when it lies within a few percent of its size: far nearer than any other's.
        off = np.linalg.norm(charts[:, None, :2] - true[None, :, :2], axis=2) / np.exp(true[:, 2])
        off = np.maximum(off, 0.5 * np.abs(charts[:, None, 2::2] - true[None, :, 2::2]).max(axis=2))
        truth = np.where(off.min(axis=1) < 0.06, rows[off.argmin(axis=1)], -1)
        if sigma_least_m > 0.0 and np.count_nonzero(truth >= 0) < 3:
            continue
        sigma_m = max(sigma_share * float(rendered.body.altitude_m(gTb[:3, 3])), sigma_least_m)
        sigmas = np.repeat([np.radians(sigma_deg), sigma_m], 3)
        e = rng.standard_normal(6)
        e *= 3.0 / np.linalg.norm(e)
        prior = gTb.copy()
        prior[:3, :3] = gTb[:3, :3] @ frames.rotation_exp(sigmas[:3] * e[:3])
        prior[:3, 3] += sigmas[3:] * e[3:]
        covariances = found.covariance_px * np.outer(scale, scale)
        answer = match_rims(charts, covariances, camera.pinhole, catalog, prior, np.diag(sigmas**2))
        real += np.count_nonzero(truth >= 0)
        right += np.count_nonzero((answer.craters == truth) & (truth >= 0))
        wrong += np.count_nonzero((answer.craters >= 0) & (answer.craters != truth))
    assert real > 150
    assert right / real >= 0.98
    assert wrong / (right + wrong) <= 0.002


@pytest.mark.slow
def test_images_without_an_initial_state_and_with_a_wrong_one(rendered: Dataset):
    given = reconstruct(rendered, ["smoother"])
    limit_m = 1.2 * final_error_m(rendered, given) + 0.5
    lost = reconstruct(dataclasses.replace(rendered, initial=None), ["smoother"])
    assert lost.origin == "found"
    assert final_error_m(rendered, lost) < limit_m
    gTb = rendered.initial.gTb.copy()
    gTb[:3, 3] += [0.0, 30e3, 20e3]
    wrong = dataclasses.replace(rendered, initial=dataclasses.replace(rendered.initial, gTb=gTb))
    kidnapped = reconstruct(wrong, ["smoother"])
    assert kidnapped.origin == "replaced"
    assert final_error_m(rendered, kidnapped) < limit_m
    # What the initial state explains does not speak against the map.
    assert not any("counts as exact" in text for text in kidnapped.warnings)


@pytest.mark.slow
def test_lost_in_between(rendered: Dataset, monkeypatch: pytest.MonkeyPatch):
    """Six dark images, and an accelerometer that is wrong by 2 g for 20 s of them."""
    image = Dataset.image
    monkeypatch.setattr(
        Dataset, "image", lambda self, k: image(self, k) * (0 if 8 <= k < 12 else 1), raising=True
    )
    force = rendered.imu.accelerometer_m_s2.copy()
    time_s = 1e-9 * rendered.imu.stamps_ns
    force[(time_s > 80.0) & (time_s < 100.0), 0] += 20.0
    data = dataclasses.replace(rendered, imu=dataclasses.replace(rendered.imu, accelerometer_m_s2=force))
    result = reconstruct(data, ["smoother", "online"])
    assert len(result.reinitialised_at) == 1
    assert 12 <= result.reinitialised_at[0] <= 16
    assert all(len(frame.rims) > 3 for frame in result.frames[result.reinitialised_at[0] : 22])
    for name in ("smoother", "online"):
        assert final_error_m(rendered, result, name) < 5.0
        assert len(result.trajectories[name]) == len(data)
