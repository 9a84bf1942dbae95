"""The body of a catalogue: what the file states, and whether that is the body it is used on."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from craternav_fg.body import Body
from craternav_fg.errors import InputError

BODY = "BODY"
BODY_RADIUS = "BODY_RADIUS_M"
# Columns that name the body, in lower-case letters: ours, the USGS Gazetteer's, that of EPN-TAP.
BODY_NAMES = ("body", "target", "targetname")
# Mean radii of the IAU (Archinal et al. 2018, Celest. Mech. 130, 22): planets and dwarf planets, moons,
# asteroids. Those of Mars and Vesta are the spheres of their maps and heights (the mean radius of Mars is
# 3389500 m); Bennu's and Ryugu's are those of Lauretta et al. (2019, Nature 568, 55) and Watanabe et al.
# (2019, Science 364, 268). A catalogue on another sphere states its radius or is read with --body-radius-m.
SPHERES_M = {
    "Moon": 1737400.0,
    "Mercury": 2439400.0,
    "Venus": 6051800.0,
    "Earth": 6371008.4,
    "Mars": 3396190.0,
    "Ceres": 470000.0,
    "Pluto": 1188300.0,
    "Io": 1821490.0,
    "Europa": 1560800.0,
    "Ganymede": 2631200.0,
    "Callisto": 2410300.0,
    "Mimas": 198200.0,
    "Enceladus": 252100.0,
    "Tethys": 531000.0,
    "Dione": 561400.0,
    "Rhea": 763500.0,
    "Titan": 2574730.0,
    "Iapetus": 734300.0,
    "Phoebe": 106500.0,
    "Miranda": 235800.0,
    "Ariel": 578900.0,
    "Umbriel": 584700.0,
    "Titania": 788900.0,
    "Oberon": 761400.0,
    "Triton": 1352600.0,
    "Charon": 606000.0,
    "Phobos": 11080.0,
    "Deimos": 6200.0,
    "Vesta": 255000.0,
    "Ida": 15650.0,
    "Mathilde": 26500.0,
    "Eros": 8450.0,
    "Bennu": 245.03,
    "Ryugu": 448.0,
}
# Bodies whose planetographic latitudes are of an ellipsoid; on the others' reference spheres they are
# planetocentric ones.
FLATTENED = ("Earth", "Mars", "Ceres", "Vesta")
_ALSO_CALLED = {"lunar": "Moon", "luna": "Moon"}
_BY_NAME = {**{name.lower(): name for name in SPHERES_M}, **_ALSO_CALLED}
# Identifiers of craters in Robbins (2018), a catalogue of the Moon.
_ROBBINS = re.compile(r"\d\d-\d-\d{6}")
# Shorter words of a file's name, such as io, are not taken for a body's.
_MIN_NAME = 4
# Identifiers that are looked at to recognise that catalogue.
_SAMPLED_IDENTIFIERS = 200
# Relative differences of radii up to which two spheres are the same, and two spheres are of one body.
SAME_SPHERE, SAME_BODY = 1e-6, 0.01


@dataclass(frozen=True)
class StatedBody:
    """What a file states about its body.

    Attributes
    ----------
    name : str
        Empty when only the radius is stated.
    radius_m : float or None
        Radius of the catalogue's sphere; None when it is not known.
    exact : bool
        Whether the file itself states the radius.
    by : str
        What states the body, as words for messages: "BODY says".
    column : str or None
        The column that does, if any.
    """

    name: str
    radius_m: float | None
    exact: bool
    by: str
    column: str | None = None


def named_body(name: str, radius_m: float | None = None) -> Body:
    """Make a body without gravity and spin, on which catalogues are read but nothing moves.

    Parameters
    ----------
    name : str
    radius_m : float, optional
        Without it that of the sphere known by this name.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        When the radius is not given and no sphere is known by this name.
    """
    known = _BY_NAME.get(name.strip().lower())
    if radius_m is None:
        if known is None:
            spheres = ", ".join(SPHERES_M)
            raise InputError(
                "--body",
                f"expected --body-radius-m beside {name!r}: the radius is known only of {spheres}",
            )
        radius_m = SPHERES_M[known]
    return Body(known or name.strip(), radius_m, 1.0, (0.0, 0.0, 0.0))


def stated_body(
    path: Path, columns: Mapping[str, Any], identifiers: Sequence[str | None]
) -> StatedBody | None:
    """Find out what a table states about its body: by columns, by identifiers, or by its name.

    Parameters
    ----------
    path : Path
    columns : mapping of str to sequence
        Columns that were read; `BODY_RADIUS_M` and one that names the body are used.
    identifiers : sequence of str or None
        Identifiers of the craters.

    Returns
    -------
    StatedBody or None
        None when nothing states the body.

    Raises
    ------
    InputError
        When it names several bodies, or a radius that is not positive.
    """
    column = next((name for name in columns if is_body_column(name)), None)
    name = "" if column is None else _only(path, column, columns[column])
    if BODY_RADIUS in columns:
        radius_m = _only(path, BODY_RADIUS, np.asarray(columns[BODY_RADIUS]).tolist())
        if not (radius_m and radius_m > 0.0):
            raise InputError(path, f"expected a radius, found {radius_m}", column=BODY_RADIUS)
        return StatedBody(name or "", radius_m, True, f"{BODY_RADIUS} says", BODY_RADIUS)
    if name:
        known = _BY_NAME.get(name.lower())
        radius = SPHERES_M[known] if known else None
        return StatedBody(known or name, radius, False, f"{column} says", column)
    sampled = identifiers[:: max(1, len(identifiers) // _SAMPLED_IDENTIFIERS)]
    if sampled and all(one is not None and _ROBBINS.fullmatch(one) for one in sampled):
        return StatedBody("Moon", SPHERES_M["Moon"], False, "its identifiers, those of Robbins (2018), say")
    words = re.split(r"[^a-z]+", path.stem.lower())
    called = {_BY_NAME[word] for word in words if word in _BY_NAME and len(word) >= _MIN_NAME}
    if len(called) == 1:
        (known,) = called
        return StatedBody(known, SPHERES_M[known], False, "its name says")
    return None


def known_name(name: str) -> str | None:
    """Return a body's name as `SPHERES_M` has it; None for bodies that are not there."""
    return _BY_NAME.get(name.strip().lower())


