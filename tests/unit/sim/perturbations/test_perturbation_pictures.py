"""Contact sheets, picture files, and the drawn street."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_street import draw_street
from perturbed_pictures import blocks

from brink.sim.perturbations import InvalidFrame
from brink.sim.perturbations.pictures import read_picture, write_picture


def test_the_street_is_reproducible_in_any_size() -> None:
    assert np.array_equal(draw_street(), draw_street())
    assert draw_street().shape == (720, 1280, 3)
    assert draw_street(90).shape == (90, 160, 3)
    assert len(np.unique(draw_street())) > 200


def test_a_picture_survives_its_file(tmp_path: Path) -> None:
    picture = blocks(60)
    write_picture(picture, tmp_path / "a.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), picture)


def test_transparent_and_grey_files_become_rgb(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "rgba.png"), np.full((20, 20, 4), (10, 20, 30, 0), dtype=np.uint8))
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((20, 20), 7, dtype=np.uint8))
    assert read_picture(tmp_path / "rgba.png")[0, 0].tolist() == [30, 20, 10]
    assert read_picture(tmp_path / "grey.png")[0, 0].tolist() == [7, 7, 7]


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n cut off"])
def test_files_that_are_not_pictures_are_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "a.png"
    file.write_bytes(content)
    with pytest.raises(InvalidFrame, match=r"a\.png: expected an image \(PNG"):
        read_picture(file)


def test_a_picture_that_is_too_small_is_refused_by_name(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "dot.png"), np.zeros((4, 4, 3), dtype=np.uint8))
    with pytest.raises(InvalidFrame, match=r"dot\.png: expected an RGB image: .* at least 16 px a side"):
        read_picture(tmp_path / "dot.png")


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidFrame, match=r"a\.xyz: cannot be written as \.xyz"):
        write_picture(blocks(60), tmp_path / "a.xyz")
