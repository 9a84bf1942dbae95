import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset import write_dataset
from tests.dataset.samples import Folder, random_images, random_measurements, recording


@pytest.fixture(scope="session")
def with_images(tmp_path_factory):
    rng = np.random.default_rng(5)
    images = random_images(rng)
    return write_dataset(tmp_path_factory.mktemp("images") / "data", recording(rng), images)


@pytest.fixture(scope="session")
def with_rims(tmp_path_factory):
    rng = np.random.default_rng(6)
    measured = random_measurements(rng)
    return write_dataset(
        tmp_path_factory.mktemp("rims") / "data", replace(recording(rng), measurements=measured)
    )


@pytest.fixture
def folder(with_images, tmp_path):
    return Folder(Path(shutil.copytree(with_images, tmp_path / "data")))


@pytest.fixture
def rims_folder(with_rims, tmp_path):
    return Folder(Path(shutil.copytree(with_rims, tmp_path / "data")))
