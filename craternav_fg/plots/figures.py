"""Figures of a run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure, SubFigure
from scipy.stats import chi2

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray
from craternav_fg.ellipse import points_on
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.trajectory import Trajectory

FloatArray = npt.NDArray[np.float64]

# Okabe and Ito's colours, and two of Tol's for what is run on request, told apart by most eyes; the same
# estimator has the same colour everywhere.
COLOURS = {
    "smoother": "#0072B2",
    "gnc_smoother": "#F0E442",
    "calibrating_smoother": "#332288",
    "mapping_smoother": "#882255",
    "online": "#56B4E9",
    "fixed_lag": "#CC79A7",
    "ekf": "#009E73",
    "ekf_paper": "#E69F00",
    "centre_smoother": "#D55E00",
    "dead_reckoning": "#7F7F7F",
}
# Of what is no estimator of ours.
OTHER = "#8C510A"
# Well started, the one equals the EKF, without wrong matches the other the smoother: dashed and above, both
# are seen.
DASHED = {"online", "gnc_smoother"}


def draw_errors(trajectories: Mapping[str, Trajectory], truth: Trajectory, rims: Sequence[int]) -> Figure:
    """Position, velocity and attitude error of every estimator, and the rims per frame, over time."""
    series = {}
    for name, trajectory in trajectories.items():
        e = errors(trajectory, truth)
        parts = (e.position_m, e.velocity_m_s, np.degrees(e.attitude_rad))
        series[name] = [np.linalg.norm(part, axis=1) for part in parts]
    return _draw_series(series, "error", truth.stamps_ns, rims)


def draw_sigmas(trajectories: Mapping[str, Trajectory], rims: Sequence[int]) -> Figure:
    """Show what every estimator believes its errors are: without truth, all there is to see."""
    series = {}
    for name, t in trajectories.items():
        if t.pose_covariance is None or t.velocity_covariance is None:
            continue
        parts = (t.pose_covariance[:, 3:, 3:], t.velocity_covariance, t.pose_covariance[:, :3, :3])
        values = [np.sqrt(np.trace(part, axis1=1, axis2=2)) for part in parts]
        series[name] = [values[0], values[1], np.degrees(values[2])]
    return _draw_series(series, "sigma", next(iter(trajectories.values())).stamps_ns, rims)


def _draw_series(
    series: Mapping[str, Sequence[FloatArray]],
    what: str,
    stamps_ns: npt.NDArray[np.int64],
    rims: Sequence[int],
) -> Figure:
    """Draw position (m), velocity (m/s) and attitude (deg) series, and the rims per frame."""
    figure = Figure(figsize=(9, 10), layout="constrained")
    *panels, count = figure.subplots(4, 1, sharex=True, height_ratios=[3, 3, 3, 1])
    t = _seconds(stamps_ns)
    for name, values in series.items():
        for axes, value in zip(panels, values, strict=True):
            axes.semilogy(t, value, **style(name), label=name)
    for axes, label in zip(panels, ("position {}, m", "velocity {}, m/s", "attitude {}, deg"), strict=True):
        axes.set_ylabel(label.format(what))
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=6, loc="outside upper center", fontsize=9)
    count.step(t, rims, where="mid", color="k", lw=1.2)
    count.set_ylabel("rims")
    count.set_ylim(bottom=0)
    count.set_xlabel("time, s")
    for axes in (*panels, count):
        axes.grid(alpha=0.3)
        axes.margins(x=0.01)
    return figure


def draw_consistency(trajectories: Mapping[str, Trajectory], truth: Trajectory) -> Figure:
    """Pose NEES of every estimator over time, beside the interval in which an honest one stays."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    low, high = (float(chi2.ppf(p, 6)) for p in (0.025, 0.975))
    axes.axhspan(low, high, color="k", alpha=0.1, label="95 % of honest NEES (6 dof)")
    for name, trajectory in trajectories.items():
        if trajectory.pose_covariance is None:
            continue
        values = nees(errors(trajectory, truth).pose, trajectory.pose_covariance)
        label = f"{name} (mean {values.mean():.3g})"
        axes.semilogy(_seconds(trajectory.stamps_ns), values, **style(name), label=label)
    axes.set_xlabel("time, s")
    axes.set_ylabel("NEES of the pose")
    axes.grid(alpha=0.3)
    axes.margins(x=0.01)
    axes.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def draw_bounds(name: str, trajectory: Trajectory, truth: Trajectory) -> Figure:
    """Each component of an estimator's pose error with its 3-sigma bounds; position in east, north, up."""
    e = errors(trajectory, truth)
    assert trajectory.pose_covariance is not None
    lat, lon = frames.latitude_longitude(truth.gP)
    eRg = np.swapaxes(frames.east_north_up(lat, lon), 1, 2)
    position = np.einsum("kij,kj->ki", eRg, e.position_m)
    S = eRg @ trajectory.pose_covariance[:, 3:, 3:] @ np.swapaxes(eRg, 1, 2)
    position_sigma = np.sqrt(np.einsum("kii->ki", S))
    attitude = np.degrees(e.attitude_rad)
    attitude_sigma = np.degrees(np.sqrt(np.einsum("kii->ki", trajectory.pose_covariance[:, :3, :3])))
    figure = Figure(figsize=(9, 6), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    t = _seconds(e.stamps_ns)
    for i in range(3):
        labels = (f"{('east', 'north', 'up')[i]}, m", f"{'xyz'[i]} in b, deg")
        for axes, value, sigma, label in zip(
            grid[i], (position, attitude), (position_sigma, attitude_sigma), labels, strict=True
        ):
            axes.fill_between(t, -3 * sigma[:, i], 3 * sigma[:, i], color=COLOURS.get(name, OTHER), alpha=0.2)
            axes.plot(t, value[:, i], color=COLOURS.get(name, OTHER), lw=1.3)
            limit = 1.15 * max(np.percentile(3 * sigma[:, i], 95), np.abs(value[:, i]).max())
            axes.set_ylim(-limit, limit)
            axes.set_ylabel(label)
            axes.grid(alpha=0.3)
            axes.margins(x=0.01)
    grid[0, 0].set_title(f"{name}: position error and 3 sigma")
    grid[0, 1].set_title("attitude error and 3 sigma")
    for axes in grid[2]:
        axes.set_xlabel("time, s")
    return figure


def draw_descent(trajectory: Trajectory, truth: Trajectory | None, catalog: Catalog, body: Body) -> Figure:
    """Ground track over the crater map, and altitude against downrange."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1])
    lines = [("estimate", trajectory.gP, COLOURS["smoother"], "-")]
    if truth is not None:
        lines.append(("truth", truth.gP, "k", ":"))
    # Great circle through both ends: downrange along it, crossrange to its left.
    first, last = (P / np.linalg.norm(P) for P in (trajectory.gP[0], trajectory.gP[-1]))
    pole = np.cross(first, last)
    if np.linalg.norm(pole) < 1e-9:
        # Straight down: any direction will do.
        pole = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    pole /= np.linalg.norm(pole)
    ahead = np.cross(pole, first)

    def ranges_km(P: FloatArray) -> tuple[FloatArray, FloatArray]:
        unit = P / np.linalg.norm(P, axis=-1, keepdims=True)
        radius_km = body.radius_m / 1e3
        return radius_km * np.arctan2(unit @ ahead, unit @ first), radius_km * np.arcsin(unit @ pole)

    for label, P, colour, style in lines:
        x, y = ranges_km(P)
        below.plot(x, y, style, color=colour, label=label)
        above.plot(x, body.altitude_m(P) / 1e3, style, color=colour, label=label)
    altitude_km = float(body.altitude_m(trajectory.gP[0])) / 1e3
    left, right = below.get_xlim()
    if right - left < 0.5 * altitude_km:
        middle = 0.5 * (left + right)
        left, right = middle - 0.25 * altitude_km, middle + 0.25 * altitude_km
    # Flat enough for the panel: equal scales leave its width, which it shares, as it is.
    reach = min(0.14 * (right - left), 0.5 * altitude_km)
    farthest = 1e3 * (max(-left, right) + reach) / body.radius_m
    craters = catalog.take(np.sort(catalog.index.near(first, farthest)))
    x, y = ranges_km(craters.centres)
    near = (x > left) & (x < right) & (np.abs(y) < reach)
    # Downrange and crossrange components of the major axes.
    local = x[:, None] / (body.radius_m / 1e3)
    forward = np.cos(local) * ahead - np.sin(local) * first
    major = craters.gRl[:, :, 0]
    angle = np.degrees(np.arctan2(major @ pole, np.einsum("ni,ni->n", major, forward)))
    below.add_collection(
        EllipseCollection(
            2e-3 * craters.semi_major_m[near],
            2e-3 * craters.semi_minor_m[near],
            angle[near],
            units="xy",
            offsets=np.stack([x, y], axis=-1)[near],
            transOffset=below.transData,
            facecolors="none",
            edgecolors="0.6",
            linewidths=0.6,
        )
    )
    below.set_ylim(-reach, reach)
    below.set_xlim(left, right)
    below.set_aspect("equal", adjustable="box")
    below.set_xlabel("downrange, km")
    below.set_ylabel("crossrange, km")
    above.set_ylabel("altitude, km")
    above.legend(frameon=False)
    for axes in (above, below):
        axes.grid(alpha=0.3)
    return figure


def draw_rims(axes: Axes, image: ImageArray, frame: FrameMeasurement, camera: Camera) -> None:
    """Draw a frame's image with its measured rims and the direction towards the sun."""
    axes.imshow(image, cmap="gray", vmin=0, vmax=camera.full_scale)
    rims = camera.pixels(points_on(frame.rims.chart, 90))
    for rim in np.concatenate([rims, rims[:, :1]], axis=1):
        axes.plot(*rim.T, color="#F0E442", lw=1.0)
    if frame.sun is not None:
        length = 0.07 * camera.width_px
        x, y = camera.pixels(frame.sun.point)
        dx, dy = length * np.cos(frame.sun.tilt_rad), length * np.sin(frame.sun.tilt_rad)
        axes.annotate(
            "", (x + dx, y + dy), (x, y), arrowprops={"arrowstyle": "->", "color": "#D55E00", "lw": 1.5}
        )
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])


