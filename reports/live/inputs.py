"""Every input of a scene, with its unit, its range and the paper's name beside ours: what the page is built from.

A range here is that of the slider, where what is allowed is wider or open; the model alone refuses.
"""

from collections.abc import Iterator
from typing import Any, get_args

import attrs

from termwise.renderer.terms import names
from termwise.reports.live.state import State, Steps
from termwise.scenes.model import Ambient, Fresnel, Light, Photons, Scene, Sky
from termwise.scenes.terms import TERMS
from termwise.scenes.textures import Texture, Wrap

_LENGTH, _RADIANCE, _DEGREES = "scene units", "radiance", "degrees"
# Units of what lights send, and ends of the sliders of their angles.
_SENT = {"intensity": "radiance × area", "irradiance": "radiance × solid angle", "radiance": "radiance"}
_ANGLES = {"cutoff": 90.0, "angle": 180.0}


@attrs.frozen
class Input:
    """One input.

    Attributes
    ----------
    path : of its value, see `reports.live.state`.
    label : ours.
    paper : the paper's name, or "".
    unit : of the value, or "".
    low, high, step : of a slider; none where `high` is None.
    choices : allowed words, or ().
    part : x, y, z, R, G or B, of an input that is one of three; or "".
    word : what may stand in the place of a number, "inf" or "auto"; "" where nothing may.
    """

    path: Steps
    label: str
    paper: str = ""
    unit: str = ""
    low: float = 0.0
    high: float | None = None
    step: float = 0.01
    choices: tuple[Any, ...] = ()
    part: str = ""
    word: str = ""

    @property
    def name(self) -> str:
        """Label with all that a reader has to know."""
        return self._noted(f"{self.label} {self.part}" if self.part else self.label)

    @property
    def whole(self) -> str:
        """Name of the three that this is a part of."""
        return self._noted(self.label)

    def _noted(self, label: str) -> str:
        notes = [f"paper: {self.paper}" if self.paper else "", self.unit]
        said = ", ".join(note for note in notes if note)
        return f"{label} ({said})" if said else label


