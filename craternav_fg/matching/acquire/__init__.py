"""The pose of one image from a poor prior: rims are matched to craters by hypotheses and voting."""
