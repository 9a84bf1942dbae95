"""Figures of a run: errors and standard deviations over time, consistency, ground track, overview."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure, SubFigure
from scipy.special import chdtri

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.catalogs.model import Catalog
from craternav_fg.dataset.images import ImageArray
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.measurements import FrameMeasurement
from craternav_fg.plots.ground_track import GroundTrack
from craternav_fg.plots.overlays import draw_rims
from craternav_fg.plots.style import colour, finish, line_styles, seconds_since_first
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray


def draw_errors(trajectories: Mapping[str, Trajectory], truth: Trajectory, rims: Sequence[int]) -> Figure:
    """Draw position, velocity and attitude error of every estimator, and the rims per frame, over time.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By estimator.
    truth : Trajectory
        Ground truth at the same stamps.
    rims : sequence of int
        Number of measured rims in each frame.

    Returns
    -------
    Figure
    """
    series = {}
    for name, trajectory in trajectories.items():
        e = errors(trajectory, truth)
        parts = (e.position_m, e.velocity_m_s, np.degrees(e.attitude_rad))
        series[name] = [np.linalg.norm(part, axis=1) for part in parts]
    return _draw_series(series, "error", truth.stamps_ns, rims)


def draw_sigmas(trajectories: Mapping[str, Trajectory], rims: Sequence[int]) -> Figure:
    """Draw the standard deviations that every estimator claims, and the rims per frame, over time.

    Estimators without covariances are left out.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By estimator.
    rims : sequence of int
        Number of measured rims in each frame.

    Returns
    -------
    Figure
    """
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
    t = seconds_since_first(stamps_ns)
    styles = line_styles(series)
    for name, values in series.items():
        for axes, value in zip(panels, values, strict=True):
            axes.semilogy(t, value, **styles[name], label=name)
    for axes, label in zip(panels, ("position {}, m", "velocity {}, m/s", "attitude {}, deg"), strict=True):
        axes.set_ylabel(label.format(what))
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=6, loc="outside upper center", fontsize=9)
    count.step(t, rims, where="mid", color="k", lw=1.2)
    count.set_ylabel("rims")
    count.set_ylim(0, 1.1 * max(1, *rims))
    count.set_xlabel("time, s")
    for axes in (*panels, count):
        finish(axes)
    return figure


def draw_consistency(trajectories: Mapping[str, Trajectory], truth: Trajectory) -> Figure:
    """Draw the NEES of the pose of every estimator over time, with the 95 % interval of a consistent one.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By estimator.
    truth : Trajectory
        Ground truth at the same stamps.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    low, high = (float(chdtri(6, p)) for p in (0.975, 0.025))
    axes.axhspan(low, high, color="k", alpha=0.1, label="95 % interval, 6 dof")
    styles = line_styles(trajectories)
    for name, trajectory in trajectories.items():
        if trajectory.pose_covariance is None:
            continue
        values = nees(errors(trajectory, truth).pose, trajectory.pose_covariance)
        label = f"{name} (mean {values.mean():.3g})"
        axes.semilogy(seconds_since_first(trajectory.stamps_ns), values, **styles[name], label=label)
    axes.set_xlabel("time, s")
    axes.set_ylabel("NEES of the pose")
    finish(axes)
    axes.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def draw_bounds(trajectories: Mapping[str, Trajectory], truth: Trajectory) -> Figure:
    """Draw each component of the pose errors with their 3-sigma bounds; position in east, north, up.

    Estimators without covariances are left out.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By estimator.
    truth : Trajectory
        Ground truth at the same stamps.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9, 6), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    drawn = {name: t for name, t in trajectories.items() if t.pose_covariance is not None}
    styles = line_styles(drawn)
    largest = np.zeros((3, 2))
    for name, trajectory in drawn.items():
        t = seconds_since_first(trajectory.stamps_ns)
        for column, (error, sigma) in enumerate(error_components(trajectory, truth)):
            for i, axes in enumerate(grid[:, column]):
                bound = 3.0 * sigma[:, i]
                if len(drawn) == 1:
                    axes.fill_between(t, -bound, bound, color=styles[name]["color"], alpha=0.2)
                else:
                    # Bands on top of one another would mix their colours.
                    for edge in (-bound, bound):
                        axes.plot(t, edge, lw=0.8, alpha=0.6, **styles[name])
                axes.plot(t, error[:, i], lw=1.3, **styles[name], label=name)
                limit = max(np.percentile(bound, 95), np.abs(error[:, i]).max())
                largest[i, column] = max(largest[i, column], limit)
                axes.set_ylim(-1.15 * largest[i, column], 1.15 * largest[i, column])
    for i, (place, turn) in enumerate(grid):
        place.set_ylabel(f"{('east', 'north', 'up')[i]}, m")
        turn.set_ylabel(f"{'xyz'[i]} in b, deg")
        finish(place)
        finish(turn)
    only = f"{next(iter(drawn))}: " if len(drawn) == 1 else ""
    grid[0, 0].set_title(f"{only}position error and 3 sigma")
    grid[0, 1].set_title("attitude error and 3 sigma")
    for axes in grid[2]:
        axes.set_xlabel("time, s")
    if len(drawn) > 1:
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, ncols=6, loc="outside upper center", fontsize=9)
    return figure


def error_components(
    trajectory: Trajectory, truth: Trajectory
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Compute each component of the pose errors, with its standard deviation.

    Parameters
    ----------
    trajectory : Trajectory
        With pose covariances.
    truth : Trajectory
        At the same stamps.

    Returns
    -------
    position, position_sigma : ndarray, shape (k, 3)
        In east, north, up, m.
    attitude, attitude_sigma : ndarray, shape (k, 3)
        Rotation vectors in b, deg.
    """
    e = errors(trajectory, truth)
    S = trajectory.pose_covariance
    assert S is not None
    lat, lon = frames.latitude_longitude(truth.gP)
    eRg = np.swapaxes(frames.east_north_up(lat, lon), 1, 2)
    position = np.einsum("kij,kj->ki", eRg, e.position_m)
    position_sigma = np.sqrt(np.einsum("kij,kjl,kil->ki", eRg, S[:, 3:, 3:], eRg))
    attitude_sigma = np.degrees(np.sqrt(np.einsum("kii->ki", S[:, :3, :3])))
    return (position, position_sigma), (np.degrees(e.attitude_rad), attitude_sigma)