def is_body_column(name: str) -> bool:
    """Return whether a column names the body."""
    return re.sub(r"[^a-z]", "", name.lower()) in BODY_NAMES


def resolve_body(path: Path, body: Body | None, stated: StatedBody | None) -> tuple[Body, str]:
    """Decide which body a catalogue is of.

    Parameters
    ----------
    path : Path
    body : Body or None
        Body on which the catalogue is used; None when the file decides.
    stated : StatedBody or None
        What the file states.

    Returns
    -------
    body : Body
        The given one, else the stated one, else the Moon.
    by : str
        "given", or what in the file states the body; empty when nothing does and the Moon is assumed.

    Raises
    ------
    InputError
        When the file states another body than the given one, or a body whose radius is not known.
    """
    if stated is None:
        return (named_body("Moon"), "") if body is None else (body, "given")
    if body is None:
        if stated.radius_m is None:
            problem = f"is of {stated.name}, as {stated.by}, whose radius is not known: give --body-radius-m"
            raise InputError(path, problem, column=stated.column)
        return named_body(stated.name, stated.radius_m), stated.by
    # Spheres of two bodies may be alike.
    other = _named_otherwise(body.name, stated)
    if stated.radius_m is not None:
        limit = SAME_SPHERE if stated.exact else SAME_BODY
        other |= abs(stated.radius_m - body.radius_m) > limit * body.radius_m
    if other:
        ratio = 0.0 if stated.radius_m is None else stated.radius_m / body.radius_m
        hint = ": the radius given is in km" if abs(ratio - 1000.0) < 10.0 else ""
        on = "" if stated.radius_m is None else f" on {stated.radius_m:.9g} m"
        raise InputError(
            path,
            f"expected a catalogue on a sphere of {body.radius_m:.9g} m ({body.name or 'the given body'}), "
            f"found one of {stated.name or 'a body'}{on}, as {stated.by}{hint}",
            column=stated.column,
        )
    return body, "given"


def _named_otherwise(name: str, stated: StatedBody) -> bool:
    """Whether a file states another body than that of a name; names that share a word are of one."""
    mine, theirs = _words(name), _words(stated.name)
    if stated.column is None:
        # Concluded from identifiers or a file's name: only a body that is known, too, is certainly another.
        mine = {word for word in mine if word in SPHERES_M}
    return bool(mine and theirs) and not mine & theirs


def _words(name: str) -> set[str]:
    """Words of a body's name; those of known bodies as `SPHERES_M` has them."""
    return {_BY_NAME.get(word, word) for word in re.findall(r"[^\W\d_]+", name.lower())}


def _only(path: Path, column: str, values: Sequence[Any]) -> Any:
    """Return the only value that a column has."""
    found = set(values)
    if len(found) > 1:
        one, other = sorted(map(str, found))[:2]
        raise InputError(path, f"expected one body, found {one} and {other}", column=column)
    value = next(iter(found), None)
    return value.strip() if isinstance(value, str) else value
