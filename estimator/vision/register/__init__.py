"""Direct registration of the drawn pad onto a frame, from a prior: pose with covariance."""
