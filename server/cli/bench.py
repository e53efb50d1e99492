"""`brink bench`: measurements, each with its target beside it."""

import typer

bench = typer.Typer(help="Measure this installation, each figure with its target.", no_args_is_help=True)
