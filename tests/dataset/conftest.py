import shutil
from pathlib import Path

import numpy as np
import pytest

from craternav_fg.dataset import write_dataset
from tests.dataset.samples import Folder, parts, random_images, random_rims


@pytest.fixture(scope="session")
def with_images(tmp_path_factory):
    rng = np.random.default_rng(5)
    return write_dataset(tmp_path_factory.mktemp("images") / "data", images=random_images(rng), **parts(rng))


@pytest.fixture(scope="session")
def with_rims(tmp_path_factory):
    rng = np.random.default_rng(6)
    return write_dataset(
        tmp_path_factory.mktemp("rims") / "data", measurements=random_rims(rng), **parts(rng)
    )


@pytest.fixture
def folder(with_images, tmp_path):
    return Folder(Path(shutil.copytree(with_images, tmp_path / "data")))


@pytest.fixture
def rims_folder(with_rims, tmp_path):
    return Folder(Path(shutil.copytree(with_rims, tmp_path / "data")))