def draw_overview(
    images: Sequence[tuple[ImageArray, FrameMeasurement]],
    trajectories: Mapping[str, Trajectory],
    truth: Trajectory | None,
    camera: Camera,
    body: Body,
) -> Figure:
    """Show a run at a glance: some frames with their rims above every estimator's position error.

    Without truth: above the position's standard deviation.
    """
    figure = Figure(figsize=(10, 7.3), layout="constrained")
    top: SubFigure
    bottom: SubFigure
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.15, 1.1], squeeze=False)[:, 0]
    top.suptitle("measured rims (yellow) and the direction towards the sun (arrow)", fontsize=10)
    first = next(iter(trajectories.values()))
    altitude_km = dict(zip(first.stamps_ns.tolist(), body.altitude_m(first.gP) / 1e3, strict=True))
    for axes, (image, frame) in zip(top.subplots(1, len(images), squeeze=False)[0], images, strict=True):
        draw_rims(axes, image, frame, camera)
        rims = "rim" if len(frame.rims) == 1 else "rims"
        axes.set_title(f"{altitude_km[frame.stamp_ns]:.0f} km, {len(frame.rims)} {rims}", fontsize=10)
    axes = bottom.subplots()
    for name, trajectory in trajectories.items():
        if truth is not None:
            value = np.linalg.norm(errors(trajectory, truth).position_m, axis=1)
        elif trajectory.pose_covariance is not None:
            value = np.sqrt(np.trace(trajectory.pose_covariance[:, 3:, 3:], axis1=1, axis2=2))
        else:
            continue
        axes.semilogy(_seconds(trajectory.stamps_ns), value, **style(name), label=name)
    axes.set_xlabel("time, s")
    axes.set_ylabel("position sigma, m" if truth is None else "position error, m")
    axes.grid(alpha=0.3)
    axes.margins(x=0.01)
    axes.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write a figure as PNG."""
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)


def style(name: str) -> dict[str, Any]:
    """Colour, dash and order of an estimator's line, the same in all figures."""
    dashed = name in DASHED
    return {"color": COLOURS.get(name, OTHER), "ls": "--" if dashed else "-", "zorder": 3 if dashed else 2}


def _seconds(stamps_ns: npt.NDArray[np.int64]) -> FloatArray:
    return (stamps_ns - stamps_ns[0]) * 1e-9
