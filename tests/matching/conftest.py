"""What several tests of identification search."""

import numpy as np
import pytest

from craternav_fg.matching.identify.triple_index import TripleIndex
from craternav_fg.simulation.catalog_views import synthetic_catalog
from craternav_fg.simulation.scenes import MOON


@pytest.fixture(scope="session")
def synthetic() -> TripleIndex:
    return TripleIndex.build(synthetic_catalog(MOON, np.random.default_rng(0)))
