"""Gravity and spin of bodies that imported images show."""

import math
from dataclasses import replace

from craternav_fg.body import Body
from craternav_fg.errors import InputError

# Gravitational parameters, km^3/s^2: DE440 (Park et al. 2021) and the satellite ephemerides of JPL. Bodies
# whose values differ by percents between these are left out. Bennu: Scheeres et al. (2019), Nature Astronomy
# 3, 352; Ryugu: Watanabe et al. (2019), Science 364, 268.
_GM_KM3_S2 = {
    "Moon": 4902.800118,
    "Mercury": 22031.868551,
    "Venus": 324858.592,
    "Earth": 398600.4355,
    "Mars": 42828.3736,
    "Ceres": 62.62889,
    "Vesta": 17.28823,
    "Eros": 4.463e-4,
    "Bennu": 4.892e-9,
    "Ryugu": 3.0e-8,
    "Phobos": 7.0875e-4,
    "Deimos": 9.616e-5,
    "Io": 5959.9155,
    "Europa": 3202.7121,
    "Ganymede": 9887.8328,
    "Callisto": 7179.2834,
    "Mimas": 2.5035,
    "Enceladus": 7.2104,
    "Tethys": 41.2095,
    "Dione": 73.1161,
    "Rhea": 153.9417,
    "Titan": 8978.137,
    "Iapetus": 120.515,
    "Phoebe": 0.5548,
    "Pluto": 869.61,
    "Charon": 105.88,
}
# Rotation about the pole of the IAU, deg/day (Archinal et al. 2018, Celest. Mech. 130, 22); retrograde ones
# are negative. Bennu: 4.296057 h (Lauretta et al. 2019); Ryugu: 7.63262 h (Watanabe et al. 2019).
_ROTATION_DEG_DAY = {
    "Moon": 13.17635815,
    "Mercury": 6.1385108,
    "Venus": -1.4813688,
    "Earth": 360.9856235,
    "Mars": 350.8919824,
    "Ceres": 952.1532,
    "Vesta": 1617.3329428,
    "Eros": 1639.38864745,
    "Bennu": 2011.1464,
    "Ryugu": 1131.98,
    "Phobos": 1128.844585,
    "Deimos": 285.161897,
    "Io": 203.4889538,
    "Europa": 101.3747235,
    "Ganymede": 50.3176081,
    "Callisto": 21.5710715,
    "Mimas": 381.994555,
    "Enceladus": 262.7318996,
    "Tethys": 190.6979085,
    "Dione": 131.5349316,
    "Rhea": 79.6900478,
    "Titan": 22.5769768,
    "Iapetus": 4.5379572,
    "Phoebe": 931.639,
    "Miranda": -254.6906892,
    "Ariel": -142.8356681,
    "Umbriel": -86.8688923,
    "Titania": -41.3514316,
    "Oberon": -26.7394932,
    "Triton": -61.2572637,
    "Pluto": 56.3625225,
    "Charon": 56.3625225,
}


def known_mu_m3_s2(name: str) -> float | None:
    """Look up a body's gravitational parameter; None for bodies that are not known."""
    known = _GM_KM3_S2.get(name)
    return None if known is None else 1e9 * known


def known_spin_rad_s(name: str) -> float | None:
    """Look up a body's spin about its pole, retrograde ones negative; None for bodies that are not known."""
    known = _ROTATION_DEG_DAY.get(name)
    return None if known is None else math.radians(known) / 86400.0


def with_gravity_and_spin(body: Body, mu_m3_s2: float | None, spin_rad_s: float | None) -> Body:
    """Complete a body by its gravity, and by its spin if it has none.

    Parameters
    ----------
    body : Body
    mu_m3_s2 : float or None
        Gravitational parameter; None for the known one.
    spin_rad_s : float or None
        Spin about the pole; None for the body's own, or the known one.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        When one is neither given nor known.
    """
    name = body.name or "this body"
    if mu_m3_s2 is None:
        mu_m3_s2 = known_mu_m3_s2(body.name)
        if mu_m3_s2 is None:
            raise InputError("--mu-m3-s2", f"expected it for {name}, whose gravity is not known")
    if spin_rad_s is not None or not any(body.spin_rad_s):
        if spin_rad_s is None:
            spin_rad_s = known_spin_rad_s(body.name)
            if spin_rad_s is None:
                raise InputError("--spin-rad-s", f"expected it for {name}, whose spin is not known")
        body = replace(body, spin_rad_s=(0.0, 0.0, spin_rad_s))
    return replace(body, mu_m3_s2=mu_m3_s2)
