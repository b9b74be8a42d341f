"""A scene from the file of another renderer, as far as the model can say it: what all readers share.

What the model cannot say is refused by the name of its node and of the feature; with `approximate` the nearest thing
that it can say stands in its place, and is listed in the scene's `substitutions`. What a file leaves open is assumed,
and listed there too.
"""

from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.scenes.model import (
    BLACK,
    BLACK_SURFACE,
    Ambient,
    Camera,
    Color,
    Light,
    Material,
    Mesh,
    Object,
    Photons,
    Scene,
    Sky,
    largest,
)
from termwise.scenes.strict import FileError
from termwise.scenes.textures import Texture

MIRROR = 0.01
"""Roughness that stands for none: a smaller one is a lobe that float32 hardly samples."""
LONGEST = 128
"""Pixels of the longer side of a picture whose size no file says."""
_FLAT = 1e-5  # 1 - cosine, of a shading normal that is the face's own
_DENSEST = 50.0  # radii of the photon estimate across the scene
_WHITE: Color = (1.0, 1.0, 1.0)


class Unsaid(FileError):
    """What nothing of the model comes near: noted, so that a reader may go on to name all there is."""


@attrs.define
class Import:
    """A scene while it is read.

    Attributes
    ----------
    path : of the file.
    approximate : whether something else may stand for what the model cannot say.
    substitutions : what does, and what was assumed, a sentence each.
    objects, lights, sky, camera, resolution : what was found; a sky, camera or size of None is assumed.
    hopeless : nodes by what the model has nothing like.
    lacking : nodes by what the model has not, and what `approximate` would take; named by `scene`, all at once.
    """

    path: Path
    approximate: bool
    substitutions: list[str] = attrs.Factory(list)
    objects: list[Object] = attrs.Factory(list)
    lights: list[Light] = attrs.Factory(list)
    sky: Sky | None = None
    camera: Camera | None = None
    resolution: tuple[int, int] | None = None
    hopeless: dict[str, list[str]] = attrs.Factory(dict)
    lacking: dict[tuple[str, str], list[str]] = attrs.Factory(dict)

    def refuse(self, node: str, feature: str) -> Unsaid:
        """An error that names what no surface, light or camera of the model comes near."""
        _append(self.hopeless.setdefault(feature, []), node)
        return Unsaid(f"{self.path}: {self._refused()}")

    def instead(self, node: str, feature: str, taken: str) -> None:
        """Put something in the place of what the model cannot say; where that is not allowed, `scene` will raise."""
        if self.approximate:
            self._note(f"{node}: {feature}: taken is {taken}")
        else:
            _append(self.lacking.setdefault((feature, taken), []), node)

    def check(self) -> None:
        """Refuse what was met so far and cannot be read, the hopeless first.

        Raises
        ------
        FileError : its one line.
        """
        if self.hopeless or self.lacking:
            raise FileError(f"{self.path}: {self._refused()}")

    def _refused(self) -> str:
        """All in one line; what a hopeless node lacks besides is left out."""
        beyond = {node for nodes in self.hopeless.values() for node in nodes}
        hopeless = [
            f"{', '.join(nodes)}: {feature}: the model has none, and nothing like it"
            for feature, nodes in self.hopeless.items()
        ]
        lacking = [
            f"{', '.join(others)}: {feature}: the model has none: --approximate takes {taken}"
            for (feature, taken), nodes in self.lacking.items()
            if (others := [node for node in nodes if node not in beyond])
        ]
        return "; ".join(hopeless + lacking)

    def assume(self, what: str) -> None:
        """Note what the file does not say."""
        self._note(f"assumed: {what}")

    def _note(self, line: str) -> None:
        if line not in self.substitutions:
            self.substitutions.append(line)

    def name(self, wanted: str) -> str:
        """A name that no object has yet."""
        taken = {thing.name for thing in self.objects} | {"", "image"}
        name, count = wanted, 1
        while name in taken:
            count += 1
            name = f"{wanted or 'object'} {count}"
        return name

    def add(
        self,
        name: str,
        points: np.ndarray,
        faces: np.ndarray,
        material: Material,
        *,
        normals: np.ndarray | None = None,
        emission: Color | Texture = BLACK,
        uv: np.ndarray | None = None,
    ) -> None:
        """Add an object.

        Parameters
        ----------
        name : as the file has it.
        points, faces : (V, 3) and (F, 3).
        material : of its surface; with emission black, whatever it is.
        normals : (V, 3) shading normals of any length above 0, or None.
        emission : radiance, a colour or an image.
        uv : (F, 3, 2) where in an image the faces' corners lie, or None.
        """
        mesh = self._mesh(name, points, faces, uv)
        if any(largest(emission)):
            if any(largest(material.color)) or largest(material.gloss) > 0.0 or material.transparency > 0.0:
                self.instead(name, "a lamp that reflects", "a black one")
            if material.transparency > 0.0:
                material = BLACK_SURFACE
        elif normals is not None:
            mesh = self._smooth(name, mesh, normals)
        self.objects.append(Object(self.name(name), mesh, material, emission))

    def _mesh(self, name: str, points: np.ndarray, faces: np.ndarray, uv: np.ndarray | None = None) -> Mesh:
        try:
            return Mesh.from_arrays(points, faces, uv=uv)
        except ValueError as error:
            raise FileError(f"{self.path}: {name}: {error}") from None

    def _smooth(self, name: str, mesh: Mesh, normals: np.ndarray) -> Mesh:
        """The mesh with shading normals, or as it is where they are those of its faces.

        A mesh whose normals are on its other side, as of one that was mirrored, is turned: it looks the same from both.
        """
        unit, cosines = self._against(name, mesh, normals)
        if cosines.mean() < 0.0:
            mesh, cosines = turned(mesh, np.ones(len(mesh.faces), bool)), -cosines
        if (cosines > 1.0 - _FLAT).all():
            return mesh
        return attrs.evolve(mesh, normals=unit.astype(np.float32).astype(np.float64))

    def outwards(self, name: str, points: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Faces of a lamp, turned to the side that its normals (V, 3) are on."""
        mesh = self._mesh(name, points, faces)
        _, cosines = self._against(name, mesh, normals)
        if (np.abs(cosines) <= 1.0 - _FLAT).any():
            self.instead(
                name, "a lamp whose normals are not its faces'", "those of the faces, on the side of the others"
            )
        return turned(mesh, cosines.mean(axis=1) < 0.0).faces

    def _against(self, name: str, mesh: Mesh, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals (V, 3), and (F, 3) their cosines with those of the faces: 1 where a face has no area."""
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        if not (length[np.unique(mesh.faces)] > 0.0).all():
            raise FileError(f"{self.path}: {name}: normals: one has no length: allowed are unit vectors")
        unit = np.divide(normals, length, out=np.zeros_like(mesh.vertices), where=length > 0.0)
        corners = mesh.vertices[mesh.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(across, axis=1)
        cosines = np.ones(mesh.faces.shape)
        cosines[size > 0.0] = np.einsum(
            "fkc,fc->fk", unit[mesh.faces[size > 0.0]], across[size > 0.0] / size[size > 0.0, None]
        )
        return unit, cosines

    def scene(self) -> Scene:
        """The whole; lamps are in the picture, for other renderers show them."""
        self.check()
        bounds = self._bounds()
        extent = float(np.max(bounds[1] - bounds[0])) or 1.0
        if not self.objects:
            raise FileError(f"{self.path}: holds no surface: allowed is a scene with at least one triangle")
        width, height = self.resolution or (LONGEST, LONGEST)
        if self.camera is None:
            self.camera = _framing(*bounds)
            self.assume("a camera that sees all of it, z up, for the file has none")
            if self.sky is None and self._hides_lights(self.camera.position):
                self.assume("faces hide all lights from that camera: of a closed room it sees the dark outside")
        sky = self.sky or Sky()
        if self.sky is None and not self.lights and not any(thing.emits for thing in self.objects):
            if self.approximate:
                sky = Sky(color=_WHITE)
                self.assume("a constant sky of radiance 1, for the file has no light")
            else:
                self.assume("no light, for the file has none: --approximate takes a constant sky of radiance 1")
        return Scene(
            self.path.stem,
            self.camera,
            tuple(self.objects),
            tuple(self.lights),
            ambient=Ambient() if sky.is_black else Ambient(source="sky"),
            sky=sky,
            photons=Photons(radius=extent / _DENSEST),
            resolution=(width, height),
            draw_lights=True,
            substitutions=tuple(self.substitutions),
        )

    def _hides_lights(self, eye: Any) -> bool:
        """Whether there are lights, and from a point none is seen: of a lamp the centroid, from its front."""
        corners = np.concatenate([thing.mesh.vertices[thing.mesh.faces] for thing in self.objects])
        places = [np.array(thing.mesh.centroid()) for thing in self.objects if thing.emits]
        places += [np.array(light.centre) for light in self.lights if light.centre is not None]
        if not places or len(places) < sum(thing.emits for thing in self.objects) + len(self.lights):
            return False  # what shines from afar is seen
        return all(_hidden(np.asarray(eye, float), place, corners) for place in places)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        places = [thing.mesh.vertices for thing in self.objects] or [np.zeros((1, 3))]
        return np.min([each.min(axis=0) for each in places], axis=0), np.max(
            [each.max(axis=0) for each in places], axis=0
        )

    def clipped(self, camera: Camera, near: float, far: float) -> None:
        """Note where a camera's planes would, or might, cut geometry off."""
        from trimesh import triangles  # takes seconds to load

        _, _, forward = camera.frame()
        width, height = self.resolution or (1, 1)
        across = np.tan(np.radians(camera.fov) / 2.0)
        corner = near * np.hypot(1.0, across * np.hypot(1.0, height / width))
        for thing in self.objects:
            corners = thing.mesh.vertices[thing.mesh.faces]
            there = np.broadcast_to(np.asarray(camera.position), (len(corners), 3))
            with np.errstate(all="ignore"):  # of triangles without an area
                apart = np.linalg.norm(triangles.closest_point(corners, there) - there, axis=1)
            if np.nanmin(apart) < corner or ((thing.mesh.vertices - camera.position) @ forward).max() > far:
                planes = f"planes at {near:g} and {far:g}, between which not all of {thing.name} is"
                self.instead("camera", planes, "one that cuts nothing off")


def turned(mesh: Mesh, chosen: np.ndarray) -> Mesh:
    """The mesh with the faces of a mask (F,) turned, which then look the other way."""
    faces = np.where(chosen[:, None], mesh.faces[:, ::-1], mesh.faces)
    uv = None if mesh.uv is None else np.where(chosen[:, None, None], mesh.uv[:, ::-1], mesh.uv)
    return attrs.evolve(mesh, faces=faces, uv=uv)


def _hidden(eye: np.ndarray, place: np.ndarray, corners: np.ndarray) -> bool:
    """Whether a triangle of (F, 3, 3) stands between two points, well before the second (Möller and Trumbore)."""
    way = place - eye
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(way, second)
    from_corner = eye - corners[:, 0]
    turned_once = np.cross(from_corner, first)
    with np.errstate(all="ignore"):  # triangles along the way
        scale = 1.0 / np.einsum("fc,fc->f", first, across)
        u = scale * np.einsum("fc,fc->f", from_corner, across)
        v = scale * (turned_once @ way)
        t = scale * np.einsum("fc,fc->f", second, turned_once)
    return bool(((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0 - 1e-3)).any())


def _append(names: list[str], name: str) -> None:
    if name not in names:
        names.append(name)


def coated(color: Any, *, metallic: float, f0: float, roughness: float) -> Material:
    """Our nearest to a metal mixed with a dielectric over a Lambertian base, equal to it at normal incidence.

    There it reflects `(1 - m) F0 + m c` by the lobe and `(1 - m) (1 - F0) c` by the base.

    Parameters
    ----------
    color : c, three numbers.
    metallic : m, share of the metal.
    f0 : F0 of the dielectric.
    roughness : alpha.
    """
    gloss = metallic + (1.0 - metallic) * f0
    # A share that is 1 may come out a rounding above it.
    lobe = [min(((1.0 - metallic) * f0 + metallic * c) / gloss, 1.0) if gloss > 0.0 else 0.0 for c in color]
    return Material(tuple(color), gloss, float(np.clip(roughness, MIRROR, 1.5)), tuple(lobe))


def look(position: Any, forward: Any, up: Any, fov: float) -> Camera:
    """A camera by its directions, `fov` in degrees across the width."""
    position = np.asarray(position, float)
    return Camera(tuple(position), tuple(position + np.asarray(forward, float)), tuple(np.asarray(up, float)), fov)


def _framing(low: np.ndarray, high: np.ndarray) -> Camera:
    """A camera in front, to the right and above of the ball about a box, which it sees whole."""
    radius = float(np.linalg.norm(high - low)) / 2.0 or 1.0
    fov, direction = 40.0, np.array([0.4, -0.8, 0.45])
    centre = (low + high) / 2.0
    away = radius / np.sin(np.radians(fov / 2.0)) / np.linalg.norm(direction)
    return look(centre + away * direction, -direction, (0.0, 0.0, 1.0), fov)
