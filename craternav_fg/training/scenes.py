"""Rendered ground with craters of all ages: what the judgement of candidates is trained on.

The ground is a height map seen from above. Craters of a power law of sizes fall on it in the order of time;
between epochs the ground creeps (diffusion), so that old craters are shallow and small ones vanish. The sun
is to the right at any elevation, shadows are cast, and the image is blurred, stretched, clipped and noisy.
It shares no code with `craternav_fg.simulation`: the detector is judged there.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ImageArray = npt.NDArray[np.uint8]

SIDE_PX = 1024
# Radii of the craters, px; those below the first are texture.
_LEAST_PX, _MOST_PX, _LISTED_PX = 2.2, 180.0, 3.5
_EPOCHS = 10
# More craters would bury the larger ones.
_MOST_CRATERS = 16_000
# Slope of the ground below which a shadow's border is noise, in px of height.
_SHADOW_MARGIN_PX = 0.3


@dataclass(frozen=True)
class Ground:
    """A rendered image and its craters.

    Attributes
    ----------
    image : ndarray of uint8, shape (SIDE_PX, SIDE_PX)
    circles_px : ndarray, shape (n, 3)
        In the image: centre x, y and radius.
    freshness : ndarray, shape (n,)
        Share of a fresh crater's depth that creep has left; 0 where a later crater took the place.
    sun_angle_rad : float
        Direction towards the sun in the image, from x towards y.
    """

    image: ImageArray
    circles_px: FloatArray
    freshness: FloatArray
    sun_angle_rad: float


def scene(rng: np.random.Generator) -> Ground:
    """Render one scene.

    Parameters
    ----------
    rng : Generator

    Returns
    -------
    Ground
    """
    heights = fractal(rng, rng.uniform(1.4, 2.2)) * 10.0 ** rng.uniform(-0.3, 1.1)
    radius = _radii(rng)
    n = len(radius)
    place = rng.uniform(-0.05, 1.05, (n, 2)) * SIDE_PX
    epoch = np.sort(rng.integers(0, _EPOCHS, n))
    creep_px = np.full(_EPOCHS, rng.uniform(0.3, 1.8))
    depth = rng.uniform(0.55, 1.05, n)
    alive = np.ones(n, dtype=np.bool_)
    first = 0
    for age in range(_EPOCHS):
        last = int(np.searchsorted(epoch, age, side="right"))
        for k in range(first, last):
            _dig(rng, heights, place[k], radius[k], depth[k])
            if radius[k] > _LISTED_PX:
                near = np.hypot(*(place[:k] - place[k]).T) < radius[k] + 0.3 * radius[:k]
                alive[:k] &= ~(near & (radius[:k] < 1.2 * radius[k]))
        first = last
        if age < _EPOCHS - 1:
            heights = cv2.GaussianBlur(heights, (0, 0), creep_px[age])
    crept2 = np.array([np.sum(creep_px[age : _EPOCHS - 1] ** 2) for age in range(_EPOCHS)])[epoch]
    left = np.where(alive, depth / (1.0 + 2.5 * crept2 / radius**2) ** 1.5, 0.0)
    quarters = int(rng.integers(0, 4))
    image, place = _turned(_photograph(rng, heights), place, quarters)
    listed = radius > _LISTED_PX
    return Ground(image, np.column_stack([place, radius])[listed], left[listed], -0.5 * np.pi * quarters)


def fractal(rng: np.random.Generator, exponent: float) -> FloatArray:
    """Draw a random field with a power law of amplitudes, periodic, of unit variance.

    Parameters
    ----------
    rng : Generator
    exponent : float
        Amplitudes fall with the frequency to this power.

    Returns
    -------
    ndarray, shape (SIDE_PX, SIDE_PX)
        Dimensionless.
    """
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE_PX), np.fft.rfftfreq(SIDE_PX), indexing="ij"))
    f[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((SIDE_PX, SIDE_PX))) * f**-exponent
    field = np.fft.irfft2(spectrum, s=(SIDE_PX, SIDE_PX))
    return np.asarray(field / field.std())


def _radii(rng: np.random.Generator) -> FloatArray:
    """Draw radii of a power law, 20 to 140 craters of 12 px and more per 800 x 800 px."""
    power = rng.uniform(2.0, 3.0)
    larger = 60.0 * 10.0 ** rng.uniform(-0.6, 0.35) * (SIDE_PX / 800.0) ** 2 * 12.0**power
    count = min(int(2.5 * larger * _LEAST_PX**-power), _MOST_CRATERS)
    share = 1.0 - (_LEAST_PX / _MOST_PX) ** power
    return np.asarray(_LEAST_PX * (1.0 - share * rng.random(count)) ** (-1.0 / power))


def _dig(
    rng: np.random.Generator, heights: FloatArray, place: FloatArray, radius: float, fresh: float
) -> None:
    """Dig a crater of any profile and outline: bowl or flat floor, rim, apron, at times a central peak."""
    x, y = place
    reach = int(3.0 * radius + 3.0)
    x0, x1 = max(int(x) - reach, 0), min(int(x) + reach + 1, SIDE_PX)
    y0, y1 = max(int(y) - reach, 0), min(int(y) + reach + 1, SIDE_PX)
    if x0 >= x1 or y0 >= y1:
        return
    X, Y = np.meshgrid(np.arange(x0, x1) - x, np.arange(y0, y1) - y)
    ratio, turn = np.sqrt(rng.uniform(0.85, 1.0)), rng.uniform(0.0, np.pi)
    u = (np.cos(turn) * X + np.sin(turn) * Y) * ratio
    v = (np.cos(turn) * Y - np.sin(turn) * X) / ratio
    angle = np.arctan2(v, u)
    outline = sum(rng.normal(0.0, 0.02) * np.cos(k * angle + rng.uniform(0.0, 6.3)) for k in range(2, 7))
    r = np.hypot(u, v) / radius * (1.0 + outline)
    depth = 0.4 * radius * fresh * rng.uniform(0.6, 1.1)
    rim = 0.08 * radius * fresh * rng.uniform(0.4, 1.3)
    floor = max(rng.uniform(-1.0, 0.6), 0.0)
    wall = np.clip((r - floor) / (1.0 - floor), 0.0, None) ** rng.uniform(1.6, 3.2)
    relief = np.where(
        r < 1.0, (depth + rim) * wall - depth, rim * np.maximum(r, 1.0) ** -rng.uniform(2.5, 4.0)
    )
    relief *= np.clip(3.0 - r, 0.0, 1.0)
    if radius > 25.0 and rng.random() < 0.15:
        relief += 0.3 * depth * np.exp(-0.5 * (r / 0.15) ** 2)
    old = heights[y0:y1, x0:x1]
    below = r < 1.2
    level = float(np.median(old[below])) if below.any() else 0.0
    # Most of what was there before is blown away.
    old += 0.8 * (level - old) * np.clip(2.0 * (1.15 - r) / 1.15, 0.0, 1.0) + relief


def _photograph(rng: np.random.Generator, heights: FloatArray) -> ImageArray:
    """Take an image of a height map, the sun to the right."""
    elevation = np.radians(rng.uniform(5.0, 35.0) if rng.random() < 0.6 else rng.uniform(35.0, 80.0))
    heights = heights * rng.uniform(0.7, 1.2)
    gy, gx = np.gradient(heights)
    mu = 1.0 / np.sqrt(1.0 + gx**2 + gy**2)
    mu0 = np.clip((np.sin(elevation) - gx * np.cos(elevation)) * mu, 0.0, None)
    share = rng.uniform(0.2, 0.9)
    light = share * 2.0 * mu0 / (mu0 + mu + 1e-6) + (1.0 - share) * mu0
    # Along the rays a height falls by tan(elevation) per pixel.
    ray = heights - np.arange(SIDE_PX) * np.tan(elevation)
    light[np.maximum.accumulate(ray[:, ::-1], axis=1)[:, ::-1] > ray + _SHADOW_MARGIN_PX] = 0.0
    light *= np.exp(rng.uniform(0.0, 0.12) * fractal(rng, rng.uniform(1.0, 1.8)))
    light = cv2.GaussianBlur(light, (0, 0), rng.uniform(0.4, 1.3))
    low, high = np.percentile(light, [rng.uniform(0.0, 3.0), rng.uniform(96.0, 100.0)])
    grey = (light - low) / (high - low + 1e-6)
    if rng.random() < 0.5:
        black = rng.uniform(0.05, 0.25)
        grey = black + (0.95 - black) * grey
    grey = 255.0 * np.clip(grey, 0.0, 1.0) ** rng.uniform(0.7, 1.4)
    grey += rng.normal(0.0, 10.0 ** rng.uniform(-0.5, 0.9), grey.shape)
    image = np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)
    if rng.random() < 0.4:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 97))]
        image = np.asarray(
            cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_GRAYSCALE), np.uint8
        )
    return image


def _turned(image: ImageArray, place: FloatArray, quarters: int) -> tuple[ImageArray, FloatArray]:
    """Turn an image and places in it by quarters."""
    x, y = place.T
    for _ in range(quarters):
        x, y = y, SIDE_PX - 1.0 - x
    return np.ascontiguousarray(np.rot90(image, quarters)), np.column_stack([x, y])