def groups(state: State) -> Iterator[tuple[str, list[Input]]]:
    """The inputs of a state, by heading."""
    scene = state.scene
    yield (
        "Estimators",
        [
            *(Input(("variants", term), term, "", "", choices=names(term)) for term in TERMS),
            Input(("samples",), "samples", "max_samples", "per pixel, where refinement ends"),
            Input(("seed",), "seed", "", "equal seeds give equal bits"),
        ],
    )
    yield (
        "Camera",
        [
            *_triple(("scene", "camera", "position"), "position", "", _LENGTH, "xyz"),
            *_triple(("scene", "camera", "target"), "looks at", "", _LENGTH, "xyz"),
            *_triple(("scene", "camera", "up"), "up", "", "direction", "xyz"),
            Input(("scene", "camera", "fov"), "field of view", "FOV", _DEGREES, 1.0, 179.0, 1.0),
            Input(("scene", "camera", "near"), "near distance", "distance", _LENGTH),
            Input(("scene", "resolution", 0), "width", "", "pixels; aspect is width over height"),
            Input(("scene", "resolution", 1), "height", "", "pixels"),
            Input(("scene", "camera", "pixel"), "ray of a pixel", choices=("jitter", "centre", "corner")),
        ],
    )
    yield (
        "Light",
        [
            *(each for number in range(len(scene.lights)) for each in _light(number, scene.lights[number])),
            *(
                each
                for number, thing in enumerate(scene.objects)
                if thing.emits
                for each in (
                    *_triple(("scene", "objects", number, "position"), thing.name, "", _LENGTH, "xyz"),
                    Input(("scene", "objects", number, "size"), f"{thing.name} size", "", "root of its area"),
                    *_or_image(
                        thing.images,
                        ("scene", "objects", number, "emission"),
                        _triple(
                            ("scene", "objects", number, "emission"), f"{thing.name} emission", "", _RADIANCE, "RGB"
                        ),
                    ),
                )
            ),
            Input(
                ("scene", "ambient", "source"),
                "ambient light is",
                choices=get_args(attrs.fields_dict(Ambient)["source"].type),
            ),
            *_triple(("scene", "ambient", "color"), "ambient light", "L_a0", _RADIANCE, "RGB"),
            Input(("scene", "ambient", "range"), "ambient range", "AO distance", f"{_LENGTH} or inf", word="inf"),
            *(
                _triple(("scene", "sky", "color"), "sky", "", _RADIANCE, "RGB")
                if scene.sky.texture is None
                else [
                    *_triple(("scene", "sky", "center"), "sky's centre", "", _LENGTH, "xyz"),
                    Input(("scene", "sky", "radius"), "sky's radius", "", f"{_LENGTH} or inf", word="inf"),
                    Input(
                        ("scene", "sky", "projection"),
                        "sky's projection",
                        choices=get_args(attrs.fields_dict(Sky)["projection"].type),
                    ),
                ]
            ),
        ],
    )
    yield (
        "Switches",
        [
            Input(("scene", "toggles", "ambient_occlusion"), "ambient occlusion"),
            Input(("scene", "toggles", "lighting"), "lighting"),
            Input(("scene", "toggles", "reflections"), "reflections"),
            _choice("shadows", "shadows rule", "shadows"),
            _choice("scope", "direct means"),
            _choice("irradiance", "direct is read from E as"),
            _choice("ignore", "a ray that leaves passes its"),
            _choice("normals", "normals of the"),
            _choice("intersection", "intersection"),
            Input(("scene", "draw_lights"), "lights are drawn"),
            Input(("scene", "max_bounces"), "bounces", "max_bounces", "", 0.0, 16.0, 1.0),
            Input(("scene", "rings"), "rings", "max_samples", "N of the paper's loops"),
        ],
    )
    yield (
        "Photons",
        [
            Input(("scene", "photons", "count"), "photons", "", "a pass"),
            Input(("scene", "photons", "radius"), "radius", "", f"{_LENGTH}, of the first pass"),
            Input(("scene", "photons", "nearest"), "nearest", "k", "photons"),
            Input(("scene", "photons", "survival"), "survival", "", "probability, or auto", word="auto"),
            *(
                Input(("scene", "photons", name), name, choices=get_args(attrs.fields_dict(Photons)[name].type))
                for name in ("kernel", "scattering")
            ),
        ],
    )
    for number, thing in enumerate(scene.objects):
        if not thing.emits:
            material: Steps = ("scene", "objects", number, "material")
            yield (
                thing.name,
                [
                    *_or_image(
                        thing.material.textures,
                        (*material, "color"),
                        _triple((*material, "color"), "color", "", "reflectance", "RGB", high=1.0),
                    ),
                    *_or_image(
                        thing.material.textures,
                        (*material, "gloss"),
                        [Input((*material, "gloss"), "gloss", "g", "", 0.0, 1.0)],
                    ),
                    *_or_image(
                        thing.material.textures,
                        (*material, "roughness"),
                        [Input((*material, "roughness"), "roughness", "", "Beckmann α", 0.01, 1.5)],
                    ),
                    *_triple((*material, "f0"), "F0", "", "reflectance", "RGB", high=1.0),
                    Input((*material, "translucency"), "translucency", "", "share that crosses", 0.0, 1.0),
                    Input((*material, "transparency"), "transparency", "", "share that goes through", 0.0, 1.0),
                    Input((*material, "ior"), "index of refraction", "", "inside over outside", 1.0, 3.0),
                    *_triple((*material, "tint"), "tint", "", "of what goes through", "RGB", high=1.0),
                    Input((*material, "fresnel"), "F is that of", choices=get_args(Fresnel)),
                    Input((*material, "occludes"), "casts a shadow, if transparent"),
                ],
            )


def _or_image(images: dict[str, Texture], path: Steps, plain: list[Input]) -> list[Input]:
    """The inputs of a field of an object; an image stays, and may go on otherwise."""
    if path[-1] not in images:
        return plain
    return [Input((*path, "wrap"), f"{plain[0].label}, an image, beyond its border", choices=get_args(Wrap))]


def _light(number: int, light: Light) -> Iterator[Input]:
    """The inputs of a light that is no object, by its fields."""
    of = f"light {number + 1}"
    for field in attrs.fields(type(light)):
        path: Steps = ("scene", "lights", number, field.name)
        label = of if field.name == "position" else f"{of} {field.name}"
        if field.name == "radius":
            yield Input(path, label, "", _LENGTH)
        elif field.name in ("position", "target", "center"):
            yield from _triple(path, label, "", _LENGTH, "xyz")
        elif field.name == "direction":
            yield from _triple(path, label, "", "of any length", "xyz")
        elif field.name == light.sends:
            yield from _triple(path, label, "", _SENT[field.name], "RGB")
        elif field.default is None:
            yield Input(path, label, "", f"{_DEGREES} from the axis, or auto", word="auto")
        else:
            yield Input(path, label, "", _DEGREES, 0.0, _ANGLES[field.name], 0.1)


def _triple(path: Steps, label: str, paper: str, unit: str, parts: str, high: float | None = None) -> list[Input]:
    return [Input((*path, number), label, paper, unit, high=high, part=part) for number, part in enumerate(parts)]


def _choice(name: str, label: str, paper: str = "") -> Input:
    kind = attrs.fields_dict(Scene)[name].type
    return Input(("scene", name), label, paper, choices=get_args(kind))
