"""`brink perturbations`: the catalogue of image perturbations, and their effect on an image."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from brink.api.terminal import echo
from brink.cli.options import AsJson, check_out, console, plain_table, print_json
from brink.extras import install_command
from brink.server.errors import FieldError, InvalidInput, nearest

if TYPE_CHECKING:
    from brink.sim.perturbations.catalogue import Gene

perturbations = typer.Typer(
    help="List image perturbations, and show their effect on an image.", no_args_is_help=True
)

MANY_GENES = 6
"""This many genes are shown two to a row, so that the sheet fits on a page."""


@perturbations.command("list")
def list_genes(as_json: AsJson = False) -> None:
    """List the genes with their effects and their levels, from weakest to strongest.

    Example: brink perturbations list
    """
    from brink.sim.perturbations.catalogue import CATALOGUE

    if as_json:
        print_json([_as_json(gene) for gene in CATALOGUE.values()])
        return
    rows = [(one.name, str(one.levels), _values(one), one.unit, one.effect) for one in CATALOGUE.values()]
    table = plain_table("gene", "levels", "values", "unit", "effect", right=("levels",), rows=rows)
    for column in table.columns:
        column.overflow = "fold"
    screen = console()
    screen.print(table)
    levels = sum(gene.levels for gene in CATALOGUE.values())
    screen.print(f"{len(CATALOGUE)} genes, {levels} levels; level 0 of each has no effect")


def _as_json(gene: "Gene") -> dict[str, Any]:
    return {
        "gene": gene.name,
        "levels": gene.levels,
        "values": [None, *gene.values],
        "unit": gene.unit,
        "effect": gene.effect,
    }


def _values(gene: "Gene") -> str:
    """Return all levels' values as text if there are at most five, otherwise the first two and the last."""
    shown = [f"{value:g}" for value in gene.values]
    return ", ".join(shown) if len(shown) <= 5 else f"{shown[0]}, {shown[1]} … {shown[-1]}"


@perturbations.command()
def show(
    out: Annotated[Path, typer.Option(help="File to write: .png or .jpg.")],
    image: Annotated[
        Path | None,
        typer.Option(help="Image to perturb (default: a street of the simulator).", show_default=False),
    ] = None,
    gene: Annotated[
        list[str] | None,
        typer.Option(help="Gene to show; may be repeated (default: all genes).", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random perturbations.")] = 0,
    tile_width: Annotated[int, typer.Option(min=80, max=1920, help="Width of a tile in pixels.")] = 320,
) -> None:
    """Draw a contact sheet of an image perturbed by each gene at its lowest, middle and highest level.

    Example: brink perturbations show --image street.jpg --out sheet.png --gene rain --gene smoke
    """
    from brink.sim.perturbations.catalogue import VisionMissing

    genes = _genes(gene)
    check_out(out, ".png", ".jpg", ".jpeg")
    if image is not None and not image.is_file():
        raise InvalidInput.at("--image", f"{image}: {'not a file' if image.exists() else 'no such file'}")
    if find_spec("cv2") is None:
        raise VisionMissing(f"drawing images needs OpenCV; install it with: {install_command('vision')}")
    # Imported here: it loads OpenCV, which is optional.
    from brink.sim.aeb.dataset import example_picture
    from brink.sim.perturbations.pictures import contact_sheet, read_picture, write_picture

    picture = example_picture() if image is None else read_picture(image)
    genes_per_row = 2 if len(genes) >= MANY_GENES else 1
    sheet = contact_sheet(picture, genes, seed=seed, tile_width=tile_width, genes_per_row=genes_per_row)
    write_picture(sheet, out)
    echo(out)


def _genes(names: list[str] | None) -> "list[Gene]":
    """Return the named genes in the given order without repetitions; all genes if none is named.

    Raises:
        InvalidInput: A gene is unknown.
    """
    from brink.sim.perturbations.catalogue import CATALOGUE

    unknown = [
        FieldError(
            pointer="--gene",
            message=f"unknown perturbation {name!r}; list all with: brink perturbations list",
            nearest=nearest(name, CATALOGUE),
        )
        for name in names or ()
        if name not in CATALOGUE
    ]
    if unknown:
        raise InvalidInput(unknown)
    return [CATALOGUE[name] for name in dict.fromkeys(names or CATALOGUE)]
