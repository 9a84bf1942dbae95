"""Interactive charts of a run, as Plotly draws them: traces and axes as plain data."""

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from scipy.special import chdtri

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.catalogs.model import Catalog
from craternav_fg.evaluation.metrics import errors, nees
from craternav_fg.plots.ground_track import GroundTrack
from craternav_fg.plots.style import colour, line_style
from craternav_fg.plots.trajectories import error_components
from craternav_fg.reports.crater_map import near_track, outlines
from craternav_fg.reports.page import Chart
from craternav_fg.reports.residuals import DOF, MIN_CHI2_PER_DOF, rejected
from craternav_fg.reports.svg import identifier
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# Replaced by the page's own colours, which are others in the dark.
INK, SOFT = "ink", "soft"
TIME_TITLE = "time, s"
TRUTH = "truth"
# Of craters in a map: the largest near the track, each with so many points.
_MAX_CRATERS, _RIM_POINTS = 400, 24
# Craters within this multiple of the highest altitude from the track are in a map.
_REACH_ALTITUDES = 2.0
# Plotly's, by matplotlib's.
DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"}
_GAP = 0.04


def short(values: Iterable[Any], digits: int = 6) -> list[float | None]:
    """Round numbers for a page; those that are none become null.

    Parameters
    ----------
    values : iterable of float
    digits : int
        That are kept.

    Returns
    -------
    list of float or None
    """
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float)]


def line(x: Iterable[Any], y: Iterable[Any], name: str, axis: int = 1, **more: Any) -> dict[str, Any]:
    """Make a trace of an estimator.

    Parameters
    ----------
    x, y : iterable of float
    name : str
        Name of the series: the buttons of the page show and hide it.
    axis : int
        Which of the panels.
    more : object
        Further attributes of the trace.

    Returns
    -------
    dict
    """
    known = {TRUTH: (INK, "dot")}
    hue, dash = known.get(name, (colour(name), DASHES[line_style(name)["ls"]]))
    return {
        "type": "scatter",
        "mode": "lines",
        # Plotly reads tags in a name.
        "name": html.escape(name),
        "meta": identifier(name),
        "x": short(x),
        "y": short(y),
        "yaxis": "y" if axis == 1 else f"y{axis}",
        "line": {"color": hue, "dash": dash, "width": 1.8},
        **more,
    }


def panels(titles: Sequence[str], heights: Sequence[float], *, logarithmic: bool) -> dict[str, Any]:
    """Lay out panels below one another on one axis of time.

    Parameters
    ----------
    titles : sequence of str
        Titles of the vertical axes, from the top.
    heights : sequence of float
        Relative.
    logarithmic : bool
        Whether the vertical axes are.

    Returns
    -------
    dict
    """
    inner = (1.0 - _GAP * (len(titles) - 1)) / sum(heights)
    top = 1.0
    layout: dict[str, Any] = {}
    for k, (title, height) in enumerate(zip(titles, heights, strict=True)):
        bottom = top - height * inner
        axis: dict[str, Any] = {
            "title": {"text": title},
            "domain": [max(round(bottom, 4), 0.0), round(top, 4)],
        }
        if logarithmic:
            axis |= {"type": "log", "exponentformat": "power", "dtick": 1}
        layout[f"yaxis{k + 1 if k else ''}"] = axis
        top = bottom - _GAP
    last = "y" if len(titles) == 1 else f"y{len(titles)}"
    layout["xaxis"] = {"title": {"text": TIME_TITLE}, "anchor": last}
    return layout


def seconds(trajectory: Trajectory) -> FloatArray:
    """Compute the times since the first frame.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    ndarray, shape (k,)
        In s.
    """
    return np.asarray((trajectory.stamps_ns - trajectory.stamps_ns[0]) * 1e-9)


def error_chart(trajectories: Mapping[str, Trajectory], truth: Trajectory, rims: Sequence[int]) -> Chart:
    """Draw the norms of the errors over time.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
    truth : Trajectory
    rims : sequence of int
        In each frame.

    Returns
    -------
    Chart
    """
    series = {}
    for name, trajectory in trajectories.items():
        e = errors(trajectory, truth)
        parts = (e.position_m, e.velocity_m_s, np.degrees(e.attitude_rad))
        series[name] = [np.linalg.norm(part, axis=1) for part in parts]
    caption = "Norms of the errors, and number of rims in each frame."
    return _series(series, truth, rims, "errors", "error", caption)


