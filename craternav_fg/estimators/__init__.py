"""Estimators: trajectories from measurements."""
