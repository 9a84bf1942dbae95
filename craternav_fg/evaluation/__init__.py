"""Errors, consistency and figures of runs."""
