"""Simulated descents: motion, terrain, images, sensors. No estimator or detector may import it."""
