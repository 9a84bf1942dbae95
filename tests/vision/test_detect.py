"""Rims in images without any prior: rendered ground, noise, damaged and unusual images, real ones."""

import numpy as np
import pytest
from scipy.stats import binom, chi2

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.ellipse import chart_of_axes
from craternav_fg.evaluation.detection import match
from craternav_fg.reproduce.detection_accuracy import accuracy
from craternav_fg.simulation.empty_images import gradient_images, noise_images
from craternav_fg.simulation.paper_scenes import photograph_window, single_crater
from craternav_fg.simulation.scenes import HARD, Ground, scene
from craternav_fg.simulation.terrain import TerrainOptions
from craternav_fg.vision.brightness import brightness
from craternav_fg.vision.canny import find_rims_canny
from craternav_fg.vision.detect import BlindOptions, find_rims
from craternav_fg.vision.network_detect import find_rims_network
from tests.shared_data import shared

DETECTORS = pytest.mark.parametrize("detector", [find_rims, find_rims_canny])
ALL_DETECTORS = pytest.mark.parametrize("detector", [find_rims, find_rims_canny, find_rims_network])


@pytest.fixture(scope="module")
def scenes():
    return [scene(seed) for seed in range(4)]


@pytest.fixture(scope="module")
def one(scenes):
    return scenes[1]


@pytest.fixture(scope="module")
def found(scenes):
    """What the template method finds in them."""
    return [find_rims(one.image) for one in scenes]


@pytest.fixture(scope="module")
def reference(found):
    """The same in one of them."""
    return found[1]


def found_again(rims, reference, limit_px=0.3):
    """Share of the reference's good rims that are found within some pixels."""
    good = reference.ellipses_px[(reference.quality > 0.9) & (reference.ellipses_px[:, 3] > 12.0)]
    off = np.abs(good[:, None, :4] - rims.ellipses_px[None, :, :4]).max(axis=-1)
    return float(np.mean(off.min(axis=1, initial=np.inf) < limit_px))


def test_plain_ground(scenes):
    figures = accuracy(scenes, find_rims)
    assert figures["rims"] > 80
    assert figures["recall"] >= 0.97
    assert figures["precision"] >= 0.97
    assert figures["centre_px"] <= 0.15
    assert figures["semi_major_px"] <= 0.12
    assert figures["semi_minor_px"] <= 0.12


def test_canny_finds_most_but_inside_the_rim_crest(scenes, found):
    figures = accuracy(scenes, find_rims_canny)
    assert figures["recall"] >= 0.8
    assert figures["precision"] >= 0.95
    again = iter(found)
    template = accuracy(scenes, lambda _: next(again))
    assert figures["semi_minor_px"] > 3.0 * template["semi_minor_px"]


def test_sun_angle_and_quality(scenes, found):
    for one, rims in zip(scenes, found, strict=True):
        off = np.angle(np.exp(1j * (rims.sun_angle_rad - one.sun_angle_rad)))
        assert abs(off) < np.deg2rad(12.0)
        assert np.all(np.diff(rims.quality) <= 0.0)
        assert np.all((rims.quality >= BlindOptions().min_quality) & (rims.quality <= 1.0))
        assert np.all(rims.ellipses_px[:, 2] >= rims.ellipses_px[:, 3])
        result = match(rims.ellipses_px, one.ellipses_px, one.wanted)
        assert np.mean(rims.quality[result.detected] > 0.5) > 0.9


def test_covariances_hold_95_percent_of_the_true_rims(scenes, found):
    """Smooth rims and rims with outlines 1.5 % off an ellipse, as many of each: the floor is for both."""
    distance2 = []
    rough = [scene(seed, Ground(irregularity_share=0.015)) for seed in range(4)]
    every = [*found, *(find_rims(one.image) for one in rough)]
    for one, rims in zip([*scenes, *rough], every, strict=True):
        result = match(rims.ellipses_px, one.ellipses_px, one.wanted)
        wanted = one.wanted[result.true]
        hits = result.detected[wanted]
        error = rims.charts_px[hits] - chart_of_axes(one.ellipses_px[result.true[wanted]])
        solved = np.linalg.solve(rims.covariance_px[hits], error[..., None])[..., 0]
        distance2 += np.sum(error * solved, axis=1).tolist()
    inside = np.count_nonzero(np.array(distance2) < chi2.ppf(0.95, 5))
    low, high = binom.ppf([0.001, 0.999], len(distance2), 0.95)
    assert len(distance2) > 160
    assert low <= inside <= high


@pytest.mark.slow
def test_hard_ground():
    """Craters that cut one another on rough ground."""
    figures = accuracy([scene(seed, HARD) for seed in range(100, 108)], find_rims)
    assert figures["rims"] > 300
    assert figures["recall"] >= 0.85
    assert figures["precision"] >= 0.92
    assert figures["centre_px"] <= 0.4
    assert figures["semi_major_px"] <= 0.25
    assert figures["semi_minor_px"] <= 0.25


@pytest.mark.slow
def test_much_plain_ground():
    figures = accuracy([scene(seed) for seed in range(100, 120)], find_rims)
    assert figures["rims"] > 350
    assert figures["recall"] >= 0.97
    assert figures["precision"] >= 0.97


