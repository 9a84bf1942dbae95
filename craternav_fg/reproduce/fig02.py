"""Fig. 2: how far the centre of a crater's image lies off the image of its centre."""

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from craternav_fg.reproduce import line_plots
from craternav_fg.reproduce.edge_points import matched
from craternav_fg.reproduce.results import Reproduction, Row, verdict
from craternav_fg.resection.paper.equations import PaperRims
from craternav_fg.simulation.flat_scenes import CAMERA, FlatScene, flat_axes, ground_point, tilted_camera
from factors.kernels import conic

FloatArray = npt.NDArray[np.float64]

TILTS_DEG = (5, 10, 15, 20, 25, 30)
# In radii.
ALTITUDES = (50, 40, 30, 20, 15, 10, 7, 5)


def boresight_scene(altitude: float, tilt_rad: float) -> FlatScene:
    """Put a circle of radius 1 on the optical axis of a tilted camera."""
    gTc = tilted_camera(altitude, tilt_rad)
    centre = ground_point(gTc, np.zeros(2))[None]
    axes = flat_axes(1.0, 1.0, 0.0)[None]
    charts, _ = conic.project_rims(gTc, np.eye(4), centre, axes)
    return FlatScene(gTc, centre, axes, charts)


def deviations_deg(scene: FlatScene) -> FloatArray:
    """Angles (n,) between the image ellipses' centres and the craters' centres."""
    true = (scene.centres - scene.gTc[:3, 3]) @ scene.gTc[:3, :3]
    image = np.column_stack([scene.charts[:, :2], np.ones(len(scene.charts))])
    return _angles_deg(image, true)


def printed_deviations_deg(scene: FlatScene) -> FloatArray:
    """Compute the same (n,) from the image conics and the plane's normal alone, eqs. (4) and (9)."""
    seen = PaperRims(matched(scene, scene.charts, np.repeat(np.eye(5)[None], len(scene.charts), 0)).rims)
    return _angles_deg(seen.image_centres, seen.true_centres(scene.gTc[:3, :3]))


def closed_form_deg(altitude: float, tilt_rad: float) -> float:
    """First order in the crater's angular size: (r / rho)^2 sin i cos i, rho = h / cos i."""
    return float(np.degrees((np.cos(tilt_rad) / altitude) ** 2 * np.sin(tilt_rad) * np.cos(tilt_rad)))


def _angles_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, np.sum(a * b, axis=1))))


def fig02() -> Reproduction:
    """Line-of-sight deviation over altitude and angle of incidence, crater on the optical axis."""
    records = []
    rows = []
    for tilt in TILTS_DEG:
        for altitude in ALTITUDES:
            scene = boresight_scene(altitude, np.deg2rad(tilt))
            exact = float(deviations_deg(scene)[0])
            printed = float(printed_deviations_deg(scene)[0])
            records.append(
                {
                    "incidence_deg": float(tilt),
                    "altitude_radii": float(altitude),
                    "as_printed_deg": printed,
                    "deviation_deg": exact,
                    "closed_form_deg": closed_form_deg(altitude, np.deg2rad(tilt)),
                }
            )
            rows.append(
                Row(
                    "fig02",
                    "deviation of the line of sight",
                    f"i = {tilt} deg, h = {altitude} r",
                    "deg",
                    as_printed=printed,
                    corrected=exact,
                    verdict=verdict(None, exact, None),
                    headline=altitude in (50, 15, 5),
                )
            )
    values = np.array([r["deviation_deg"] for r in records]).reshape(len(TILTS_DEG), len(ALTITUDES))
    closed = np.array([r["closed_form_deg"] for r in records]).reshape(values.shape)
    pixel_deg = float(np.degrees(1.0 / CAMERA.fx_px))
    highest = max(h for h, value in zip(ALTITUDES, values[-1], strict=True) if value > pixel_deg)
    by_tilt, by_altitude = ((np.diff(values, axis=axis) > 0.0).all() for axis in (0, 1))
    note = (
        "The paper's text prints no number of this figure. Eqs. (4) and (9) as printed give the deviation "
        "of the projected rim exactly. What the paper says of it holds: it "
        f"{'grows' if by_tilt else 'does not grow'} with the angle of incidence and "
        f"{'grows' if by_altitude else 'does not grow'} as the camera comes down, up to {values.max():.2f} "
        "deg at i = 30 deg, h = 5 r. The closed form (r/rho)^2 sin i cos i, rho = h / cos i, is within "
        f"{100.0 * np.abs(closed / values - 1.0).max():.1f} %. A pixel of the paper's camera is "
        f"{pixel_deg:.3f} deg: at i = 30 deg the deviation exceeds it from {highest} r downwards. This is "
        "one crater on the optical axis; the paper averages three in the image, which see other angles."
    )
    return Reproduction(
        "fig02",
        "Deviation of the line of sight to a crater's centre over the altitude",
        rows,
        note,
        line_plots.draw_deviation(np.array(TILTS_DEG), np.array(ALTITUDES), values, pixel_deg),
        pa.Table.from_pylist(records),
    )
