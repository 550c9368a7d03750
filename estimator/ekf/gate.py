"""The limits of the innovation gate, and when the recent innovations agree with the covariance."""

_CHI2 = {
    0.01: (6.635, 9.210, 11.345, 13.277, 15.086, 16.812, 18.475, 20.090, 21.666),
    1e-3: (10.828, 13.816, 16.266, 18.467, 20.515, 22.458, 24.322, 26.124, 27.877),
    1e-4: (15.137, 18.421, 21.108, 23.513, 25.745, 27.856, 29.878, 31.828, 33.720),
}
"""Chi-square by probability of exceeding it, for 1 to 9 degrees of freedom."""


def nis_max(probability: float, dof: int) -> float:
    """Return the limit that the NIS of a consistent measurement of `dof` numbers exceeds with this probability."""
    return _CHI2[probability][dof - 1]


def consistent(nis_mean: float) -> bool:
    """Tell whether the recent mean of NIS over degrees of freedom is one that a consistent covariance gives."""
    return nis_mean < 2.0
