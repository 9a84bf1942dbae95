"""What the covariance of a rim is, from the fit to the factor."""
