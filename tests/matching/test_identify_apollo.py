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
from craternav_fg.matching.identify.detected import identify_detected
from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.vision.detect import find_rims
from craternav_fg.vision.network_detect import find_rims_network
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


def identified(image, camera, index, find=find_rims_network):
    rims = find(image)
    return identify_detected(rims.ellipses_px, rims.traced, camera, index)


@pytest.mark.parametrize("find", [find_rims_network, find_rims])
def test_all_six_are_identified_within_three_kilometres_of_spice(index, photographs, camera, find):
    found = [identified(image, camera, index, find) for image in photographs]
    assert all(one.identified for one in found)
    truth = json.loads(shared("apollo15/spice_truth_297_300.json").read_text())["frames"]
    for k, one in enumerate(found[2:], 297):
        assert np.linalg.norm(one.gTb[:3, 3] - truth[str(k)]["position_m"]) < 3e3
    # The first two lie on the same track, 40 km apart.
    steps = np.diff([one.gTb[:3, 3] for one in found], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 41.2e3, atol=2.5e3)


@pytest.mark.slow
def test_mirrored_ones_are_refused_and_inverted_ones_are_not_wrong(index, photographs, camera):
    for image in photographs:
        mirrored = np.ascontiguousarray(image[:, ::-1])
        assert not identified(mirrored, camera, index).identified
        inverted = identified(255 - image, camera, index)
        right = identified(image, camera, index)
        if inverted.identified:
            assert np.linalg.norm(inverted.gTb[:3, 3] - right.gTb[:3, 3]) < 2e3


@pytest.mark.slow
@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turned_ones_are_identified_as_well(index, photographs, camera, quarters):
    """From the same places: their principal point is the middle but for a pixel."""
    for image in photographs:
        turned = np.ascontiguousarray(np.rot90(image, quarters))
        found, upright = (identified(one, camera, index) for one in (turned, image))
        assert found.identified
        assert np.linalg.norm(found.gTb[:3, 3] - upright.gTb[:3, 3]) < 1.5e3


@pytest.mark.slow
@pytest.mark.parametrize(("find", "limit_m"), [(find_rims_network, 1.5e3), (find_rims, 1e3)])
def test_smaller_ones_are_identified_as_well(index, photographs, camera, find, limit_m):
    """At 70 %: fewer rims are found."""
    side = 708
    share = side / camera.width_px
    smaller = Camera(
        side, side, share * camera.fx_px, share * camera.fy_px,
        share * (camera.cx_px + 0.5) - 0.5, share * (camera.cy_px + 0.5) - 0.5,
    )  # fmt: skip
    for image in photographs:
        shrunk = cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)
        found = identified(shrunk, smaller, index, find)
        right = identified(image, camera, index, find)
        assert found.identified
        assert np.linalg.norm(found.gTb[:3, 3] - right.gTb[:3, 3]) < limit_m