def sigma_chart(trajectories: Mapping[str, Trajectory], rims: Sequence[int]) -> Chart:
    """Draw the standard deviations that each estimator claims over time.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        Those without covariances are left out.
    rims : sequence of int
        In each frame.

    Returns
    -------
    Chart
    """
    series = {}
    for name, t in trajectories.items():
        if t.pose_covariance is None or t.velocity_covariance is None:
            continue
        parts = (t.pose_covariance[:, 3:, 3:], t.velocity_covariance, t.pose_covariance[:, :3, :3])
        values = [np.sqrt(np.trace(part, axis1=1, axis2=2)) for part in parts]
        series[name] = [values[0], values[1], np.degrees(values[2])]
    first = next(iter(trajectories.values()))
    caption = "Standard deviations that each estimator claims, and the number of rims in each frame."
    return _series(series, first, rims, "sigmas", "sigma", caption)


def _series(
    series: Mapping[str, Sequence[FloatArray]],
    at: Trajectory,
    rims: Sequence[int],
    identifier: str,
    what: str,
    caption: str,
) -> Chart:
    t = seconds(at)
    units = ("m", "m/s", "deg")
    traces = []
    for name, values in series.items():
        for k, (value, unit) in enumerate(zip(values, units, strict=True)):
            hover = f"%{{x:.4g}} s: %{{y:.3g}} {unit}"
            traces.append(line(t, value, name, k + 1, hovertemplate=hover))
    step = {"color": INK, "width": 1.5, "shape": "hvh"}
    traces.append(line(t, rims, "rims", 4, line=step, meta="", hovertemplate="%{x:.4g} s: %{y} rims"))
    titles = [f"position {what}, m", f"velocity {what}, m/s", f"attitude {what}, deg", "rims"]
    layout = panels(titles, [3, 3, 3, 1], logarithmic=True)
    layout["yaxis4"] = {**layout["yaxis4"], "type": "linear", "dtick": None, "rangemode": "tozero"}
    return Chart(identifier, {"data": traces, "layout": layout, "time": True}, 760, caption)


def bounds_chart(name: str, trajectory: Trajectory, truth: Trajectory) -> Chart:
    """Draw each component of the pose errors of an estimator with 3 sigma.

    Parameters
    ----------
    name : str
    trajectory : Trajectory
        With pose covariances.
    truth : Trajectory

    Returns
    -------
    Chart
    """
    t = seconds(trajectory)
    labels = [f"{axis}, m" for axis in ("east", "north", "up")] + [f"{axis} in b, deg" for axis in "xyz"]
    traces = []
    parts = error_components(trajectory, truth)
    for k in range(6):
        error, sigma = (part[:, k % 3] for part in parts[k // 3])
        thin = {"color": colour(name), "width": 0.5}
        band = {"line": thin, "hoverinfo": "skip", "meta": ""}
        traces.append(line(t, 3.0 * sigma, name, k + 1, **band))
        traces.append(line(t, -3.0 * sigma, name, k + 1, fill="tonexty", **band))
        hover = "%{x:.4g} s: %{y:.3g}"
        traces.append(line(t, error, name, k + 1, meta="", hovertemplate=hover))
    layout = panels(labels, [1] * 6, logarithmic=False)
    spec = {"data": traces, "layout": layout, "time": True}
    return Chart(f"bounds-{identifier(name)}", spec, 900, f"{name}: error (line) and 3 sigma (band).")


def consistency_chart(trajectories: Mapping[str, Trajectory], truth: Trajectory) -> Chart:
    """Draw the NEES of the pose over time.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
    truth : Trajectory

    Returns
    -------
    Chart
    """
    low, high = (float(chdtri(6, p)) for p in (0.975, 0.025))
    traces = []
    for name, trajectory in trajectories.items():
        if trajectory.pose_covariance is not None:
            values = nees(errors(trajectory, truth).pose, trajectory.pose_covariance)
            traces.append(line(seconds(trajectory), values, name, hovertemplate="%{x:.4g} s: %{y:.3g}"))
    layout = panels(["NEES of the pose"], [1], logarithmic=True)
    band = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": low, "y1": high, "line": {"width": 0}}
    layout["shapes"] = [{**band, "fillcolor": SOFT, "opacity": 0.18, "layer": "below"}]
    caption = (
        "NEES of the pose, e' S⁻¹ e, at each frame. For a consistent estimator, the mean is 6 and 95 % of "
        f"the values lie in the grey band, {low:.1f} to {high:.1f}. Errors are correlated between frames, so "
        "values may leave the band for many frames in a row."
    )
    return Chart("consistency", {"data": traces, "layout": layout, "time": True}, 380, caption)


def residual_chart(residuals: pa.Table, first_stamp_ns: int, name: str) -> Chart:
    """Draw the chi-square per degree of freedom of an estimator's rims over time.

    Parameters
    ----------
    residuals : pyarrow.Table
        Rows of one estimator in residuals.parquet, at least one.
    first_stamp_ns : int
        Zero of the time axis.
    name : str
        Name of the estimator.

    Returns
    -------
    Chart
    """
    t = (residuals["stamp_ns"].to_numpy() - first_stamp_ns) * 1e-9
    values = np.maximum(residuals["chi2"].to_numpy() / DOF, MIN_CHI2_PER_DOF)
    craters = np.array(residuals["crater_id"].to_pylist(), dtype=object)
    out = rejected(residuals)
    traces = []
    for label, mask, symbol, hue in (
        ("matches kept", ~out, "circle", colour("smoother")),
        ("matches rejected", out, "x", colour("centre_smoother")),
    ):
        more: dict[str, Any] = {
            "mode": "markers",
            "meta": "",
            "marker": {"symbol": symbol, "size": 5, "color": hue},
        }
        hover = "%{text}: %{y:.3g} at %{x:.4g} s"
        text = [html.escape(one) for one in craters[mask].tolist()]
        traces.append(line(t[mask], values[mask], label, text=text, hovertemplate=hover, **more))
    layout = panels([f"χ² / {DOF} of a rim"], [1], logarithmic=True)
    mean = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1}
    layout["shapes"] = [{**mean, "line": {"color": SOFT, "width": 1}}]
    caption = (
        f"χ² per degree of freedom of each rim at the poses of {name}: 1 on average if the covariances are "
        "consistent, less if few rims determine the pose. Crosses: matches rejected as outliers."
    )
    return Chart("residuals-chart", {"data": traces, "layout": layout, "time": True}, 340, caption)


def track_chart(
    trajectories: Mapping[str, Trajectory], truth: Trajectory | None, catalog: Catalog, body: Body
) -> Chart:
    """Draw altitude and ground track over the crater map.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
    truth : Trajectory or None
    catalog : Catalog
    body : Body

    Returns
    -------
    Chart
    """
    first = next(iter(trajectories.values()))
    track = GroundTrack.along(first.gP, body)
    along, across = track.ranges_km(first.gP)
    pad = 0.05 * max(float(np.ptp(along)), 1e-3 * float(body.altitude_m(first.gP[0])))
    left, right = along.min() - pad, along.max() + pad
    x, y = track.ranges_km(_rims(catalog, first, body))
    middle, half = x.mean(axis=1), 0.5 * float(np.ptp(x, axis=1).max(initial=0.0))
    rows, places = track.in_span(middle, (left - half, right + half))
    traces = [_outlines(x[rows] + (places - middle[rows])[:, None], y[rows])]
    for name, trajectory in _with(trajectories, truth).items():
        downrange, crossrange = track.ranges_km(trajectory.gP)
        altitude = body.altitude_m(trajectory.gP) / 1e3
        traces.append(line(downrange, altitude, name, 1, hovertemplate="%{x:.4g} km: %{y:.4g} km high"))
        traces.append(line(downrange, crossrange, name, 2, hovertemplate="%{x:.4g}, %{y:.4g} km"))
    altitude = body.altitude_m(first.gP) / 1e3
    follow = []
    for axis, values in ((1, altitude), (2, across)):
        follow.append({"trace": len(traces), "x": short(along), "y": short(values)})
        traces.append({**line([], [], "cursor", axis, mode="markers", meta=""), "marker": _CURSOR})
    layout = panels(["altitude, km", "crossrange, km"], [1, 1], logarithmic=False)
    layout["xaxis"]["title"] = {"text": "downrange, km"}
    layout["xaxis"]["range"] = short([left, right])
    layout["yaxis"]["rangemode"] = "tozero"
    reach = max(1.2 * float(np.abs(across).max()), 0.12 * float(np.ptp(along)), 0.3 * float(altitude.max()))
    layout["yaxis2"]["range"] = short([-reach, reach])
    caption = "Altitude and ground track over the catalogue's craters. The marker is at the slider's time."
    return Chart("track", {"data": traces, "layout": layout, "follow": follow}, 520, caption)


def scene_chart(
    trajectories: Mapping[str, Trajectory], truth: Trajectory | None, catalog: Catalog, body: Body
) -> Chart:
    """Draw the trajectories over the crater map in three dimensions.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
    truth : Trajectory or None
    catalog : Catalog
    body : Body

    Returns
    -------
    Chart
        In local level axes at the first estimate's ground point, km.
    """
    first = next(iter(trajectories.values()))
    lat, lon = frames.latitude_longitude(first.gP[0])
    gRe = frames.east_north_up(lat, lon)
    gO = first.gP[0] * (body.radius_m / np.linalg.norm(first.gP[0]))

    def local_km(gP: FloatArray) -> FloatArray:
        return np.asarray(1e-3 * (gP - gO) @ gRe)

    rims = np.moveaxis(local_km(_rims(catalog, first, body)), -1, 0)
    traces = [_in_space(_outlines(rims[0], rims[1]), rims[2])]
    for name, trajectory in _with(trajectories, truth).items():
        x, y, z = local_km(trajectory.gP).T
        traces.append({**_in_space(line(x, y, name), z), "hovertemplate": "%{x:.4g}, %{y:.4g}, %{z:.4g} km"})
    x, y, z = local_km(first.gP).T
    follow = [{"trace": len(traces), "x": short(x), "y": short(y), "z": short(z)}]
    traces.append({**_in_space(line([], [], "cursor", mode="markers", meta=""), []), "marker": _CURSOR})
    axes = {
        f"{axis}axis": {"title": {"text": f"{title}, km"}}
        for axis, title in zip("xyz", ("east", "north", "up"), strict=True)
    }
    # Far enough that no axis title is cut off.
    camera = {"eye": {"x": 1.45, "y": 1.45, "z": 1.2}}
    layout = {"scene": {**axes, "aspectmode": "data", "camera": camera}}
    caption = (
        "Drag to rotate, scroll or pinch to zoom. The origin is the ground point below the first estimate."
    )
    return Chart("scene", {"data": traces, "layout": layout, "follow": follow}, 520, caption)


_CURSOR = {"size": 9, "color": INK, "symbol": "circle"}


def _with(trajectories: Mapping[str, Trajectory], truth: Trajectory | None) -> dict[str, Trajectory]:
    return dict(trajectories) if truth is None else {**trajectories, TRUTH: truth}


def _in_space(trace: dict[str, Any], z: Iterable[Any]) -> dict[str, Any]:
    """Move a trace into three dimensions."""
    flat = {key: value for key, value in trace.items() if key != "yaxis"}
    return {**flat, "type": "scatter3d", "z": _broken(z) if np.ndim(np.asarray(z)) == 2 else short(z)}


def _outlines(x: FloatArray, y: FloatArray) -> dict[str, Any]:
    """One trace of all rims, with a gap after each."""
    trace = line([], [], "craters", 2, meta="", hoverinfo="skip")
    return {**trace, "x": _broken(x), "y": _broken(y), "line": {"color": SOFT, "width": 1}}


def _broken(values: Any) -> list[float | None]:
    """Join rows (n, points) to one list, with a gap after each."""
    rows = np.concatenate([values, np.full((len(values), 1), np.nan)], axis=1)
    return short(rows.ravel(), 5)


def _rims(catalog: Catalog, first: Trajectory, body: Body) -> FloatArray:
    """Return closed outlines (n, points, 3), in g, m, of the largest craters near a trajectory."""
    rows = near_track(catalog, first, body, _REACH_ALTITUDES)
    rows = rows[np.argsort(-catalog.semi_major_m[rows], kind="stable")[:_MAX_CRATERS]]
    return outlines(catalog, rows, _RIM_POINTS + 1)