@DETECTORS
@pytest.mark.parametrize("images", [noise_images, gradient_images])
def test_no_crater_is_invented(images, detector):
    for image in images(np.random.default_rng(4)):
        assert len(detector(image)) == 0
        assert len(detector(image, 0.7)) == 0


@pytest.mark.parametrize(
    "convert",
    [
        lambda im: np.dstack([im, im, im]),
        lambda im: np.dstack([im, im, im, np.full_like(im, 255)]),
        lambda im: im.astype(np.uint16) * 257,
        lambda im: im.astype(np.uint16) * 16,
        lambda im: im.astype(np.float32) / 255.0,
        lambda im: im.astype(np.float64) * 1e-3 - 0.05,
        lambda im: im // 4,
    ],
    ids=["rgb", "rgba", "16 bit", "12 bit in 16", "float", "negative floats", "dim"],
)
def test_depth_and_colour_do_not_matter(one, reference, convert):
    limit_px = 0.6 if convert(one.image).max() == one.image.max() // 4 else 0.3
    assert found_again(find_rims(convert(one.image)), reference, limit_px) >= 0.9


def test_holes_are_left_out(one):
    image = one.image.astype(np.float32)
    image[300:600, 300:600] = np.nan
    image[::37, ::41] = np.inf
    rims = find_rims(image)
    assert np.isfinite(rims.ellipses_px).all()
    x, y = rims.ellipses_px[:, :2].T
    assert not np.any((x > 320) & (x < 580) & (y > 320) & (y < 580))
    result = match(rims.ellipses_px, one.ellipses_px, one.wanted, rims.ellipses_px[:, 3] > 12.0)
    ex, ey, a = one.ellipses_px[:, :3].T
    clear = one.wanted & ((np.abs(ex - 450) > 150 + 1.3 * a) | (np.abs(ey - 450) > 150 + 1.3 * a))
    assert np.isin(np.flatnonzero(clear), result.true).mean() > 0.9
    assert len(result.false) <= 1


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values_that_no_brightness_has_are_holes(one, dtype):
    """ISIS writes missing and saturated pixels as about -3.4e38; warnings are errors in tests."""
    image = one.image.astype(dtype)
    image[100:200, 300:500] = np.nan
    image[400, 400:404] = np.nan
    special = image.copy()
    special[100:200, 300:400] = np.float32(-3.4028226550889045e38)
    special[100:200, 400:500] = 1e38 if dtype is np.float32 else 1e300
    special[400, 400:404] = np.finfo(dtype).max
    np.testing.assert_array_equal(brightness(special), brightness(image))


@pytest.mark.parametrize("void", [-9999, -32768, -32767])
@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_numbers_that_stand_for_no_data_without_the_files_saying_so(void, dtype):
    image = np.random.default_rng(3).integers(-400, 3000, (60, 80)).astype(dtype)
    holes = np.zeros(image.shape, dtype=bool)
    holes[:, :20] = True
    marked = np.where(holes, dtype(void), image)
    # What ISIS writes for pixels below what the instrument could measure.
    marked[:5, :5] = void if void == -9999 else -32766
    out = brightness(marked)
    np.testing.assert_array_equal(np.isnan(out), holes)
    np.testing.assert_allclose(out[~holes], brightness(image[:, 20:]).ravel(), atol=1.0)
    # Heights, or any numbers that go down to there.
    marked[30:] = np.linspace(void, 0, 80)
    assert not np.isnan(brightness(marked)).any()


def test_night_and_sky_hold_no_rims(one):
    image = one.image.copy()
    image[:, 600:] = np.random.default_rng(2).integers(0, 5, image[:, 600:].shape)
    rims = find_rims(image)
    assert not np.any(rims.ellipses_px[:, 0] > 600.0)
    result = match(rims.ellipses_px, one.ellipses_px, one.wanted, rims.ellipses_px[:, 3] > 12.0)
    clear = one.wanted & (one.ellipses_px[:, 0] < 600.0 - 2.0 * one.ellipses_px[:, 2])
    assert np.isin(np.flatnonzero(clear), result.true).mean() > 0.9
    assert len(result.false) <= 1


@ALL_DETECTORS
@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (3, 5), (16, 16), (40, 25), (7, 900)])
def test_tiny_images(shape, detector):
    rng = np.random.default_rng(0)
    assert len(detector(rng.integers(0, 255, shape, dtype=np.uint8))) == 0


@ALL_DETECTORS
@pytest.mark.parametrize("value", [0, 1, 110, 255, np.nan])
def test_constant_images(value, detector):
    image = np.full((200, 300), value, dtype=np.float32 if np.isnan(value) else np.uint8)
    assert len(detector(image)) == 0
    assert len(detector(np.zeros((200, 300), dtype=np.bool_))) == 0


def test_saturated_image_gives_rims_of_craters_only(one):
    bright = np.clip(one.image.astype(np.float64) * 2.5, 0, 255).astype(np.uint8)
    assert np.mean(bright == 255) > 0.05
    rims = find_rims(bright)
    result = match(rims.ellipses_px, one.ellipses_px, one.wanted, rims.ellipses_px[:, 3] > 12.0)
    assert len(result.false) <= 1


