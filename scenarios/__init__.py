"""Scenario files: one simulated case each."""
