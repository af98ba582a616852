"""Figures of the benchmarks, drawn anew from their results whenever the site is built."""

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
RESULTS, FIGURES = ROOT / "benchmarks" / "results", ROOT / "docs" / "_figures"
OURS, THEIRS, GREY = "#1f6f78", "#d98943", "#777777"


def _level_of_detail(tables, figure):
    """Time over triangles and over samples; and per view, beside pymartini."""
    left, middle, right = figure.subplots(1, 3)
    rows = tables["growth"]
    of_one = [row for row in rows if not row["raster"].startswith("fractal")]
    left.loglog([row["triangles"] for row in of_one], [row["ms"] for row in of_one], "o-", c=OURS)
    left.set(xlabel="triangles of the view", ylabel="ms", title=of_one[0]["raster"])
    sides = [row for row in rows if row["raster"].startswith("fractal")]
    names = [row["raster"].removeprefix("fractal ") for row in sides]
    middle.bar(names, [row["ms"] for row in sides], color=OURS)
    middle.set(xlabel="samples", title=f"{sides[0]['triangles']:,} triangles")
    views = tables["pymartini"]
    places = range(len(views))
    right.bar([place - 0.2 for place in places], [row["ms"] for row in views], 0.4, color=OURS)
    theirs = [row["its ms"] for row in views]
    right.bar([place + 0.2 for place in places], theirs, 0.4, color=THEIRS)
    right.set(yscale="log", xlabel="view", title="as good on the screen: rtin, pymartini")
    right.set_xticks(list(places), [row["view"] for row in views])


def _coarsening(tables, figure):
    """Milliseconds of rtin and two peers, for three tolerances."""
    by_threshold, by_error = tables.values()
    left, right = figure.subplots(1, 2, sharey=True)
    _bars(left, by_threshold, "ε/range", {"rtin ms": OURS, "martini ms": THEIRS})
    left.set(ylabel="ms", xlabel="threshold, of the heights' range", title="the same vertices")
    _bars(right, by_error, "ε/range", {"rtin ms": OURS, "martini ms": THEIRS, "delatin ms": GREY})
    right.set(
        xlabel="largest error, of the heights' range", title="max_error, beside what peers call so"
    )


def _refinement(tables, figure):
    """How many times as long as rtin the peers take."""
    (rows,) = tables.values()
    cases = {f"{row['mesh']}, {row['targets']}": [] for row in rows}
    for row in rows:
        cases[f"{row['mesh']}, {row['targets']}"].append(row)
    for ax, (case, those) in zip(
        figure.subplots(1, len(cases), sharey=True), cases.items(), strict=True
    ):
        ax.bar([row["peer"] for row in those], [row["of cpu"] for row in those], color=THEIRS)
        ax.axhline(1.0, color=OURS)
        ax.set(yscale="log", title=case)
    figure.axes[0].set_ylabel("processor time, rtin = 1")


def _bars(ax, rows, label, colours):
    width = 0.8 / len(colours)
    for i, (name, colour) in enumerate(colours.items()):
        places = [place + (i + 0.5) * width - 0.4 for place in range(len(rows))]
        ax.bar(
            places, [row[name] for row in rows], width, color=colour, label=name.removesuffix(" ms")
        )
    ax.set_xticks(range(len(rows)), [row[label] for row in rows])
    ax.set_yscale("log")
    ax.legend(frameon=False)


DRAWN_BY = {
    "level_of_detail": _level_of_detail,
    "coarsening": _coarsening,
    "refinement": _refinement,
}


def _draw_all(app, config):
    from matplotlib.figure import Figure

    FIGURES.mkdir(exist_ok=True)
    for name, draw in DRAWN_BY.items():
        tables = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        draw(tables, figure)
        for ax in figure.axes:
            ax.spines[["top", "right"]].set_visible(False)
            ax.title.set_fontsize(10)
        figure.savefig(FIGURES / f"{name}.svg")


def setup(app):
    app.connect("config-inited", _draw_all)
    return {"parallel_read_safe": True}
