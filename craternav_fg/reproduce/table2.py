"""Table 2: standard deviations of the errors of the rims' conic coefficients, over the altitude."""

import numpy as np
import pyarrow as pa

from craternav_fg.estimators.linearisation import PAPER_NOISE
from craternav_fg.reproduce import image_plots
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.results import Reproduction, known
from craternav_fg.reproduce.rim_methods import CANNY, GUIDED, METHODS, image_row, judged
from craternav_fg.reproduce.table2_trials import CENTRAL, COEFFICIENTS
from factors.arrays import FloatArray

# By altitude, km: A to F, as the paper prints them.
TABLE2 = {
    50: (1.26e-6, 1.98e-5, 3.06e-6, 2.40e-4, 2.25e-4, 2.91e-6),
    40: (1.68e-3, 7.61e-3, 1.04e-3, 3.67e-4, 4.03e-4, 1.42e-5),
    30: (2.45e-3, 7.42e-3, 1.30e-3, 1.63e-4, 1.85e-4, 7.78e-6),
    20: (2.44e-3, 8.59e-3, 2.60e-3, 3.00e-4, 3.06e-4, 1.78e-5),
    10: (3.08e-3, 8.00e-3, 3.06e-3, 6.28e-4, 6.41e-4, 7.98e-5),
}
_PAPER_IMAGES = 128
# A printed number that is this factor from that of the next lower altitude is out of line.
_OUT_OF_LINE_FACTOR = 100.0


def table2(data: pa.Table, options: ReproduceOptions) -> Reproduction:
    """Compare standard deviations of the conic coefficients' errors with the paper's table 2.

    Parameters
    ----------
    data : pyarrow.Table
        See `table2_trials.simulate`.
    options : ReproduceOptions

    Returns
    -------
    Reproduction
    """
    deviations, central = (
        {method: _deviations(data, method, tag) for method in METHODS} for tag in ("", CENTRAL)
    )
    count = float(np.mean(np.isfinite(data[f"{CANNY}_A"].to_numpy()))) * options.images
    scatter = np.sqrt(0.5 / max(count, 2.0) + 0.5 / _PAPER_IMAGES)
    rows = []
    for j, name in enumerate(COEFFICIENTS):
        quantity = f"standard deviation of {name}"
        for found, place in ((deviations, ""), (central, ", rims on the optical axis")):
            for i, (km, printed) in enumerate(TABLE2.items()):
                values = {method: known(found[method][i, j]) for method in METHODS}
                words = judged(printed[j], values[CANNY], values[GUIDED], scatter * (values[CANNY] or 0.0))
                where = f"{km} km, {options.images} images{place}"
                rows.append(
                    image_row(
                        "table2", quantity, where, "1", values, verdict=words + _out_of_line(i, j),
                        paper=printed[j], headline=not place,
                    )
                )  # fmt: skip
        pooled = {method: known(np.sqrt(np.nanmean(deviations[method][:, j] ** 2))) for method in METHODS}
        noise = float(np.sqrt(PAPER_NOISE[j, j]))
        words = judged(noise, pooled[CANNY], pooled[GUIDED])
        where = "in Qn, against all altitudes"
        rows.append(image_row("table2", quantity, where, "1", pooled, verdict=words, paper=noise))
    return Reproduction(
        "table2",
        "Errors of the rims' conic coefficients over the altitude",
        rows,
        _note(data, deviations[GUIDED], central[GUIDED]),
        image_plots.draw_coefficients(TABLE2, deviations, np.sqrt(np.diag(PAPER_NOISE))),
        data,
    )


def _deviations(data: pa.Table, method: str, tag: str) -> FloatArray:
    """Return standard deviations (altitudes, 6) of the coefficients' errors, NaN for fewer than two rims."""
    altitude = data["altitude_km"].to_numpy()
    errors = np.stack([data[f"{method}_{name}{tag}"].to_numpy() for name in COEFFICIENTS])
    parts = [errors[:, (altitude == km) & np.isfinite(errors[0])] for km in TABLE2]
    return np.array([part.std(axis=1) if part.shape[1] > 1 else np.full(6, np.nan) for part in parts])


def _steps() -> FloatArray:
    """Factors (altitudes - 1, 6) between the paper's numbers of neighbouring altitudes: lower over higher."""
    printed = np.array(list(TABLE2.values()))
    return np.asarray(printed[1:] / printed[:-1])


def _out_of_line(row: int, column: int) -> str:
    """Remark that a printed number is far from that of the next lower altitude."""
    steps = _steps()
    if row == len(steps) or abs(np.log(steps[row, column])) <= np.log(_OUT_OF_LINE_FACTOR):
        return ""
    km, printed = list(TABLE2.items())[row + 1]
    return f"; out of line with the paper's {printed[column]:.2e} at {km} km"


def _note(data: pa.Table, deviations: FloatArray, central: FloatArray) -> str:
    size, altitude = (data[name].to_numpy() for name in ("semi_minor_px", "altitude_km"))
    printed = np.array(list(TABLE2.values()))
    ranges = [
        "{:.2g} to {:.2g}".format(*np.nanquantile((values / printed)[1:, part], (0.1, 0.9)))
        for values in (deviations, central)
        for part in (slice(0, 3), slice(3, 6))
    ]
    sizes = ", ".join(f"{np.median(size[altitude == km]):.0f} px at {km} km" for km in (50, 20, 10))
    shares = ", ".join(f"{np.mean(np.isfinite(data[f'{m}_A'].to_numpy())):.0%} ({m})" for m in METHODS)
    steps = _steps()[0]
    return (
        "The paper does not say how its coefficients are scaled, which craters its 128 images show, how "
        "large and where they are in the image, nor where the sun stands; the scale alone changes every "
        "number. Here (A, ..., F) has length 1, in u = x / z, and each image shows one crater of the paper's "
        "case one (semi-axes 0.5 to 2.5 km, axis ratios of at least 0.75, camera up to 30 deg off nadir, sun "
        "10 to 50 deg high, rims whole in the image with a semi-minor axis of at least 12 px): the median "
        f"semi-minor axes are {sizes}. Only the part of the image around the rim is rendered; its pixels are "
        "those of the whole. As printed: an ellipse fitted to Canny edges near the rim; corrected: the blind "
        f"detector; efficient, and ours: measured from a predicted pose. Found were {shares}; the other rims "
        f"are left out. Below 50 km ours are {ranges[0]} times the paper's A, B and C (10 % to 90 % "
        f"quantile) and {ranges[1]} times its D, E and F; with the same rims moved to the optical axis "
        f"{ranges[2]} and {ranges[3]} times. From 50 to 40 km the paper's A, B and C change by factors of "
        f"{steps[:3].min():.3g} to {steps[:3].max():.3g}, its D, E and F by {steps[3:].min():.2g} to "
        f"{steps[3:].max():.2g}. The paper's filter takes Qn from its table as a diagonal matrix; the six "
        "errors of one rim have a singular covariance, as an ellipse has five degrees of freedom."
    )
