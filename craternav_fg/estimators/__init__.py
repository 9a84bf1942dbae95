"""From measurements to trajectories."""
