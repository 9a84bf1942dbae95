"""A catalogue of the Moon of two craters."""

from dataclasses import replace

import numpy as np

from craternav_fg.catalogs.bodies import named_body
from craternav_fg.catalogs.model import Catalog
from tests.dataset.samples import recording


def moon_catalog() -> Catalog:
    return replace(recording(np.random.default_rng(1)).catalog, body=named_body("Moon"))
