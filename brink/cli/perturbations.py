"""`brink perturbations`: the catalogue of image perturbations, and what they do to a picture."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from brink.cli.options import AsJson, console, print_json
from brink.server.errors import FieldError, InvalidInput, nearest
from brink.sim.perturbations.catalogue import CATALOGUE, Gene, VisionMissing

perturbations = typer.Typer(help="List image perturbations, and show what they do.", no_args_is_help=True)

SUFFIXES = (".png", ".jpg", ".jpeg")


@perturbations.command("list")
def list_genes(as_json: AsJson = False) -> None:
    """List the genes: what each does, and its levels from weakest to strongest beside "no effect".

    Example: brink perturbations list
    """
    if as_json:
        print_json([_as_json(gene) for gene in CATALOGUE.values()])
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("gene", "levels", "values", "unit", "effect"):
        table.add_column(name, justify="right" if name == "levels" else "left", overflow="fold")
    for gene in CATALOGUE.values():
        table.add_row(gene.name, str(gene.levels), _values(gene), gene.unit, gene.effect)
    screen = console()
    screen.print(table)
    levels = sum(gene.levels for gene in CATALOGUE.values())
    screen.print(f'{len(CATALOGUE)} genes, {levels} levels; level 0 of each is "no effect"')


def _as_json(gene: Gene) -> dict[str, Any]:
    return {
        "gene": gene.name,
        "levels": gene.levels,
        "values": [None, *gene.values],
        "unit": gene.unit,
        "effect": gene.effect,
    }


def _values(gene: Gene) -> str:
    """Return few values in full, many by their ends."""
    shown = [f"{value:g}" for value in gene.values]
    return ", ".join(shown) if len(shown) <= 5 else f"{shown[0]}, {shown[1]} … {shown[-1]}"


@perturbations.command()
def show(
    out: Annotated[Path, typer.Option(help="File to write: .png or .jpg.")],
    image: Annotated[
        Path | None, typer.Option(help="Picture to perturb; a drawn street without it.", show_default=False)
    ] = None,
    gene: Annotated[
        list[str] | None,
        typer.Option(help="Gene to show; may be given again. All without it.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seeds the random fields.")] = 0,
    tile_width: Annotated[int, typer.Option(min=80, max=1920, help="Width of a tile in px.")] = 320,
) -> None:
    """Draw a contact sheet: each gene at its lowest, middle and highest level on a picture.

    Example: brink perturbations show --image street.jpg --out sheet.png --gene rain --gene smoke
    """
    genes = _genes(gene)
    if out.suffix.lower() not in SUFFIXES:
        message = f"{out}: expected a file name that ends in .png or .jpg"
        raise InvalidInput([FieldError(pointer="--out", message=message)])
    if not out.parent.is_dir():
        raise InvalidInput([FieldError(pointer="--out", message=f"{out.parent}: no such folder")])
    if image is not None and not image.is_file():
        message = f"{image}: {'not a file' if image.exists() else 'no such file'}"
        raise InvalidInput([FieldError(pointer="--image", message=message)])
    if find_spec("cv2") is None:
        raise VisionMissing(
            "drawing pictures needs OpenCV; install it with: "
            ".venv/bin/pip install -c constraints.txt -e '.[vision]'"
        )
    # Imported here: they load OpenCV, which a coordinator need not have.
    from brink.sim.perturbations.pictures import contact_sheet, draw_street, read_picture, write_picture

    picture = draw_street() if image is None else read_picture(image)
    write_picture(contact_sheet(picture, genes, seed=seed, tile_width=tile_width), out)
    typer.echo(out)


def _genes(names: list[str] | None) -> list[Gene]:
    """Return the named genes, each once, in the order given; all of them without a name.

    Raises:
        InvalidInput: There is no gene of a name.
    """
    unknown = [
        FieldError(
            pointer="--gene",
            message=f"unknown perturbation {name!r}; brink perturbations list shows all",
            nearest=nearest(name, CATALOGUE),
        )
        for name in names or ()
        if name not in CATALOGUE
    ]
    if unknown:
        raise InvalidInput(unknown)
    return [CATALOGUE[name] for name in dict.fromkeys(names or CATALOGUE)]
