"""What glTF 2.0 allows where its materials, lights and cameras have a number: kind and range of what is read.

`check` refuses the first that is something else, by its name, value, and what is allowed. Where a number beyond its
range still means one thing, as of an `emissiveFactor` above 1, it is let pass.
"""

import math
from typing import Any

import attrs

from termwise.scenes.strict import FileError


@attrs.frozen
class _Numbers:
    """One number, or a list of `count`, in a range."""

    low: float = -math.inf
    high: float = math.inf
    count: int | None = None
    whole: bool = False
    above: bool = False
    """Whether `low` itself is no value."""

    def holds(self, value: Any) -> bool:
        """Whether a value is what is allowed."""
        if self.count is None:
            return self._one(value)
        return isinstance(value, list) and len(value) == self.count and all(map(self._one, value))

    def _one(self, value: Any) -> bool:
        if isinstance(value, bool) or not isinstance(value, int if self.whole else int | float):
            return False
        return math.isfinite(value) and self.low <= value <= self.high and not (self.above and value == self.low)

    def __str__(self) -> str:
        kind = "an integer" if self.whole else "a number" if self.count is None else f"{self.count} numbers"
        left = "(" if self.above or math.isinf(self.low) else "["
        return f"{kind} in {left}{self.low:g}, {self.high:g}{')' if math.isinf(self.high) else ']'}"


_SHARE, _FACTOR, _FINITE = _Numbers(0.0, 1.0), _Numbers(0.0), _Numbers()
_INDEX = _Numbers(0, whole=True)
_TEXTURE = {
    "index": _INDEX,
    "texCoord": _INDEX,
    "extensions": {
        "KHR_texture_transform": {
            "offset": _Numbers(count=2),
            "rotation": _FINITE,
            "scale": _Numbers(count=2),
            "texCoord": _INDEX,
        }
    },
}
MATERIAL: dict[str, Any] = {
    "doubleSided": bool,
    "alphaMode": ("OPAQUE", "MASK", "BLEND"),
    "emissiveFactor": _Numbers(0.0, count=3),
    "emissiveTexture": _TEXTURE,
    "normalTexture": _TEXTURE,
    "occlusionTexture": _TEXTURE,
    "pbrMetallicRoughness": {
        "baseColorFactor": _Numbers(0.0, 1.0, 4),
        "metallicFactor": _SHARE,
        "roughnessFactor": _SHARE,
        "baseColorTexture": _TEXTURE,
        "metallicRoughnessTexture": _TEXTURE,
    },
    "extensions": {
        "KHR_materials_diffuse_transmission": {
            "diffuseTransmissionFactor": _SHARE,
            "diffuseTransmissionColorFactor": _Numbers(0.0, count=3),
            "diffuseTransmissionTexture": _TEXTURE,
            "diffuseTransmissionColorTexture": _TEXTURE,
        },
        "KHR_materials_emissive_strength": {"emissiveStrength": _FACTOR},
        "KHR_materials_ior": {"ior": _FACTOR},
        "KHR_materials_specular": {
            "specularFactor": _SHARE,
            "specularColorFactor": _Numbers(0.0, count=3),
            "specularTexture": _TEXTURE,
            "specularColorTexture": _TEXTURE,
        },
        "KHR_materials_transmission": {"transmissionFactor": _SHARE, "transmissionTexture": _TEXTURE},
        "KHR_materials_volume": {
            "thicknessFactor": _FACTOR,
            "thicknessTexture": _TEXTURE,
            "attenuationDistance": _Numbers(0.0, above=True),
            "attenuationColor": _Numbers(0.0, 1.0, 3),
        },
    },
}
LIGHT: dict[str, Any] = {
    "color": _Numbers(0.0, count=3),
    "intensity": _FACTOR,
    "range": _Numbers(0.0, above=True),
    "spot": {
        "innerConeAngle": _Numbers(0.0, math.pi / 2.0),
        "outerConeAngle": _Numbers(0.0, math.pi / 2.0, above=True),
    },
}
CAMERA: dict[str, Any] = {
    "perspective": {
        "yfov": _Numbers(0.0, math.pi, above=True),
        "aspectRatio": _Numbers(0.0, above=True),
        "znear": _Numbers(0.0, above=True),
        "zfar": _Numbers(0.0, above=True),
    }
}


def check(where: str, given: Any, allowed: dict[str, Any]) -> None:
    """Refuse what a description holds in the place of a field that is read; other fields are let pass.

    Parameters
    ----------
    where : file and node, as a message begins.
    given : the description, as JSON has it.
    allowed : `MATERIAL`, `LIGHT` or `CAMERA`.

    Raises
    ------
    FileError : one line: where, the field, its value, what is allowed.
    """
    _check(where, "", given, allowed)


def _check(where: str, field: str, given: Any, allowed: Any) -> None:
    if isinstance(allowed, dict):
        if isinstance(given, dict):
            for name, value in given.items():
                if name in allowed:
                    _check(where, f"{field}.{name}" if field else name, value, allowed[name])
            return
        holds, said = False, "an object"
    elif isinstance(allowed, _Numbers):
        holds, said = allowed.holds(given), str(allowed)
    elif allowed is bool:
        holds, said = isinstance(given, bool), "true or false"
    else:
        holds, said = isinstance(given, str) and given in allowed, ", ".join(allowed)
    if not holds:
        value = repr(given)
        short = value if len(value) <= 80 else f"{value[:80]}..."
        raise FileError(f"{where}: {field + ' = ' if field else ''}{short}: allowed is {said}")
