"""Figures become files that are whole, of the asked formats, and the same each time."""

import threading
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import pytest
from PIL import Image
from synthetic_campaign import mtq_campaign

from brink.plots import FIGURES, write_campaign_figures
from brink.plots.style import WIDTH_PX


def test_every_figure_is_written_in_every_format(tmp_path: Path) -> None:
    files = write_campaign_figures(mtq_campaign(120), tmp_path / "new" / "folder", formats=("png", "svg"))
    assert [path.name for path in files] == [f"{stem}.{kind}" for stem in FIGURES for kind in ("png", "svg")]
    for path in files:
        if path.suffix == ".png":
            with Image.open(path) as image:
                image.load()
                assert image.width == WIDTH_PX
        else:
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_same_campaign_gives_the_same_pictures_and_changes_nothing_global(tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    first = write_campaign_figures(mtq_campaign(120), tmp_path / "a")
    second = write_campaign_figures(mtq_campaign(120), tmp_path / "b")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert dict(mpl.rcParams) == before


def test_figures_can_be_drawn_in_threads(tmp_path: Path) -> None:
    inputs = mtq_campaign(60)
    threads = [
        threading.Thread(target=write_campaign_figures, args=(inputs, tmp_path / str(index)))
        for index in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    one, other = (sorted((tmp_path / str(index)).iterdir()) for index in range(2))
    assert len(one) == len(FIGURES)
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_unknown_format_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"formats: expected some of png, svg; got 'pdf'"):
        write_campaign_figures(mtq_campaign(60), tmp_path / "out", formats=("pdf",))
    assert not (tmp_path / "out").exists()
