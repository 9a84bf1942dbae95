"""Resection by the methods of Tian et al. (2019), as published: eqs. (10), (13), (19), (23) and (25).

`equations` has the residuals and their derivatives, `centres` the method from the centres of image ellipses
alone, `solver` the solver for all of them. `docs/equations.md` has the corrections of the printed equations.

References
----------
Tian, Yu, Yao, Huang, Crater edge-based flexible autonomous navigation for planetary landing, Journal of
Navigation 72 (2019) 648-668, DOI 10.1017/S0373463318000966.
"""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
