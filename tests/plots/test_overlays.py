"""Rims drawn on frames: where they are, in their own colours."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import matplotlib.colors
import numpy as np
import pytest
from matplotlib.text import Text

from craternav_fg.camera import Camera
from craternav_fg.ellipse import points_on
from craternav_fg.measurements import FrameMeasurement, RimSet, SunTilt
from craternav_fg.plots import overlays
from craternav_fg.plots.style import save
from craternav_fg.workers import processes
from tests.campaign import inline
from tests.vision import scene


def frame(catalog, gTb, rows, charts, sun=None):
    return FrameMeasurement(0, RimSet(rows, charts, np.tile(1e-6 * np.eye(5), (len(rows), 1, 1))), sun)


@pytest.fixture(scope="module")
def one():
    """Some measured rims; the estimate is a few pixels off them, the prediction some more."""
    catalog = scene.craters(np.random.default_rng(3), count=12)
    gTb = scene.pose()
    rows, charts = catalog.visible(scene.camera(), gTb, min_semi_minor_px=12.0, margin_px=30.0)
    pixel = 1.0 / scene.camera().focal_px
    estimate, predicted = (scene.moved(gTb, [0.0, off * pixel, 0.0]) for off in (8.0, -8.0))
    grey = np.full((scene.SIZE_PX, scene.SIZE_PX), 90, dtype=np.uint8)
    direction = scene.sun()
    tilt = SunTilt(0.5, 0.05, np.zeros(2), direction)
    measured = frame(catalog, gTb, rows[:-1], charts[:-1], tilt)
    return overlays.Overlay(grey, measured, estimate, predicted, "12 s"), catalog


def share_coloured(picture, points_px, zoom, colour):
    """Share of points (n, 2) of the image near which a picture shows a colour."""
    wanted = 255.0 * np.array(matplotlib.colors.to_rgb(colour))[::-1]
    like = np.abs(picture.astype(float) - wanted).max(axis=-1) < 70.0
    like = cv2.dilate(like.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    place = np.rint(zoom * (points_px + 0.5) - 0.5).astype(int)
    inside = np.all((place >= 0) & (place < zoom * scene.SIZE_PX), axis=1)
    return float(np.mean(like[place[inside, 1], place[inside, 0]]))


def test_each_rim_is_where_it_belongs_in_its_colour(one, tmp_path: Path):
    overlay, catalog = one
    camera = scene.camera()
    save(overlays.draw_overlay(overlay, camera, catalog), tmp_path / "a.png", 100)
    picture = cv2.imread(str(tmp_path / "a.png"))
    zoom = 2
    assert picture.shape == (zoom * scene.SIZE_PX + 62, zoom * scene.SIZE_PX, 3)
    measured = camera.pixels(points_on(overlay.frame.rims.chart, 60)).reshape(-1, 2)
    assert share_coloured(picture, measured, zoom, overlays.MEASURED) > 0.9
    for gTb, colour, least in (
        (overlay.gTb, overlays.CATALOGUE, 0.9), (overlay.predicted_gTb, overlays.PREDICTED, 0.25)
    ):  # fmt: skip
        _, charts = catalog.visible(camera, gTb, min_semi_minor_px=12.0)
        rims = camera.pixels(points_on(charts, 60)).reshape(-1, 2)
        assert share_coloured(picture, rims, zoom, colour) > least
        assert share_coloured(picture, measured, zoom, colour) < 0.6 * least


def test_names_do_not_cover_one_another(one):
    overlay, catalog = one
    rows = np.repeat(overlay.frame.rims.craters, 3)
    charts = np.repeat(overlay.frame.rims.chart, 3, axis=0)
    crowded = overlays.Overlay(
        overlay.image, frame(catalog, overlay.gTb, rows, charts), overlay.gTb, None, "crowded"
    )
    count = len(overlay.frame.rims)
    for drawn in (overlay, crowded):
        figure = overlays.draw_overlay(drawn, scene.camera(), catalog)
        figure.canvas.draw()
        names = [t for t in figure.axes[0].texts if isinstance(t, Text) and t.get_text()]
        assert count - 3 <= len(names) <= count
        boxes = [t.get_window_extent() for t in names]
        assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
        assert {t.get_text() for t in names} <= set(catalog.identifiers)


@pytest.mark.parametrize("count", [1, 5])
def test_contact_sheets_of_few_frames_also_without_any_rim(one, count, tmp_path: Path):
    overlay, catalog = one
    nothing = overlays.Overlay(
        overlay.image, FrameMeasurement(0, RimSet.empty(), None), overlay.gTb, None, "nothing"
    )
    figure = overlays.draw_contact_sheet([overlay] * (count - 1) + [nothing], scene.camera(), catalog)
    save(figure, tmp_path / "sheet.png")
    picture = cv2.imread(str(tmp_path / "sheet.png"))
    assert picture.shape[1] > min(count, 4) * 300
    assert [axes.get_title() for axes in figure.axes if axes.get_title()][-1] == "nothing"


def test_a_lens_that_distorts_bends_the_rims_of_every_kind(one, tmp_path: Path):
    overlay, catalog = one
    plain = scene.camera()
    lens = (-0.25, 0.05, 0.0, 0.0, 0.0)
    bent = Camera(
        plain.width_px, plain.height_px, plain.fx_px, plain.fy_px, plain.cx_px, plain.cy_px, distortion=lens
    )
    save(overlays.draw_overlay(overlay, bent, catalog), tmp_path / "bent.png", 100)
    picture = cv2.imread(str(tmp_path / "bent.png"))
    measured = bent.pixels(points_on(overlay.frame.rims.chart, 60)).reshape(-1, 2)
    assert share_coloured(picture, measured, 2, overlays.MEASURED) > 0.9


class Frames:
    """Data set of a few images of one scene."""

    def __init__(self, overlay, catalog):
        self.overlay, self.catalog = overlay, catalog
        self.camera, self.body = scene.camera(), scene.MOON
        self.stamps_ns = np.arange(5) * 10**9

    def __len__(self):
        return len(self.stamps_ns)

    def image(self, index):
        return self.overlay.image + np.uint8(index)


@pytest.mark.parametrize(
    "workers",
    [pytest.param(inline.processes, id="inline"), pytest.param(processes, marks=pytest.mark.slow, id="real")],
)
def test_processes_draw_the_same_as_one(one, tmp_path: Path, monkeypatch, workers):
    monkeypatch.setattr(overlays, "processes", workers)
    overlay = one[0]
    data = Frames(*one)
    frames = [replace(overlay.frame, stamp_ns=int(stamp)) for stamp in data.stamps_ns]
    poses = np.tile(overlay.gTb, (len(data), 1, 1))
    trajectory = SimpleNamespace(stamps_ns=data.stamps_ns, gTb=poses, gP=poses[:, :3, 3])
    result = SimpleNamespace(
        trajectories={"smoother": trajectory}, frames=frames, expected_rims=None, predicted=None
    )
    reported = []
    for name, worth in (("one", 100), ("several", 1)):
        monkeypatch.setattr(overlays, "_WORTH_A_PROCESS", worth)
        overlays.write_overlays(data, result, tmp_path / name, 2, lambda *args: reported.append(args))
    assert reported == 2 * [("overlays", done, 3) for done in (1, 2, 3)]
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert names == ["frame_00000_0.0s.png", "frame_00002_2.0s.png", "frame_00004_4.0s.png"]
    pictures = [[(tmp_path / folder / name).read_bytes() for name in names] for folder in ("one", "several")]
    assert pictures[0] == pictures[1]
    assert len(set(pictures[0])) == 3
