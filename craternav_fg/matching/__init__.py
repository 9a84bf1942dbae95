"""Association of image rims with catalogue craters.

- `gate`: with a predicted pose, all rims of an image at once; its search is in `gate_search`.
- `acquire`: the pose of the first image, from a poor prior and the direction of the sun.
- `identify`: without a prior position.
- `rematch`: another crater for rims whose match was rejected.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
