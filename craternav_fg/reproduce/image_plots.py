"""Plots of rims found in images: errors by method, Canny edges, and the figures of the front end."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from craternav_fg.ellipse import chart_of_axes, points_on
from craternav_fg.reproduce.results import Row
from craternav_fg.reproduce.rim_methods import BLIND, CANNY, GUIDED
from factors.arrays import FloatArray

# Label, colour (Okabe and Ito's) and marker of each method.
STYLE = {
    CANNY: ("Canny edges", "#D55E00", "s"),
    BLIND: ("blind detector", "#009E73", "o"),
    GUIDED: ("from a predicted pose", "#0072B2", "v"),
}
# The column of a row in which each method stands.
_COLUMN = {CANNY: "as_printed", BLIND: "corrected", GUIDED: "efficient"}
_PAPER = {"color": "k", "marker": "*", "ls": ""}
# Errors of zero have no place on a logarithmic axis.
_SMALLEST_PX = 1e-3


def draw_rim_errors(
    errors: Mapping[str, Mapping[str, FloatArray]],
    paper: Mapping[str, Sequence[tuple[float, float]]],
) -> Figure:
    """Draw table 1: distributions of absolute errors by group and method, and the paper's numbers.

    Parameters
    ----------
    errors : mapping of str to mapping of str to ndarray, shape (3, n)
        By group and method: of the centre and the semi-axes, px.
    paper : mapping of str to sequence of tuple of float
        By group: average and maximum of the same, px.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    panels = figure.subplots(1, len(errors), sharey=True)
    for axes, (group, methods) in zip(panels, errors.items(), strict=True):
        for place, (method, values) in enumerate(methods.items()):
            _, colour, _ = STYLE[method]
            kept = [np.maximum(row, _SMALLEST_PX) for row in values if len(row)]
            if not kept:
                continue
            boxes = axes.boxplot(
                kept, positions=np.arange(len(kept)) + 0.25 * (place - 1.0), widths=0.18,
                whis=(5, 95), showfliers=False, patch_artist=True, manage_ticks=False,
            )  # fmt: skip
            for box in boxes["boxes"]:
                box.set(facecolor=colour, edgecolor=colour, alpha=0.55)
            for part in ("whiskers", "caps", "medians"):
                for line in boxes[part]:
                    line.set(color="k" if part == "medians" else colour, lw=1.2)
        for k, (average, maximum) in enumerate(paper[group]):
            axes.plot(k, average, "*", color="k", ms=12, zorder=5)
            axes.plot(k, maximum, "_", color="k", ms=16, mew=1.5, zorder=5)
        count = max((values.shape[1] for values in methods.values()), default=0)
        axes.set_title(f"{group} shapes, up to {count} rims found", fontsize=10)
        axes.set_xticks(range(3), ["centre", "semi-major axis", "semi-minor axis"])
        axes.set_yscale("log")
        axes.grid(alpha=0.3, axis="y")
    panels[0].set_ylabel("absolute error, px")
    handles = [
        Line2D([], [], color=colour, lw=7, alpha=0.55, label=label) for label, colour, _ in STYLE.values()
    ]
    handles += [
        Line2D([], [], ms=11, label="paper, average", **_PAPER),  # type: ignore[arg-type]
        Line2D([], [], color="k", marker="_", ls="", ms=12, mew=1.5, label="paper, maximum"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    figure.suptitle("boxes: quartiles, whiskers: 5 to 95 %", fontsize=9)
    return figure


def draw_coefficients(
    paper: Mapping[int, Sequence[float]], deviations: Mapping[str, FloatArray], noise: FloatArray
) -> Figure:
    """Draw table 2: standard deviations of the coefficients A to F over the altitude.

    Parameters
    ----------
    paper : mapping of int to sequence of float
        The paper's, by altitude, km.
    deviations : mapping of str to ndarray, shape (altitudes, 6)
        Ours by method, dimensionless.
    noise : ndarray, shape (6,)
        The paper's Qn as standard deviations, dimensionless.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(9.5, 5.6), layout="constrained")
    altitudes = np.array(list(paper), dtype=np.float64)
    printed = np.array(list(paper.values()))
    for k, axes in enumerate(figure.subplots(2, 3, sharex=True).flat):
        for method, values in deviations.items():
            label, colour, marker = STYLE[method]
            axes.semilogy(altitudes, values[:, k], f"{marker}-", color=colour, ms=5, lw=1.4, label=label)
        axes.semilogy(altitudes, printed[:, k], "*", color="k", ms=10, label="paper, table 2")
        axes.axhline(noise[k], color="0.4", ls="--", lw=1.0, label="paper, Qn")
        axes.set_title("ABCDEF"[k], fontsize=11)
        axes.grid(alpha=0.3)
        if k >= 3:
            axes.set_xlabel("altitude, km")
        if k % 3 == 0:
            axes.set_ylabel("standard deviation")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    return figure


def draw_edges(
    image: npt.NDArray[np.uint8],
    edges: npt.NDArray[np.bool_],
    true_px: FloatArray,
    guided_px: FloatArray,
    canny_px: FloatArray,
) -> Figure:
    """Draw fig. 10: an image with true and measured rims, and its Canny edges with the fitted ellipses.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W)
    edges : ndarray of bool, shape (H, W)
    true_px, guided_px, canny_px : ndarray, shape (n, 5)
        Rims: centre, semi-axes and angle, px and rad.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(image, cmap="gray", vmin=0, vmax=255)
    # Edges of one pixel vanish when the figure is scaled down.
    wide = cv2.dilate(edges.astype(np.uint8), np.ones((2, 2), dtype=np.uint8))
    right.imshow(1 - wide, cmap="gray", vmin=0, vmax=1)
    canny_colour = STYLE[CANNY][1]
    _ellipses(left, true_px, color="#56B4E9", lw=2.4, alpha=0.75)
    _ellipses(left, guided_px, color="#F0E442", lw=1.2)
    _ellipses(right, canny_px, color=canny_colour, lw=1.2, ls=(0, (3, 3)))
    for axes in (left, right):
        axes.set(xticks=[], yticks=[], xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5))
    left.set_title("rendered image, rims from a predicted pose", fontsize=10)
    right.set_title("Canny edges, ellipses fitted to them", fontsize=10)
    handles = [
        Line2D([], [], color=colour, lw=width, ls=line, label=label)
        for colour, width, line, label in (
            ("#56B4E9", 2.4, "-", "true rim"),
            ("#F0E442", 1.4, "-", "measured"),
            (canny_colour, 1.4, "--", "ellipse through Canny edges"),
        )
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, facecolor="0.25", edgecolor="none",
        framealpha=1.0, labelcolor="w",
    )  # fmt: skip
    return figure


