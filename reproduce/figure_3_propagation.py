"""Fig. 3 and section 2.1.2 of the paper: how far refining one triangle propagates.

    python reproduce/figure_3_propagation.py [FOLDER] [--quick]

Prints our figures beside the paper's and draws four pictures: figure 3, histograms, the worst cases
and runs of up to a million refinements, which --quick leaves out. It does what `rtin study
propagation --long` does, and takes some ten minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rtin.studies import pictures, propagation


@contextmanager
def stage(name: str) -> Iterator[None]:
    print(f"{name} …", file=sys.stderr, flush=True)
    yield


def main(*arguments: str) -> None:
    folders = [Path(argument) for argument in arguments if not argument.startswith("--")]
    folder = folders[0] if folders else Path("figure-3")
    pictures.require_places(folder)
    study = propagation.measure(long="--quick" not in arguments, stage=stage)
    print(propagation.as_text(propagation.rows(study)))
    for path in pictures.write_pictures(study, folder):
        print(f"wrote {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
