"""Gravity and spin of bodies that imported images show."""

from dataclasses import replace

from craternav_fg.body import Body
from craternav_fg.errors import InputError

# Gravitational parameter, m^3/s^2, and spin about the pole, rad/s: DE440 (Park et al. 2021), and one turn in
# 27.321661 days.
_KNOWN = {"Moon": (4.902800118e12, 2.6616995e-6)}


def with_gravity(body: Body, mu_m3_s2: float | None) -> Body:
    """Complete a body by its gravity, and by its spin if it has none.

    Parameters
    ----------
    body : Body
    mu_m3_s2 : float or None
        Gravitational parameter; None for the known one.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        When it is neither given nor known.
    """
    known = _KNOWN.get(body.name)
    if mu_m3_s2 is None and known is None:
        raise InputError(
            "--mu-m3-s2", f"expected it for {body.name or 'this body'}, whose gravity is not known"
        )
    if known is not None and not any(body.spin_rad_s):
        body = replace(body, spin_rad_s=(0.0, 0.0, known[1]))
    return replace(body, mu_m3_s2=known[0] if mu_m3_s2 is None and known is not None else mu_m3_s2 or 0.0)