def _ellipses(axes: Axes, ellipses_px: FloatArray, **style: object) -> None:
    for outline in points_on(chart_of_axes(ellipses_px), 180):
        axes.plot(*np.concatenate([outline, outline[:1]]).T, **style)  # type: ignore[arg-type]


def draw_rows(rows: Sequence[Row]) -> Figure:
    """Draw the numbers of rows by method beside the paper's, a panel for each unit.

    Parameters
    ----------
    rows : sequence of Row
        See `image_row`.

    Returns
    -------
    Figure
    """
    units = dict.fromkeys(row.unit for row in rows)
    groups = [[row for row in rows if row.unit == unit] for unit in units]
    figure = Figure(figsize=(8.5, 0.27 * len(rows) + 0.8 * len(groups)), layout="constrained")
    panels = figure.subplots(len(groups), 1, height_ratios=[len(group) for group in groups], squeeze=False)
    for axes, unit, group in zip(panels[:, 0], units, groups, strict=True):
        for place, row in enumerate(group):
            if row.paper is not None:
                axes.plot(row.paper, place, ms=11, clip_on=False, **_PAPER)
            for method, (_, colour, marker) in STYLE.items():
                value = getattr(row, _COLUMN[method])
                if value is not None:
                    axes.plot(value, place, marker, color=colour, ms=6, clip_on=False)
        axes.set_yticks(range(len(group)), [f"{row.quantity}: {row.condition}" for row in group], fontsize=8)
        axes.set_ylim(len(group) - 0.5, -0.5)
        axes.set_xlim(left=0.0)
        axes.set_xlabel({"1": "share, ratio or number"}.get(unit, unit))
        axes.grid(alpha=0.3, axis="x")
    handles = [
        Line2D([], [], color=colour, marker=marker, ls="", label=label)
        for label, colour, marker in STYLE.values()
    ]
    handles.append(Line2D([], [], ms=11, label="paper", **_PAPER))  # type: ignore[arg-type]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure
