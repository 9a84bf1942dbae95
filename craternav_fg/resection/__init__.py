"""Resection: the pose of one image from rims that are matched to craters.

- `problem`: what a solver is given and what it returns.
- `efficient`: the maximum-likelihood pose, without a start and with all further solutions (`solve`), or from
  a start (`refine`). Its kernels: `start_kernel` computes initial poses, `solve_kernel` minimises.
- `robust`: the same when some rims are matched to the wrong crater; kernel `robust_kernel`.
- `caveats`: warnings about a solution that is formally valid.
- `bounds`: Cramer-Rao bound, and which directions of the pose an image determines.
- `edge_fit`: ellipses of edge points with known noise.
- `paper`: the methods of Tian et al. (2019) as published; `least_squares` minimises for them.
- `files`: problems from files, results as plain data.

Perturbations of poses are GTSAM's: the right twist [w, rho] of the body's pose gTb in its tangent space, with
gTb exp([w, rho]). The exponential is a screw motion. Errors of several degrees follow it: weakly determined
poses lie along a screw about the ground in view, and measured as (R exp(w), t + R rho) they would seem many
standard deviations away.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
