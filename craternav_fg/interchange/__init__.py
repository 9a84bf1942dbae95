"""Formats of other programs: ROS bags and Kalibr in and out; TUM, KITTI, GeoJSON, KML and COLMAP out."""

from typing import TYPE_CHECKING

if not TYPE_CHECKING:
    from factors.lazy import submodules

    __getattr__ = submodules(__name__)
