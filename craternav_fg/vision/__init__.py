"""Rims and the sun's tilt from images.

Two detectors share the edge search and the ellipse fit:

- `guided` measures the rims of catalogue craters near a predicted pose: `predicted_rims` (what the pose
predicts),
  `shift_search` and `pose_correction` (where the rims are), `rim_fitting`, `arcs` (rims seen in part), `sun`
  and `wall_shading` (direction towards the sun).
- `network_detect` finds rims without any prediction, the default: `crater_network` (weights), `pyramid`,
  `proposals`, `circle_shading`, `proposal_fit` (which fit is the rim).
- `detect` does so without the network: `brightness` (any image), `candidates` with `disc_kernel` (template
  matching). Both trace rims by `blind_fit` with `blind_kernel`; `canny` is the published method for
  comparison.
- Shared: `grey`, `image_sampling`, `robust_scale`, `reference_brightness`, `crater_profile`, `rim_geometry`,
  `edges` with `edge_kernel` and `flank_kernel`, `ellipse_fit` with `ellipse_kernel`, `ellipse_bias` and
  `dense_kernel`.
- `error_model` makes the covariance of a rim, from the fit to what an estimator uses.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
