"""Formats of other programs: ROS bags and Kalibr in and out; TUM, KITTI, GeoJSON, KML and COLMAP out."""
