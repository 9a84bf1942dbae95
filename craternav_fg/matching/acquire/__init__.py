"""Acquisition: the pose of the first image, from a poor prior and the direction of the sun.

1. `detected_rims`: rims are found in the image without a prediction.
2. `hypotheses`: each of the larger rims is taken for each crater in turn. The line of sight to the crater
   gives two angles of the attitude, the direction of the shading the third, the ellipse the range. Hypotheses
   that contradict the prior are dropped; those that explain most rims are expanded by them.
3. `score`: a pose is scored by how improbable it is that chance explains as many of the craters in view.

`search` runs these steps (`search.acquire`).
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
