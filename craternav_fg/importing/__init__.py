"""Images from other sources as data sets: ISIS cubes, SPICE kernels, plain images with a table of times.

`labels` reads an ISIS label and its tables, `isis` a cube, `cubes` many, `spice` the state of a camera from
kernels, `images` plain images and their times; `assemble` makes the data set. There is no IMU: a motion model
stands in.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
