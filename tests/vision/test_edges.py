import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.vision import edge_kernel, normal_profile, rim_geometry, shift_kernel
from craternav_fg.vision.crest_tables import crest_tables
from craternav_fg.vision.rim_shading import RimShading

REFERENCE = 100.0
CENTRE = np.array([61.3, 58.8])
CHART = np.array([*CENTRE, np.log(20.0), 0.2, np.log(17.0)])
# Slope contrast towards -x: walls facing +x, on the left, are dark.
CONTRAST_PX = np.array([-20.0, 0.0])
SMOOTHING_SHARE, SMOOTHING_PX, PSF_PX = 0.02, 0.4, 0.0
PLAIN = Camera(128, 128, 150.0, 150.0, 63.5, 63.5).lens
EVEN = np.zeros(5)
# Brightness of level ground does not change along the image, and slopes change it as on Lambertian ground.
LEVEL = np.zeros(2)
LAMBERTIAN = -0.5 * np.array([[400.0, 80.0], [80.0, 305.0]])
SHADING = RimShading(
    REFERENCE, LEVEL, CONTRAST_PX, LAMBERTIAN, np.sqrt(0.5) * CONTRAST_PX, np.zeros(2),
    np.array([np.sqrt(0.5), 1.0]), 0.0,
)  # fmt: skip
ANGLES = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)


def tables():
    """Of a rim crest whose crossing is on it."""
    known = crest_tables(PSF_PX, SMOOTHING_PX, SMOOTHING_SHARE)
    nothing = np.zeros(known.crossings.shape)
    # As the table is: the kernel would be compiled anew.
    nothing.flags.writeable = False
    return known._replace(crossings=nothing)


def rim_image(centre=CENTRE, contrast=0.5):
    """Brightness with an edge on the rim of CHART: the reference on it, antisymmetric about it."""
    v, u = np.mgrid[0:128, 0:128]
    x = (u - centre[0]) / 20.0
    y = (v - centre[1] - 0.2 * (u - centre[0])) / 17.0
    r = np.hypot(x, y) + 1e-12
    # Distance to the rim, and the normal's x.
    gx, gy = (x / 20.0 - 0.2 * y / 17.0) / r, y / 17.0 / r
    distance = (r - 1.0) / np.hypot(gx, gy)
    shape = -np.tanh(distance / 2.0) * np.exp(-0.5 * (distance / 8.0) ** 2)
    return (REFERENCE * (1.0 + contrast * gx / np.hypot(gx, gy) * shape)).astype(np.float32)


def trace(
    image,
    chart=CHART,
    min_slope_contrast=0.12,
    reference=REFERENCE,
    ground=EVEN,
    thorough=False,
    gradient=LEVEL,
):
    return edge_kernel.trace_rim(
        image,
        chart,
        SHADING._replace(reference=reference, gradient=gradient),
        4.0,
        SMOOTHING_SHARE,
        SMOOTHING_PX,
        PSF_PX,
        min_slope_contrast,
        0.02,
        0.0,
        72,
        tables(),
        PLAIN,
        ground,
        thorough,
    )[:4]


def off_px(points):
    """Distance (n,) of points to the rim of CHART, to first order."""
    x = points - CENTRE
    u, v = x[:, 0] / 20.0, (x[:, 1] - 0.2 * x[:, 0]) / 17.0
    r = np.hypot(u, v)
    return (r - 1.0) / np.hypot((u / 20.0 - 0.2 * v / 17.0) / r, v / 17.0 / r)


def test_no_smoothing_is_the_limit_of_little():
    """Both are options that may be zero; without a kernel to read, no edge was found."""
    found = [
        edge_kernel.trace_rim(
            rim_image(), CHART, SHADING, 4.0, 0.0, smoothing_px, 0.0, 0.12, 0.02, 0.0, 72, tables(), PLAIN,
            EVEN, False,
        )[0]
        for smoothing_px in (0.01, 0.0)
    ]  # fmt: skip
    assert len(found[0]) > 60
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_points_lie_on_the_rim_though_predicted_beside_it():
    chart = np.add(CHART, [1.5, -1.0, 0.03, 0.0, -0.02])
    points, ratio, motion, tried = trace(rim_image(), chart)
    assert len(points) == len(ratio) == len(motion)
    assert len(points) >= 0.95 * tried >= 55
    assert np.max(np.abs(off_px(points))) < 0.06


def test_points_lie_on_the_rim_where_the_ground_gets_brighter_across_it():
    """As the law and the lens let it; a rim lit along that direction would come out larger."""
    v, u = np.mgrid[0:128, 0:128]
    gradient = np.array([0.004, -0.002])
    image = rim_image() * (1.0 + gradient[0] * (u - CENTRE[0]) + gradient[1] * (v - CENTRE[1]))
    told, silent = (off_px(trace(image.astype(np.float32), gradient=known)[0]) for known in (gradient, LEVEL))
    assert np.max(np.abs(told)) < 0.06
    assert np.abs(np.mean(silent)) > 0.2


