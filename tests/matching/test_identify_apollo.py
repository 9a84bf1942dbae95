"""Blind identification of Apollo 15's photographs: no attitude, no altitude."""

import json

import cv2
import numpy as np
import pytest

from craternav_fg.camera import Camera
from craternav_fg.catalogs.dem import read_dem
from craternav_fg.catalogs.files import import_catalog
from craternav_fg.catalogs.heights import with_rim_heights
from craternav_fg.catalogs.merge import merge
from craternav_fg.matching.identify.search import identify
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.vision.detect import find_rims
from tests.shared_data import shared


@pytest.fixture(scope="module")
def index():
    names = ("robbins_2018_subset", "moon_head_povilaitis_5km")
    merged = merge([import_catalog(shared(f"{name}.csv"))[0] for name in names], names).catalog
    return TripleIndex.build(with_rim_heights(merged, read_dem(shared("gld100/gld100_16ppd_global.tif"))))


@pytest.fixture(scope="module")
def photographs():
    paths = [shared(f"apollo15/AS15-M-0{k}_SML.png") for k in range(295, 301)]
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]


@pytest.fixture(scope="module")
def camera():
    known = json.loads(shared("apollo15/spice_truth_297_300.json").read_text())["camera"]
    K = np.array(known["K"])
    return Camera(known["width"], known["height"], K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def test_all_six_are_identified_within_three_kilometres_of_spice(index, photographs, camera):
    found = [identify(find_rims(image).ellipses_px, camera, index) for image in photographs]
    assert all(one.identified for one in found)
    truth = json.loads(shared("apollo15/spice_truth_297_300.json").read_text())["frames"]
    for k, one in enumerate(found[2:], 297):
        assert np.linalg.norm(one.gTb[:3, 3] - truth[str(k)]["position_m"]) < 3e3
    # The first two lie on the same track, 40 km apart.
    steps = np.diff([one.gTb[:3, 3] for one in found], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 41.2e3, atol=2.5e3)


def test_mirrored_ones_are_refused_and_inverted_ones_are_not_wrong(index, photographs, camera):
    for image in photographs:
        mirrored = np.ascontiguousarray(image[:, ::-1])
        assert not identify(find_rims(mirrored).ellipses_px, camera, index).identified
        inverted = identify(find_rims(255 - image).ellipses_px, camera, index)
        right = identify(find_rims(image).ellipses_px, camera, index)
        if inverted.identified:
            assert np.linalg.norm(inverted.gTb[:3, 3] - right.gTb[:3, 3]) < 2e3
