"""Reproduce figures of the paper into a folder.

reproduction.json   every number: a list of rows {figure, quantity, condition, unit, paper, as_printed,
                    corrected, efficient, bound, verdict}
reproduction.md     the same for reading: tables, drawings and a paragraph on each figure
NAME.png            drawings: figNN, tableN, front_end, lag, ablation, rim_models
NAME.parquet        the trials behind them
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

import craternav_fg
from craternav_fg.errors import CraternavError
from craternav_fg.plots.style import save
from craternav_fg.reproduce import (
    fig03_04,
    fig11_14,
    fig11_14_trials,
    fig15_18,
    fig15_18_trials,
    table1_trials,
    table2_trials,
)
from craternav_fg.reproduce.ablation import ablation
from craternav_fg.reproduce.fig02 import fig02
from craternav_fg.reproduce.fig10 import fig10
from craternav_fg.reproduce.front_end import front_end
from craternav_fg.reproduce.lag import lag
from craternav_fg.reproduce.options import ReproduceOptions
from craternav_fg.reproduce.pool import Progress
from craternav_fg.reproduce.results import NUMBERS, Reproduction, number
from craternav_fg.reproduce.rim_models import rim_models
from craternav_fg.reproduce.table1 import TABLE1, table1
from craternav_fg.reproduce.table2 import table2

DESCENTS = ("fig15", "fig16", "fig17", "fig18")
FIGURES = (
    "fig02", "fig03", "fig04", "table1", "fig10", "table2", "fig11", "fig12", "fig13", "fig14", *DESCENTS,
    "front_end",
)  # fmt: skip
# Not figures of the paper, and not part of "all".
OTHERS = ("lag", "ablation", "rim_models")
MARKER = "reproduction.json"
CONTENTS = (MARKER, "reproduction.md", *(f"{name}.*" for name in (*FIGURES, *OTHERS)))


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """Return the figures of some names, "all" included, in the paper's order.

    Raises
    ------
    CraternavError
        For an unknown name.
    """
    for name in names:
        if name not in (*FIGURES, *OTHERS, "all"):
            expected = ", ".join((*FIGURES, *OTHERS))
            raise CraternavError(f"unknown figure {name!r}: expected {expected} or all")
    of_paper = tuple(name for name in FIGURES if name in names or "all" in names)
    # What a measurement of rims keeps is an ablation, too.
    also = {*names, *(("rim_models",) if "ablation" in names else ())}
    return of_paper + tuple(name for name in OTHERS if name in also)


def reproduce(
    names: Sequence[str], options: ReproduceOptions, progress: Progress | None = None
) -> list[Reproduction]:
    """Reproduce figures; figures with common trials run them once.

    Parameters
    ----------
    names : sequence of str
        Names from `FIGURES` and `OTHERS`.
    options : ReproduceOptions
    progress : callable, optional

    Returns
    -------
    list of Reproduction
    """
    out = []
    if "fig02" in names:
        out.append(fig02())
    if {"fig03", "fig04"} & set(names):
        data = fig03_04.simulate(options, progress)
        out += [figure(data) for figure in (fig03_04.fig03, fig03_04.fig04) if figure.__name__ in names]
    if "table2" in names:
        out.append(table2(table2_trials.simulate(options, progress), options))
    if "fig10" in names:
        out.append(fig10(options))
    if {"table1", "front_end"} & set(names):
        kinds = table1_trials.KINDS if "front_end" in names else tuple(TABLE1)
        measured = table1_trials.simulate(options, kinds, progress)
        out += [table1(measured)] if "table1" in names else []
        out += [front_end(measured, options)] if "front_end" in names else []
    three: pa.Table | None = None
    if {"fig11", "fig12"} & set(names):
        three = fig11_14_trials.simulate(options, options.craters, progress=progress)
        out += [fig11_14.draw_up(name, three, options) for name in ("fig11", "fig12") if name in names]
    if {"fig13", "fig14"} & set(names):
        two = fig11_14_trials.simulate(options, 2, fig11_14.fine_conditions(options), progress)
        compared = three if options.craters == 3 else None
        out += [
            fig11_14.draw_up(name, two, options, compared) for name in ("fig13", "fig14") if name in names
        ]
    if set(DESCENTS) & set(names):
        trials = fig15_18_trials.simulate(options, progress)
        out += [fig15_18.draw_up(name, trials) for name in DESCENTS if name in names]
    if "lag" in names:
        out.append(lag(options, progress))
    if "ablation" in names:
        out.append(ablation(options, progress))
    if "rim_models" in names:
        out.append(rim_models(options, progress))
    return sorted(out, key=lambda result: (*FIGURES, *OTHERS).index(result.name))


def write(folder: Path, results: Sequence[Reproduction], options: ReproduceOptions) -> None:
    """Write reproduced figures into an existing folder."""
    rows = [row.as_dict() for result in results for row in result.rows]
    for result in results:
        save(result.drawing, folder / f"{result.name}.png")
        pq.write_table(result.data, folder / f"{result.name}.parquet")
    (folder / "reproduction.md").write_text(_report(results, options), encoding="utf-8")
    (folder / MARKER).write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _report(results: Sequence[Reproduction], options: ReproduceOptions) -> str:
    set_up = ", ".join(f"{name} {value}" for name, value in asdict(options).items() if name != "workers")
    lines = [
        "# Figures of Tian et al. (2019), reproduced",
        "",
        f"craternav_fg {craternav_fg.__version__}; {set_up}.",
        "",
        "As printed: the paper's equations as they are; corrected: with their errors corrected; efficient: "
        "the maximum-likelihood solver; bound: an estimator that attains the Cramér-Rao bound, in the same "
        "statistic. reproduction.json has all rows.",
        "",
        "In figs. 2 to 14 the paper's methods are started at the truth, the efficient solver without a "
        "start: "
        "the errors are those of the equations, without those of a poor start.",
        "",
        "Tables 1 and 2, fig. 10 and the front end are measured in rendered images. There as printed stands "
        "for Canny edges, the paper's method, corrected for the blind detector, and efficient for rims "
        "measured from "
        "a predicted pose.",
    ]
    for result in results:
        lines += [
            "",
            f"## {result.name}: {result.title}",
            "",
            result.note,
            "",
            f"![{result.title}]({result.name}.png)",
            "",
        ]
        head = ("quantity", "condition", "unit", *(name.replace("_", " ") for name in NUMBERS), "verdict")
        lines += [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
        for row in result.rows:
            if row.headline:
                numbers = [number(getattr(row, name)) for name in NUMBERS]
                lines.append(
                    f"| {' | '.join((row.quantity, row.condition, row.unit, *numbers, row.verdict))} |"
                )
    return "\n".join(lines) + "\n"