def test_no_points_where_the_rim_runs_along_the_illumination_direction():
    points, ratio, _, tried = trace(rim_image(), min_slope_contrast=0.5)
    assert 40 <= tried < 60
    x = points - CENTRE
    normals = np.column_stack([x[:, 0] / 400.0, x[:, 1] / 289.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.min(np.abs(normals[:, 0])) > 0.2
    assert np.max(ratio) / np.min(ratio) > 1.3


def test_the_wrong_sense_of_shading_has_no_edge():
    points, _, _, tried = trace(rim_image(contrast=-0.5))
    assert tried >= 55
    assert len(points) < 0.1 * tried


def test_motion_is_that_of_the_points_with_the_reference_brightness():
    image = rim_image()
    points, _, motion, _ = trace(image)
    brighter, _, _, _ = trace(image / np.float32(1.01))
    assert len(points) == len(brighter)
    # A reference raised by 1 % is an image dimmed by 1 %.
    moved = (brighter - points) / 0.01
    inner = np.linalg.norm(motion, axis=1) < np.median(np.linalg.norm(motion, axis=1))
    np.testing.assert_allclose(moved[inner], motion[inner], rtol=0.1, atol=0.3)


def test_saturated_and_missing_parts_give_no_points():
    image = rim_image()
    image[:, 64:] = 255.0
    points, _, _, _ = trace(image)
    assert len(points) > 15
    assert np.all(points[:, 0] < 64.0)
    border, _, _, tried = trace(rim_image()[:, :64].copy())
    assert np.all(border[:, 0] < 64.0)
    assert 10 < tried < 45


def test_an_overexposed_wall_gives_no_points():
    image = np.minimum(1.9 * rim_image(contrast=0.6), 255.0).astype(np.float32)
    points, _, _, tried = trace(image, reference=1.9 * REFERENCE)
    # The bright wall is on the right.
    assert np.all(points[:, 0] < CENTRE[0] + 16.0)
    assert 0.4 * tried < len(points) < 0.8 * tried


@pytest.mark.parametrize("shift", [(3.0, -4.0), (-6.0, 5.0), (0.0, 0.0)])
def test_common_shift(shift):
    image = rim_image(CENTRE + shift)
    best, score = shift_kernel.search_shift(
        image,
        CHART[None],
        CONTRAST_PX[None],
        np.array([REFERENCE]),
        ANGLES,
        np.zeros(2),
        8.0,
        1.0,
        0.12,
        1.0,
        PLAIN,
    )
    np.testing.assert_array_equal(best, shift)
    assert score > 0.1


def test_a_rim_that_no_shift_brings_into_the_image_has_none():
    """The corner of the searched square it used to be, as sure as any other."""
    chart = CHART.copy()
    chart[0] = -40.0
    best, score = shift_kernel.search_shift(
        rim_image(), chart[None], CONTRAST_PX[None], np.array([REFERENCE]), ANGLES, np.ones(2), 8.0, 1.0,
        0.12, 1.0, PLAIN,
    )  # fmt: skip
    np.testing.assert_array_equal(best, np.ones(2))
    assert score == -np.inf


def test_smoothing_at_the_ends_of_a_profile():
    """Weights of samples that do not exist are left out, so that what is even stays so."""
    raw, kernel = np.random.default_rng(0).normal(size=31), normal_profile.half_gaussian(2.0)
    away = np.abs(np.subtract.outer(np.arange(31), np.arange(31)))
    weights = np.where(away < len(kernel), kernel[np.minimum(away, len(kernel) - 1)], 0.0)
    expected = weights @ raw / weights.sum(axis=1)
    single = [normal_profile._smoothed(raw, i, kernel) for i in range(31)]
    np.testing.assert_allclose(single, expected, rtol=1e-12)
    for first, last in ((0, 30), (-3, 40), (5, 7), (0, 2), (29, 30)):
        out = np.full(31, np.nan)
        normal_profile.smooth_between(raw, first, last, kernel, out)
        inside = slice(max(first, 0), last + 1)
        np.testing.assert_allclose(out[inside], expected[inside], rtol=1e-12)
        assert np.isnan(np.delete(out, np.arange(31)[inside])).all()


def test_curvature_and_support_of_a_rim():
    q, near = np.empty(6), np.empty((3, 6))
    for angle in np.linspace(0.1, 6.0, 9):
        rim_geometry.rim_point(CHART, angle, q)
        for k, step in enumerate((-1e-4, 0.0, 1e-4)):
            rim_geometry.rim_point(CHART, angle + step, near[k])
        first = (near[2, :2] - near[0, :2]) / 2e-4
        second = (near[2, :2] - 2.0 * near[1, :2] + near[0, :2]) / 1e-8
        curvature = abs(first[0] * second[1] - first[1] * second[0]) / np.linalg.norm(first) ** 3
        assert q[5] == pytest.approx(curvature, rel=1e-5)
        assert q[4] == pytest.approx((q[:2] - CENTRE) @ q[2:4], rel=1e-12)
        assert abs(first @ q[2:4]) < 1e-6
