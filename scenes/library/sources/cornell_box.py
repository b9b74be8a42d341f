"""The Cornell box: colours of its walls, places of its blocks; prints the numbers of `cornell_box.toml`.

The measured reflectances of the three paints, 400 to 700 nm by 4 nm, become linear Rec. 709 colours under
D65. The data have Y up and Z away from the camera; here a unit is 100 of theirs, z is up, y is away from the
camera, and the origin is the middle of the floor:
`(x, y, z) = ((278 - X) / 100, (Z - 279.6) / 100, Y / 100)`, which keeps handedness (red wall at the left).

Spectra and geometry: Cornell University Program of Computer Graphics, "Cornell Box Data",
https://www.graphics.cornell.edu/online/box/data.html
"""

import numpy as np
from rec709 import linear_rec709

WAVELENGTHS = np.arange(400, 701, 4)  # nm
PAINTS = {
    name: np.array(values.split(), np.float64)
    for name, values in {
        "white": """
            .343 .445 .551 .624 .665 .687 .708 .723 .715 .710 .745 .758 .739 .767 .777 .765 .751 .745
            .748 .729 .745 .757 .753 .750 .746 .747 .735 .732 .739 .734 .725 .721 .733 .725 .732 .743
            .744 .748 .728 .716 .733 .726 .713 .740 .754 .764 .752 .736 .734 .741 .740 .732 .745 .755
            .751 .744 .731 .733 .744 .731 .712 .708 .729 .730 .727 .707 .703 .729 .750 .760 .751 .739
            .724 .730 .740 .737
        """,
        "green": """
            .092 .096 .098 .097 .098 .095 .095 .097 .095 .094 .097 .098 .096 .101 .103 .104 .107 .109
            .112 .115 .125 .140 .160 .187 .229 .285 .343 .390 .435 .464 .472 .476 .481 .462 .447 .441
            .426 .406 .373 .347 .337 .314 .285 .277 .266 .250 .230 .207 .186 .171 .160 .148 .141 .136
            .130 .126 .123 .121 .122 .119 .114 .115 .117 .117 .118 .120 .122 .128 .132 .139 .144 .146
            .150 .152 .157 .159
        """,
        "red": """
            .040 .046 .048 .053 .049 .050 .053 .055 .057 .056 .059 .057 .061 .061 .060 .062 .062 .062
            .061 .062 .060 .059 .057 .058 .058 .058 .056 .055 .056 .059 .057 .055 .059 .059 .058 .059
            .061 .061 .063 .063 .067 .068 .072 .080 .090 .099 .124 .154 .192 .255 .287 .349 .402 .443
            .487 .513 .558 .584 .620 .606 .609 .651 .612 .610 .650 .638 .627 .620 .630 .628 .642 .639
            .657 .639 .635 .642
        """,
    }.items()
}

# Corners (X, Z) of the blocks' tops in the data's units, in order around the top.
BLOCKS = {
    "short block": ((130, 65), (82, 225), (240, 272), (290, 114)),
    "tall block": ((423, 247), (265, 296), (314, 456), (472, 406)),
}


def paint(name: str) -> np.ndarray:
    """Linear Rec. 709 colour of a paint ("white", "green", "red") under D65, (3,)."""
    return linear_rec709(WAVELENGTHS, PAINTS[name])


def footprint(name: str) -> tuple[np.ndarray, float, float]:
    """Square nearest to a block's measured quadrilateral, whose corners miss a square by a few units.

    Returns
    -------
    center (x, y) and side (root of the quadrilateral's area) in scene units; turn about z in degrees, within (-45, 45].
    """
    x, z = np.array(BLOCKS[name], np.float64).T
    corners = (278 - x) / 100 + 1j * (z - 279.6) / 100  # complex plane: x + iy
    center = corners.mean()
    following = np.roll(corners, -1)
    area = abs(np.sum(corners.real * following.imag - following.real * corners.imag)) / 2
    # The fourth power maps a square's four edge directions onto one.
    turn = np.degrees(np.angle(np.sum((following - corners) ** 4)) / 4)
    return np.array([center.real, center.imag]), float(np.sqrt(area)), float(turn)


if __name__ == "__main__":
    for name in PAINTS:
        print(f"{name}: color = [" + ", ".join(f"{x:.4f}" for x in paint(name)) + "]")
    for name in BLOCKS:
        (x, y), side, turn = footprint(name)
        print(f"{name}: center = ({x:.3f}, {y:.3f}), side = {side:.3f}, turn = {turn:.1f} degrees")
