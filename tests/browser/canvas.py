"""What a canvas shows, and that it shows something else."""

from playwright.sync_api import Locator


def picture(canvas: Locator) -> str:
    """Return what a canvas shows."""
    found: str = canvas.evaluate("canvas => canvas.toDataURL()")
    return found


def becomes(canvas: Locator, wanted: str) -> None:
    """Wait until a canvas shows what it did before."""
    canvas.page.wait_for_function(
        "([canvas, wanted]) => canvas.toDataURL() === wanted", arg=[canvas.element_handle(), wanted]
    )


def changes(canvas: Locator, before: str) -> str:
    """Wait until a canvas shows something else, and return it."""
    canvas.page.wait_for_function(
        "([canvas, before]) => canvas.toDataURL() !== before", arg=[canvas.element_handle(), before]
    )
    return picture(canvas)
