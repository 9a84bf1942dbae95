"""Images in which people marked craters: their tables, and what is wrong in them."""

from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset.annotated_images import HRSC, NAC, annotated_images
from craternav_fg.errors import InputError


def marked(folder: Path, kind: str, content: bytes) -> list[tuple[str, np.ndarray]]:
    """Circles of a folder with one image, whose pixels nobody reads here."""
    image, table = {NAC: ("one.png", "one.txt"), HRSC: ("tile1.pgm", "1_gt.csv")}[kind]
    (folder / kind).mkdir(parents=True)
    (folder / kind / image).touch()
    (folder / kind / table).write_bytes(content)
    return [(one.kind, one.circles_px) for one in annotated_images(folder)]


def test_boxes_and_circles(tmp_path: Path) -> None:
    # Pixels count from the centre of the first one.
    ((kind, circles),) = marked(tmp_path, NAC, b"ID,X,Y,W,H,C_X,CY\n5,10.0,20.0,8.0,6.0,14.0,23.0\n")
    assert (kind, circles.tolist()) == ("nac", [[13.5, 22.5, 3.5]])
    ((kind, circles),) = marked(tmp_path / "b", HRSC, b"298.5,1178.5,5\n\n8,16,4.8\n")
    assert (kind, circles.tolist()) == ("hrsc", [[298.5, 1178.5, 2.5], [8.0, 16.0, 2.4]])


@pytest.mark.parametrize(
    ("kind", "content", "problem"),
    [
        (HRSC, b"1,2,3\n4,nan,6\n", "1_gt.csv:2: y: expected a finite number"),
        (HRSC, b"1,2,3\n4,5\n", "1_gt.csv:2: expected 3 columns, found 2"),
        (HRSC, b"1,2,3\n4,5,x\n", "1_gt.csv:2: diameter: expected a number, found 'x'"),
        (HRSC, b"1,2,3\n\xff,5,6\n", "expected text in UTF-8"),
        (NAC, b"ID,X,Y,W,H\n1,2,3,4,inf\n", "one.txt:2: H: expected a finite number"),
        (NAC, b"ID,X,Y,W,H\n1,2,3,4\n", "one.txt:2: expected 5 columns, found 4"),
        (NAC, b"ID,X,Y,W\n1,2,3,4\n", "one.txt:1: H: expected the columns X, Y, W, H"),
    ],
)
def test_wrong_tables_are_refused_by_their_line(
    tmp_path: Path, kind: str, content: bytes, problem: str
) -> None:
    with pytest.raises(InputError) as caught:
        marked(tmp_path, kind, content)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_table_that_is_a_folder_or_missing_is_refused(tmp_path: Path) -> None:
    (tmp_path / HRSC).mkdir(parents=True)
    (tmp_path / HRSC / "tile1.pgm").touch()
    with pytest.raises(InputError, match=r"1_gt.csv: file is missing"):
        list(annotated_images(tmp_path))
    (tmp_path / HRSC / "1_gt.csv").mkdir()
    with pytest.raises(InputError, match=r"1_gt.csv: expected a file, found a folder"):
        list(annotated_images(tmp_path))
