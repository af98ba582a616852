"""The command line: parse, call, print. Heavy imports wait until a command needs them."""

from __future__ import annotations

import signal
import sys
from typing import Annotated

import typer

from rtin._commands._console import give_up, interrupt
from rtin._commands.coarsen import coarsen, demo
from rtin._commands.compare import compare
from rtin._commands.info import info, plot
from rtin._commands.refine import refine
from rtin._commands.study import study_accuracy, study_propagation
from rtin._commands.tiles import serve, tiles
from rtin._commands.view import view
from rtin._version import __version__

__all__ = ["app", "main"]

app = typer.Typer(
    help="Adaptive triangle meshes from elevation rasters, with a guaranteed vertical error.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

for command in (coarsen, refine, info, plot, compare, tiles, serve, view, demo):
    app.command()(command)

study = typer.Typer(help="Measure what the paper says.", no_args_is_help=True)
app.add_typer(study, name="study")
study.command("propagation")(study_propagation)
study.command("accuracy")(study_accuracy)


def main() -> None:
    """Run the ``rtin`` program."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    try:
        app()
    except OSError as error:  # of the help text itself: no space is left for it
        give_up(error)
        sys.exit(1)


@app.callback(invoke_without_command=True)
def _program(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)
    ] = False,
) -> None:
    if version:
        print(f"rtin {__version__}")
        raise typer.Exit
