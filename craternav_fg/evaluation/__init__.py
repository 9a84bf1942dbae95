"""Errors, consistency and bounds of trajectories: numbers only."""
