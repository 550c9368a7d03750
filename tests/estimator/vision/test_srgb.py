"""Linear light from sRGB against the standard's own inverse."""

import numpy as np

from estimator.vision.srgb import LINEAR_LIGHT, linear_light


def test_it_is_the_inverse_of_the_standards_encoding() -> None:
    light = LINEAR_LIGHT
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(255.0 * encoded, np.arange(256), atol=2e-3)
    assert np.all(np.diff(light) > 0)
    assert (light[0], light[255]) == (0.0, 1.0)
    np.testing.assert_array_equal(linear_light([[0, 10], [128, 255]]), light[[[0, 10], [128, 255]]])
