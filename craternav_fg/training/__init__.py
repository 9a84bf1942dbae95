"""Training of the crater network of `vision`, on rendered ground alone: no photograph, no annotation.

`python -m craternav_fg.training craters FOLDER` trains `craters.onnx` with PyTorch (extra `train`).
The modules `judgement`, `rim_fits` and `marked` fit the constants by which its proposals are judged, the last
one on annotated photographs.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