def test_known_sun_angle_gives_the_same_rims(one, reference):
    rims = find_rims(one.image, one.sun_angle_rad + np.deg2rad(15.0))
    assert found_again(rims, reference) >= 0.95
    assert rims.sun_angle_rad == pytest.approx(one.sun_angle_rad + np.deg2rad(15.0))


@ALL_DETECTORS
@pytest.mark.parametrize("wrong_deg", [90.0, 180.0, -90.0])
def test_wrong_sun_angle_holds_and_is_noticed(one, detector, wrong_deg):
    given = one.sun_angle_rad + np.deg2rad(wrong_deg)
    rims = detector(one.image, given)
    assert rims.sun_angle_rad == given
    assert rims.sun_contradicted
    off = np.angle(np.exp(1j * (rims.seen_sun_angle_rad - one.sun_angle_rad)))
    assert abs(off) < np.deg2rad(12.0)


@ALL_DETECTORS
def test_the_right_sun_angle_is_not_contradicted(one, detector):
    assert not detector(one.image, one.sun_angle_rad).sun_contradicted


def test_turned_image_has_turned_rims(one, reference):
    turned = find_rims(np.rot90(one.image).copy())
    x, y, a, b, angle = turned.ellipses_px.T
    back = np.column_stack([one.image.shape[1] - 1 - y, x, a, b, angle + 0.5 * np.pi])
    result = match(back, reference.ellipses_px[reference.quality > 0.9])
    assert result.recall > 0.97
    assert np.mean(result.centre_px) < 0.15
    assert np.max(result.centre_px) < 1.5


def test_smallest_radius_is_an_option(one, reference):
    small = find_rims(one.image, options=BlindOptions(min_radius_px=20.0))
    assert 0 < len(small) < len(reference)
    assert small.ellipses_px[:, 2].min() > 12.0
    with pytest.raises(ValueError, match="at least 4"):
        BlindOptions(min_radius_px=1.0)


@pytest.mark.parametrize("find", [find_rims_network, find_rims, find_rims_canny])
@pytest.mark.parametrize("angle", [np.nan, np.inf])
def test_an_angle_that_an_image_did_not_show_is_no_angle(find, angle):
    with pytest.raises(ValueError, match="sun_angle_rad: expected a finite angle or None, found"):
        find(np.zeros((50, 50), dtype=np.uint8), angle)


@pytest.mark.parametrize("shape", [(0, 10), (10,), (4, 4, 5), (2, 3, 4, 3)])
def test_no_image(shape):
    with pytest.raises(ValueError, match="expected an image"):
        brightness(np.zeros(shape, dtype=np.uint8))
    with pytest.raises(ValueError, match="expected an image"):
        brightness(np.zeros((5, 5), dtype=np.complex64))


def test_brightness_keeps_plain_bytes_and_tells_saturation():
    rng = np.random.default_rng(1)
    plain = rng.integers(0, 240, (50, 60), dtype=np.uint8)
    assert np.array_equal(brightness(plain), plain)
    deep = rng.integers(0, 3000, (50, 60)).astype(np.uint16)
    deep[:10] = 4095
    out = brightness(deep)
    assert np.all(out[:10] == 255.0)
    assert out[10:].max() < 250.0


@pytest.mark.parametrize(
    ("name", "crop", "drawn"),
    [
        # Centre x, y, semi-major, semi-minor axis, px, by eye on an enlarged image.
        (
            "images/eros_near_m0157063318.png",
            np.s_[:, :],
            [(171, 215, 31, 22), (130, 282, 17, 15), (113, 337, 9, 6.5), (82, 343, 13, 12)],
        ),
        (
            "dione.tif",
            np.s_[120:380, 180:400],
            [
                (105, 206, 7.3, 7),
                (114, 188, 5.4, 5),
                (144, 136, 5.1, 5),
                (159, 148, 4.6, 4.2),
                (79, 242, 4.5, 4),
            ],
        ),
    ],
)
def test_real_images(name, crop, drawn):
    rims = find_rims(read_foreign_image(shared(name))[crop], options=BlindOptions(min_radius_px=4.0))
    # Every one was looked at: few, and all of them craters.
    assert len(drawn) <= len(rims) <= 15
    for x, y, a, b in drawn:
        off = np.abs(rims.ellipses_px[:, :4] - [x, y, a, b]).max(axis=1)
        assert off.min() < 1.0 + 0.06 * a


def test_candidates_in_one_large_shadow_do_not_outvote_the_sun_angle():
    """A window with one crater of 240 px, half in its shadow: small candidates there agree on the reverse."""
    rng = np.random.default_rng([12, 77])
    view = single_crater(rng, 10e3, int(rng.integers(2**31)))
    one, _ = photograph_window(view, rng, TerrainOptions(cells=1024))
    rims = find_rims(one.image, one.sun_angle_rad)
    assert len(rims) > 0
    assert rims.sun_angle_rad == one.sun_angle_rad
    assert not rims.sun_contradicted
