"""Drawings of what the front end does with images."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

FloatArray = npt.NDArray[np.float64]

# Okabe and Ito's.
STYLE = {
    "canny": ("Canny edges", "#D55E00", "s"),
    "blind": ("blind detector", "#009E73", "o"),
    "guided": ("from a predicted pose", "#0072B2", "v"),
}
_TURN = np.linspace(0.0, 2.0 * np.pi, 181)


def draw_rim_errors(
    errors: Mapping[str, Mapping[str, FloatArray]],
    paper: Mapping[str, Sequence[tuple[float, float]]],
) -> Figure:
    """Table 1: distributions of absolute errors (3, n), px, by group and way, and the paper's average."""
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    panels = figure.subplots(1, len(errors), sharey=True)
    for axes, (group, ways) in zip(panels, errors.items(), strict=True):
        for place, (way, values) in enumerate(ways.items()):
            _, colour, _ = STYLE[way]
            kept = [np.maximum(row, 1e-3) for row in values if len(row)]
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
        for k, (average, most) in enumerate(paper[group]):
            axes.plot(k, average, "*", color="k", ms=12, zorder=5)
            axes.plot(k, most, "_", color="k", ms=16, mew=1.5, zorder=5)
        count = max((values.shape[1] for values in ways.values()), default=0)
        axes.set_title(f"{group} shapes, up to {count} rims found", fontsize=10)
        axes.set_xticks(range(3), ["centre", "semi-major axis", "semi-minor axis"])
        axes.set_yscale("log")
        axes.grid(alpha=0.3, axis="y")
    panels[0].set_ylabel("absolute error, px")
    handles = [
        Line2D([], [], color=colour, lw=7, alpha=0.55, label=label) for label, colour, _ in STYLE.values()
    ]
    handles += [
        Line2D([], [], color="k", marker="*", ls="", ms=11, label="paper, average"),
        Line2D([], [], color="k", marker="_", ls="", ms=12, mew=1.5, label="paper, maximum"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    figure.suptitle("boxes: quartiles, whiskers: 5 to 95 %", fontsize=9)
    return figure


def draw_coefficients(
    paper: Mapping[int, Sequence[float]], deviations: Mapping[str, FloatArray], noise: FloatArray
) -> Figure:
    """Table 2: standard deviations (altitudes, 6) of A to F over the altitude, the paper's, and its Qn."""
    figure = Figure(figsize=(9.5, 5.6), layout="constrained")
    altitudes = np.array(list(paper), dtype=np.float64)
    printed = np.array(list(paper.values()))
    for k, axes in enumerate(figure.subplots(2, 3, sharex=True).flat):
        for way, values in deviations.items():
            label, colour, marker = STYLE[way]
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
    ways: Mapping[str, FloatArray],
) -> Figure:
    """Fig. 10: an image with the rims (n, 5) that each way finds, and its Canny edges."""
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(image, cmap="gray", vmin=0, vmax=255)
    # Wide enough to be seen on a page.
    wide = cv2.dilate(edges.astype(np.uint8), np.ones((2, 2), dtype=np.uint8))
    right.imshow(1 - wide, cmap="gray", vmin=0, vmax=1)
    for axes, names in ((left, ("guided",)), (right, ("canny",))):
        if axes is left:
            for ellipse in true_px:
                _ellipse(axes, ellipse, color="#56B4E9", lw=2.4, alpha=0.75)
        for way in names:
            style = {"color": "#F0E442"} if way == "guided" else {"color": STYLE[way][1], "ls": (0, (3, 3))}
            for ellipse in ways[way]:
                _ellipse(axes, ellipse, lw=1.2, **style)
        axes.set(xticks=[], yticks=[], xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5))
    left.set_title("rendered image, rims from a predicted pose", fontsize=10)
    right.set_title("Canny edges, ellipses fitted to them", fontsize=10)
    handles = [
        Line2D([], [], color=colour, lw=width, ls=line, label=label)
        for colour, width, line, label in (
            ("#56B4E9", 2.4, "-", "true rim"),
            ("#F0E442", 1.4, "-", "measured"),
            (STYLE["canny"][1], 1.4, "--", "ellipse through Canny edges"),
        )
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3, facecolor="0.25", edgecolor="none",
        framealpha=1.0, labelcolor="w",
    )  # fmt: skip
    return figure


def _ellipse(axes: Axes, ellipse: FloatArray, **style: object) -> None:
    x, y, a, b, angle = ellipse
    u, v = a * np.cos(_TURN), b * np.sin(_TURN)
    c, s = np.cos(angle), np.sin(angle)
    axes.plot(x + c * u - s * v, y + s * u + c * v, **style)  # type: ignore[arg-type]


def draw_limits(labels: Sequence[str], shares: FloatArray, holds: npt.NDArray[np.bool_]) -> Figure:
    """Draw figures over their limits: below 1 they hold."""
    figure = Figure(figsize=(8.5, 0.27 * len(labels) + 1.4), layout="constrained")
    axes = figure.subplots()
    place = np.arange(len(labels))
    colours = np.where(holds, "#0072B2", "#D55E00")
    axes.hlines(place, 0.0, shares, color=colours, lw=2.0)
    for marker, which, label in (("o", holds, "holds"), ("X", ~holds, "missed")):
        if which.any():
            colour = "#0072B2" if label == "holds" else "#D55E00"
            axes.plot(shares[which], place[which], marker, color=colour, ms=7, label=label)
    axes.axvline(1.0, color="k", lw=1.2)
    axes.set_yticks(place, labels, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0.0, max(1.3, 1.05 * float(shares.max())))
    axes.set_xlabel("figure over its limit (of a share: what is missing over what may be)")
    axes.grid(alpha=0.3, axis="x")
    axes.legend(frameon=False, loc="lower right")
    return figure