def draw_descent(trajectory: Trajectory, truth: Trajectory | None, catalog: Catalog, body: Body) -> Figure:
    """Draw altitude against downrange above the ground track on the crater map.

    Parameters
    ----------
    trajectory : Trajectory
    truth : Trajectory or None
    catalog : Catalog
    body : Body

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1])
    lines = [("estimate", trajectory.gP, colour("smoother"), "-")]
    if truth is not None:
        lines.append(("truth", truth.gP, "k", ":"))
    track = GroundTrack.along(trajectory.gP, body)
    for label, P, line_colour, dash in lines:
        x, y = track.ranges_km(P)
        below.plot(x, y, dash, color=line_colour, label=label)
        above.plot(x, body.altitude_m(P) / 1e3, dash, color=line_colour, label=label)
    altitude_km = float(body.altitude_m(trajectory.gP[0])) / 1e3
    left, right = below.get_xlim()
    if right - left < 0.5 * altitude_km:
        middle = 0.5 * (left + right)
        left, right = middle - 0.25 * altitude_km, middle + 0.25 * altitude_km
    # So flat that equal scales do not narrow the panel, whose width is shared.
    reach = min(0.14 * (right - left), 0.5 * altitude_km)
    _draw_craters(below, track, catalog, (left, right), reach)
    below.set_ylim(-reach, reach)
    below.set_xlim(left, right)
    below.set_aspect("equal", adjustable="box")
    below.set_xlabel("downrange, km")
    below.set_ylabel("crossrange, km")
    above.set_ylabel("altitude, km")
    above.legend(frameon=False)
    below.set_title("ground track and catalogued craters", fontsize="medium")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    return figure


def _draw_craters(
    axes: Axes, track: GroundTrack, catalog: Catalog, span_km: tuple[float, float], reach_km: float
) -> None:
    """Draw the craters whose centres lie within a span of downrange and a reach of crossrange."""
    left, right = span_km
    farthest_rad = min((max(-left, right) + reach_km) / track.radius_km, np.pi)
    craters = catalog.take(np.sort(catalog.index.near(track.first, farthest_rad)))
    x, y = track.ranges_km(craters.centres[:, None])
    rows, x = track.in_span(x[:, 0], span_km)
    low = np.abs(y[rows, 0]) < reach_km
    near, x, y = rows[low], x[low], y[rows[low], 0]
    axes.add_collection(
        EllipseCollection(
            2e-3 * craters.semi_major_m[near],
            2e-3 * craters.semi_minor_m[near],
            np.degrees(track.angles_rad(craters.gRl[near, :, 0], x)),
            units="xy",
            offsets=np.stack([x, y], axis=-1),
            transOffset=axes.transData,
            facecolors="none",
            edgecolors="0.6",
            linewidths=0.6,
        )
    )


def draw_overview(
    images: Sequence[tuple[ImageArray, FrameMeasurement]],
    trajectories: Mapping[str, Trajectory],
    truth: Trajectory | None,
    camera: Camera,
    body: Body,
) -> Figure:
    """Draw a run at a glance: some frames with their rims above every estimator's position error.

    Parameters
    ----------
    images : sequence of (ndarray, FrameMeasurement)
        Images, shape (H, W), in grey levels, with the rims and the sun measured in them.
    trajectories : mapping of str to Trajectory
        By estimator.
    truth : Trajectory or None
        None draws the standard deviation of the position instead of its error.
    camera : Camera
    body : Body

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(10, 7.3), layout="constrained")
    top: SubFigure
    bottom: SubFigure
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.15, 1.1], squeeze=False)[:, 0]
    top.suptitle("measured rims (yellow) and the direction towards the sun (arrow)", fontsize=10)
    first = next(iter(trajectories.values()))
    altitude_m = dict(zip(first.stamps_ns.tolist(), body.altitude_m(first.gP).tolist(), strict=True))
    for axes, (image, frame) in zip(top.subplots(1, len(images), squeeze=False)[0], images, strict=True):
        draw_rims(axes, image, frame, camera)
        rims = "rim" if len(frame.rims) == 1 else "rims"
        axes.set_title(f"{_length(altitude_m[frame.stamp_ns])}, {len(frame.rims)} {rims}", fontsize=10)
    axes = bottom.subplots()
    styles = line_styles(trajectories)
    for name, trajectory in trajectories.items():
        if truth is not None:
            value = np.linalg.norm(errors(trajectory, truth).position_m, axis=1)
        elif trajectory.pose_covariance is not None:
            value = np.sqrt(np.trace(trajectory.pose_covariance[:, 3:, 3:], axis1=1, axis2=2))
        else:
            continue
        axes.semilogy(seconds_since_first(trajectory.stamps_ns), value, **styles[name], label=name)
    axes.set_xlabel("time, s")
    axes.set_ylabel("position sigma, m" if truth is None else "position error, m")
    finish(axes)
    axes.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def _length(length_m: float) -> str:
    """Write a length with two digits or more: 25 m, 4.2 km, 50 km."""
    if abs(length_m) < 999.5:
        return f"{length_m:.0f} m" if abs(length_m) >= 9.95 else f"{length_m:.1f} m"
    return f"{1e-3 * length_m:.0f} km" if abs(length_m) >= 9950.0 else f"{1e-3 * length_m:.1f} km"
