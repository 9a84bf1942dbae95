"""Ground track and image footprints for geographic information systems: GeoJSON and KML."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from craternav_fg import frames
from craternav_fg.body import Body
from craternav_fg.camera import Camera
from craternav_fg.files import replacing
from craternav_fg.trajectory import Trajectory
from factors.arrays import FloatArray

# Points along each side of an image whose rays outline its footprint.
_SIDE_POINTS = 9


def ground_track(trajectory: Trajectory, body: Body) -> FloatArray:
    """Compute the points below the lander.

    Parameters
    ----------
    trajectory : Trajectory
    body : Body

    Returns
    -------
    ndarray, shape (k, 3)
        Longitude, deg, east, without jumps at 180 deg; latitude, deg; altitude above the sphere, m.
    """
    latitude, longitude = frames.latitude_longitude(trajectory.gP)
    altitude_m = body.altitude_m(trajectory.gP)
    return np.stack([np.degrees(np.unwrap(longitude)), np.degrees(latitude), altitude_m], axis=-1)


def footprint(gTb: FloatArray, camera: Camera, body: Body) -> FloatArray | None:
    """Compute the outline of what an image shows of the sphere.

    Parameters
    ----------
    gTb : ndarray, shape (4, 4)
        Pose of the lander in g, m.
    camera : Camera
    body : Body

    Returns
    -------
    ndarray, shape (n, 2), or None
        Longitude and latitude, deg, closed, counter-clockwise, without jumps at 180 deg. Around a pole the
        outline runs through all longitudes, and is closed along the edge of the map that is the pole. None
        when the horizon is in the image or the body is not.
    """
    upper, lower, left, right = np.split(camera.border_px(_SIDE_POINTS), 4)
    # Counter-clockwise as seen from above: RFC 7946 and KML have outer rings so.
    around_px = np.concatenate([left[:-1], lower[:-1], right[:0:-1], upper[:0:-1]])
    rays = np.column_stack([camera.normalised(around_px), np.ones(len(around_px))])
    gTc = camera.gTc(gTb)
    directions = rays @ gTc[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    P = gTc[:3, 3]
    along = directions @ P
    root = along**2 - (P @ P - body.radius_m**2)
    if np.any(root <= 0.0) or np.any(along >= 0.0):
        return None
    points = P + (-along - np.sqrt(root))[:, None] * directions
    latitude, longitude = frames.latitude_longitude(points)
    # The first point once more, at the longitude that the last one leads to.
    closed = np.append(longitude, longitude[0]), np.append(latitude, latitude[0])
    outline = np.degrees(np.stack([np.unwrap(closed[0]), closed[1]], axis=-1))
    begin, end = outline[0, 0], outline[-1, 0]
    if abs(end - begin) < 180.0:
        outline[-1] = outline[0]
        return outline
    pole = np.copysign(90.0, P[2])
    return np.concatenate([outline, [[end, pole], [begin, pole]], outline[:1]])


def write_geojson(path: Path, trajectory: Trajectory, camera: Camera, body: Body, every: int = 1) -> None:
    """Write ground track and footprints as GeoJSON (RFC 7946).

    Longitudes run on beyond 180 deg where the track crosses it. The coordinates are planetocentric, on the
    body that the property `body` names: RFC 7946 itself knows the Earth only.

    Parameters
    ----------
    path : Path
    trajectory : Trajectory
    camera : Camera
    body : Body
    every : int
        Footprint of every so many frames.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    features = [
        _feature(
            "LineString", ground_track(trajectory, body).tolist(), {"name": "ground track", "body": body.name}
        )
    ]
    for k, outline in _footprints(trajectory, camera, body, every):
        properties = {"name": f"frame {k}", "frame": k, "stamp_ns": int(trajectory.stamps_ns[k])}
        features.append(_feature("Polygon", [outline.tolist()], properties))
    text = json.dumps({"type": "FeatureCollection", "features": features}, indent=1)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_kml(path: Path, trajectory: Trajectory, camera: Camera, body: Body, every: int = 1) -> None:
    """Write ground track and footprints as KML, for the body's globe.

    Parameters
    ----------
    path : Path
    trajectory : Trajectory
    camera : Camera
    body : Body
    every : int
        Footprint of every so many frames.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    # Google Earth's hint: on which globe the file is drawn.
    attributes = {"xmlns": "http://www.opengis.net/kml/2.2", "hint": f"target={body.name.lower()}"}
    root = ElementTree.Element("kml", attributes)
    document = ElementTree.SubElement(root, "Document")
    track = _placemark(document, "ground track")
    line = ElementTree.SubElement(track, "LineString")
    ElementTree.SubElement(line, "altitudeMode").text = "absolute"
    ElementTree.SubElement(line, "coordinates").text = _coordinates(ground_track(trajectory, body))
    for k, outline in _footprints(trajectory, camera, body, every):
        polygon = ElementTree.SubElement(_placemark(document, f"frame {k}"), "Polygon")
        ElementTree.SubElement(polygon, "tessellate").text = "1"
        boundary = ElementTree.SubElement(polygon, "outerBoundaryIs")
        ring = ElementTree.SubElement(boundary, "LinearRing")
        flat = np.column_stack([outline, np.zeros(len(outline))])
        ElementTree.SubElement(ring, "coordinates").text = _coordinates(flat)
    with replacing(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _footprints(
    trajectory: Trajectory, camera: Camera, body: Body, every: int
) -> Iterator[tuple[int, FloatArray]]:
    for k in range(0, len(trajectory), every):
        outline = footprint(trajectory.gTb[k], camera, body)
        if outline is not None:
            yield k, outline


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _placemark(document: ElementTree.Element, name: str) -> ElementTree.Element:
    placemark = ElementTree.SubElement(document, "Placemark")
    ElementTree.SubElement(placemark, "name").text = name
    return placemark


def _coordinates(points: FloatArray) -> str:
    return " ".join(f"{x:.9f},{y:.9f},{z:.3f}" for x, y, z in points)
