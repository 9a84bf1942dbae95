"""Sizes of numbers that are read."""

# No quantity in SI units is larger; the square of a larger number need not be finite.
LARGEST = 1e60
