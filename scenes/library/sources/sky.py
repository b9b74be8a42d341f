"""The clear sky of `two_cubes.toml`: writes `sky.exr` and prints the scene's ambient colour.

The daylight model of Preetham, Shirley and Smits: luminance Y and chromaticities x, y are each
`zenith * F(theta, gamma) / F(0, theta_sun)` with Perez's distribution
`F = (1 + A exp(B / cos theta)) (1 + C exp(D gamma) + E cos^2 gamma)`,
theta the angle from the zenith, gamma the angle from the sun. The sun itself is left out: a disc of half a
degree would be all of a specular estimate's variance. Below the horizon lies a grey plain lit by this sky.

The texture is the paper's: `u = atan2(n.x, n.y) / (2 pi) + 0.5`, `v = 0.5 - n.z / 2`, so all texels subtend
the same solid angle; row 0 is the zenith. A texel holds the radiance at its centre.

A. J. Preetham, P. Shirley, B. Smits, "A Practical Analytic Model for Daylight", Proc. SIGGRAPH 1999, 91-100:
section 3 and appendix A.2. F is from R. Perez, R. Seals, J. Michalsky, Solar Energy 50, 235-245 (1993).
"""

from pathlib import Path

import colour
import numpy as np
import OpenEXR

TEXTURE = Path(__file__).parents[1] / "sky.exr"
SIZE = (128, 256)  # rows, columns
TURBIDITY = 2.5  # clear; there the model is closest to the CIE standard clear sky
SUN = (-0.48, -0.36, 0.80)  # unit vector towards the sun: on the lamp's side, 53 degrees above the horizon
UNIT = 20.0  # kcd/m^2 of luminance per unit of radiance: puts the sky near 0.5
PLAIN = 0.25  # albedo below the horizon

# Slope and intercept in the turbidity of A, B, C, D, E, for Y, x and y.
DISTRIBUTION = {
    "Y": ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)),
    "x": ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)),
    "y": ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)),
}
# Zenith chromaticity: (T^2, T, 1) M (theta_sun^3, theta_sun^2, theta_sun, 1).
ZENITH = {
    "x": (
        (0.00166, -0.00375, 0.00209, 0.0),
        (-0.02903, 0.06377, -0.03202, 0.00394),
        (0.11693, -0.21196, 0.06052, 0.25886),
    ),
    "y": (
        (0.00275, -0.00610, 0.00317, 0.0),
        (-0.04214, 0.08970, -0.04153, 0.00516),
        (0.15346, -0.26756, 0.06670, 0.26688),
    ),
}


def zenith(channel: str, turbidity: float, theta_sun: float) -> float:
    """Luminance "Y" (kcd/m^2) or chromaticity "x", "y" of the zenith; theta_sun in radians."""
    if channel == "Y":
        chi = (4 / 9 - turbidity / 120) * (np.pi - 2 * theta_sun)
        return (4.0453 * turbidity - 4.9710) * np.tan(chi) - 0.2155 * turbidity + 2.4192
    powers = np.array([theta_sun**3, theta_sun**2, theta_sun, 1.0])
    return float(np.array([turbidity**2, turbidity, 1.0]) @ np.array(ZENITH[channel]) @ powers)


def perez(channel: str, turbidity: float, cos_theta: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Perez's distribution F(theta, gamma); cos_theta > 0, gamma in radians."""
    a, b, c, d, e = (slope * turbidity + intercept for slope, intercept in DISTRIBUTION[channel])
    return (1 + a * np.exp(b / cos_theta)) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)


def sky_yxy(directions: np.ndarray, sun: np.ndarray, turbidity: float) -> np.ndarray:
    """Luminance (kcd/m^2) and chromaticities (Y, x, y) of the sky: (..., 3) float64.

    Parameters
    ----------
    directions : (..., 3) unit vectors above the horizon (z > 0).
    sun : (3,) unit vector towards the sun.
    """
    theta_sun = np.arccos(sun[2])
    gamma = np.arccos(np.clip(directions @ sun, -1, 1))
    channels = [
        zenith(channel, turbidity, theta_sun)
        * perez(channel, turbidity, directions[..., 2], gamma)
        / perez(channel, turbidity, np.array(1.0), theta_sun)
        for channel in ("Y", "x", "y")
    ]
    return np.stack(channels, axis=-1)


def sky_radiance(directions: np.ndarray) -> np.ndarray:
    """Linear Rec. 709 radiance of the scene's sky in scene units, (..., 3); directions as for `sky_yxy`."""
    luminance, x, y = np.moveaxis(sky_yxy(directions, np.array(SUN), TURBIDITY), -1, 0)
    xyz = colour.xyY_to_XYZ(np.stack([x, y, luminance / UNIT], axis=-1))
    return colour.XYZ_to_RGB(xyz, "ITU-R BT.709")


def texel_directions(size: tuple[int, int]) -> np.ndarray:
    """Unit vectors through the texel centres of the paper's mapping, (rows, columns, 3)."""
    rows, columns = size
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    z = 1 - 2 * v
    radius = np.sqrt(1 - z**2)
    azimuth = (u - 0.5) * 2 * np.pi
    return np.stack([radius * np.sin(azimuth), radius * np.cos(azimuth), z], axis=-1)


def mean_radiance() -> np.ndarray:
    """Cosine-weighted mean radiance of the sky, (3,): irradiance of an open horizontal patch over pi."""
    above = texel_directions((1024, 1024))[:512]
    weight = above[..., 2:]
    return (sky_radiance(above) * weight).sum(axis=(0, 1)) / weight.sum()


def texture() -> np.ndarray:
    """The sky and the plain below it, (rows, columns, 3) float16."""
    directions = texel_directions(SIZE)
    horizon = SIZE[0] // 2
    image = np.empty((*SIZE, 3))
    image[:horizon] = sky_radiance(directions[:horizon])
    image[horizon:] = PLAIN * mean_radiance()
    return image.astype(np.float16)


if __name__ == "__main__":
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": texture()}) as file:
        file.write(str(TEXTURE))
    print("ambient color = [" + ", ".join(f"{x:.4f}" for x in mean_radiance()) + "]")
