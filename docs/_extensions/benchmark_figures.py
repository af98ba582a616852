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


DRAWN_BY = {"level_of_detail": _level_of_detail}


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
