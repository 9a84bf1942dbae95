"""Sums over discs: against sums pixel by pixel."""

import numpy as np

from craternav_fg.vision.disc_kernel import running_sums, share_of_variance

HALF_WIDTHS = np.array([1, 3, 3, 4, 3, 3, 1])


def test_share_of_the_variance_in_discs():
    rng = np.random.default_rng(0)
    border, shape = 5, (23, 31)
    values = rng.normal(0.1, 0.3, (shape[0] + 2 * border, shape[1] + 2 * border)).astype(np.float32)
    along_x, along_y = rng.normal(size=(2, *shape)).astype(np.float32)
    out = share_of_variance(running_sums(values), HALF_WIDTHS, along_x, along_y, np.float32(0.01))
    rows = range(-(len(HALF_WIDTHS) // 2), len(HALF_WIDTHS) // 2 + 1)
    for y, x in ((0, 0), (22, 30), (11, 7), (3, 30)):
        inside = [
            values[border + y + dy, border + x - half : border + x + half + 1]
            for dy, half in zip(rows, HALF_WIDTHS, strict=True)
        ]
        variance = np.concatenate(inside).astype(np.float64).var()
        expected = (along_x[y, x] ** 2 + along_y[y, x] ** 2) / (variance + 0.01)
        np.testing.assert_allclose(out[y, x], expected, rtol=1e-4)


def test_of_an_even_image_only_the_floor_is_left():
    out = share_of_variance(
        running_sums(np.full((20, 20), 3.0, np.float32)), HALF_WIDTHS, *np.ones((2, 10, 10), np.float32),
        np.float32(0.5),
    )  # fmt: skip
    np.testing.assert_allclose(out, 4.0, rtol=1e-4)
