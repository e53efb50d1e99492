"""`brink bench`: all measurements."""

import typer

from brink.cli.benchmarks import methods, service

bench = typer.Typer(help="Measure this installation, each figure with its target.", no_args_is_help=True)


for command in (*methods.COMMANDS, *service.COMMANDS):
    bench.command()(command)
