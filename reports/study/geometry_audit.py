"""Mitsuba's answers held against float64: what rays meet, and which points see each other, about a thousand times.

Second integrators share the references' rays, and single precision with them. Here rays through points spread over the
picture are traced as the references trace them (`reference.sights`); from the surface that is met a point of a light is
looked at, and a ray leaves, from whose end a light is looked at again. All of it is asked of
`crossings` too. Answers may differ where float32 cannot tell: within `DOUBT` a few of them, by chance; beyond it none.
Nor may a point of the picture lie elsewhere by more than a share of its pixel, or off its face by more than a share of
its distance to the light.
"""

import time
from typing import Any

import attrs
import numpy as np

from termwise import reference
from termwise.reference.translate import Canonical
from termwise.reports.study.crossings import Crossings, Soup
from termwise.scenes.model import DirectionalLight, Scene, SphereLight, SunLight, Vector

POINTS = 320
DOUBT = 2.0**-13
"""At the canonical scale (its largest side is 50 to 100), four times what references lift a point off its face by."""
EXACT = 1e-10
"""The same of float64."""
CHANCE = 0.005
"""Share of all answers that may differ within the doubt."""
OF_PIXEL = 0.05
OF_DISTANCE = 0.01


@attrs.frozen
class Finding:
    """What became of a scene's audit.

    Attributes
    ----------
    scene : name.
    asked : answers that were compared.
    differ : how many differ.
    place : of the first that does, in one sentence; None where they may.
    seconds : that it took.
    """

    scene: str
    asked: int
    differ: int
    place: str | None
    seconds: float


@attrs.define
class _Tally:
    """Answers that differ: surely, within the doubt, and of how many."""

    asked: int = 0
    sure: list[str] = attrs.field(factory=list)
    doubtful: list[str] = attrs.field(factory=list)


def audit(scene: Scene, *, seed: int) -> Finding:
    """Compare about `4 * POINTS` answers; `seed` chooses the points."""
    begin = time.perf_counter()
    tally = _Audit(scene, seed).tally() if scene.objects else _Tally()
    differ = len(tally.sure) + len(tally.doubtful)
    failed = tally.sure or (tally.doubtful if len(tally.doubtful) > CHANCE * tally.asked else [])
    return Finding(scene.name, tally.asked, differ, failed[0] if failed else None, time.perf_counter() - begin)


class _Audit:
    def __init__(self, scene: Scene, seed: int) -> None:
        self.scene, self.loaded = scene, reference.loaded(scene)
        from termwise.reference import sights  # Mitsuba's variant is chosen now

        self.mitsuba = sights
        self.rng = np.random.default_rng(seed)
        self.canonical = Canonical.of(scene)
        meshes = [thing.mesh for thing in scene.objects]
        self.soup = Soup(np.concatenate([self.canonical.points(mesh.vertices)[mesh.faces] for mesh in meshes]))
        counts = [len(mesh.faces) for mesh in meshes]
        self.first = np.cumsum([0, *counts[:-1]])
        self.owner = np.repeat(np.arange(len(counts)), counts)
        self.reach = 2.0 * float(np.linalg.norm(np.abs(self.soup.corners).max(axis=(0, 1)))) + 1.0
        self.film = self._film()
        self.found = _Tally()

    def _film(self) -> np.ndarray:
        """Points spread over the film, as float32 holds them."""
        lattice = np.arange(1, POINTS + 1)[:, None] * [0.7548776662466927, 0.5698402909980532]  # Roberts' sequence
        return np.mod(lattice + self.rng.random(2), 1.0).astype(np.float32).astype(np.float64)

    def tally(self) -> _Tally:
        """Ask and compare."""
        origin, direction = self.mitsuba.camera_rays(self.loaded, self.film)
        lights = self._lights()
        met = self._sights(origin, direction, lights)
        begin, end = self._camera_segments()
        self._compare_hits(met, begin, end, None, "the camera")
        self._compare_places(met, begin, end)
        self._compare_light(met, self._facing(met, direction), *lights)

        lights = self._lights()
        here, direction, start = met.face >= 0, met.direction, self._on_face(met)
        then = self._sights(met.origin, direction, lights)
        then = then._replace(face=np.where(here, then.face, -1), object=np.where(here, then.object, -1))
        self._compare_hits(then, start, start + self.reach * direction, met, "a ray", here)
        self._compare_light(then, self._facing(then, direction), *lights)
        return self.found

    def _sights(self, origin: np.ndarray, direction: np.ndarray, lights: tuple[np.ndarray, ...]) -> Any:
        leaving = _unit(self.rng.normal(size=(POINTS, 3)))
        return self.mitsuba.sights(self.loaded, origin, direction, target=lights[0], normal=lights[1], leaving=leaving)

    def _camera_segments(self) -> tuple[np.ndarray, np.ndarray]:
        """What the camera's rays cross of the ball about the scene, in float64."""
        direction = self.scene.camera.rays(self.film, aspect=self.scene.aspect)
        origin = self.canonical.points(self.scene.camera.position)
        middle = -direction @ origin
        half = np.sqrt(np.maximum((self.reach / 2) ** 2 - ((origin + middle[:, None] * direction) ** 2).sum(axis=1), 0))
        begin, end = np.maximum(middle - half, 0.0), np.maximum(middle + half, 0.0)
        return origin + begin[:, None] * direction, origin + end[:, None] * direction

    def _number(self, met: Any) -> np.ndarray:
        """Faces among those of all objects; 0 on a miss."""
        return np.where(met.face >= 0, self.first[met.object] + met.face, 0)

    def _facing(self, met: Any, direction: np.ndarray) -> np.ndarray:
        """Normals of the faces that were met, on the side of the rays."""
        normal = self.soup.normals[self._number(met)]
        return normal * -np.sign(np.einsum("nx,nx->n", normal, direction))[:, None]

    def _height(self, met: Any) -> np.ndarray:
        """Of the points that were met, above their faces."""
        number = self._number(met)
        return np.einsum("nx,nx->n", met.position - self.soup.corners[number, 0], self.soup.normals[number])

    def _on_face(self, met: Any) -> np.ndarray:
        """The points that were met, moved onto the planes of their faces."""
        return met.position - self._height(met)[:, None] * self.soup.normals[self._number(met)]

    def _lights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A point of a light for each point of the film, the normal and the number of its face; 0 and -1 of a point's.

        A sphere's has a normal and no face.

        All lights are as likely, and all points of one. Of a light that is nowhere they are those of a disc as large as
        the scene, as far away as shadow rays go. Without any light, points of all faces stand for them.
        """
        emitting = [number for number, thing in enumerate(self.scene.objects) if thing.emits]
        lights = self.scene.lights
        if not emitting and not lights:
            emitting = list(range(len(self.scene.objects)))
        chosen = self.rng.integers(len(lights) + len(emitting), size=POINTS)
        target, normal, face = np.zeros((POINTS, 3)), np.zeros((POINTS, 3)), np.full(POINTS, -1)
        for number, light in enumerate(lights):
            here = np.flatnonzero(chosen == number)
            if isinstance(light, DirectionalLight | SunLight):
                target[here] = self._far(light.way, len(here))
                continue
            target[here] = self.canonical.points(light.centre)
            if isinstance(light, SphereLight):
                normal[here] = _unit(self.rng.normal(size=(len(here), 3)))
                target[here] += light.radius * self.canonical.scale * normal[here]
        for number, thing in enumerate(emitting, start=len(lights)):
            here = np.flatnonzero(chosen == number)
            its = np.flatnonzero(self.owner == thing)
            corners = self.soup.corners[its]
            area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            if not area.any():
                continue
            face[here] = its[self.rng.choice(len(its), size=len(here), p=area / area.sum())]
            normal[here] = self.soup.normals[face[here]]
            share = self.rng.dirichlet(np.ones(3), len(here))
            target[here] = np.einsum("nc,ncx->nx", share, self.soup.corners[face[here]])
        return target, normal, face

    def _far(self, way: Vector, count: int) -> np.ndarray:
        """Points (count, 3) of a disc from which light along `way` falls on the scene."""
        aside = self.rng.normal(size=(count, 3))
        aside -= np.outer(aside @ way, way)
        distance = 0.5 * self.reach * np.sqrt(self.rng.random((count, 1)))
        return distance * _unit(aside) - 2.0 * self.reach * np.array(way)

    def _by_spheres(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Segments (N,) bool that a sphere may have to do with: `crossings` know triangles alone.

        One that ends on the near side of a sphere has nothing to do with it.
        """
        touched = np.zeros(len(begin), bool)
        way = end - begin
        for sphere in self.scene.spheres:
            center, radius = self.canonical.points(sphere.center), sphere.radius * self.canonical.scale
            square = np.einsum("nx,nx->n", way, way)
            along = np.einsum("nx,nx->n", center - begin, way) / np.where(square > 0.0, square, 1.0)
            nearest = begin + np.clip(along, 0.0, 1.0)[:, None] * way
            ends_there = np.abs(np.linalg.norm(end - center, axis=1) - radius) < DOUBT
            touched |= (np.linalg.norm(nearest - center, axis=1) < radius + DOUBT) & ~(ends_there & (along >= 1.0))
        return touched

    # Comparing.

    def _passed(self, crossings: Crossings, left: np.ndarray, target: np.ndarray | None = None) -> Crossings:
        """Without the face, or the object, that a segment leaves, and the face that it ends on."""
        own = left[crossings.segment]
        passed = crossings.face == own
        if self.scene.ignore == "object":
            passed = self.owner[crossings.face] == self.owner[own]
        if target is not None:
            passed |= crossings.face == target[crossings.segment]
        return Crossings(*(column[~passed] for column in crossings))

    def _compare_hits(
        self, met: Any, begin: np.ndarray, end: np.ndarray, left: Any, what: str, asked: np.ndarray | None = None
    ) -> None:
        """Whether a surface is met, of which object, and where."""
        crossings = self.soup.crossings(begin, end, within=DOUBT)
        if left is not None:
            crossings = self._passed(crossings, self._number(left))
        asked = np.ones(len(begin), bool) if asked is None else asked
        asked = asked & ~self._by_spheres(begin, end)
        self.found.asked += int(asked.sum())
        thing = np.where(met.face >= 0, met.object, -1)
        length = np.linalg.norm(end - begin, axis=1)
        sure: np.ndarray = np.zeros(len(begin), bool)
        for doubt, places in ((DOUBT, self.found.sure), (EXACT, self.found.doubtful)):
            face, decided = nearest(crossings, length, doubt)
            right = np.where(face >= 0, self.owner[face], -1)
            differs = asked & decided & (thing != right) & ~sure
            sure |= differs
            for index in np.flatnonzero(differs).tolist():
                places.append(
                    f"{what} in pixel {self._pixel(index)} meets {self._named(self._face(met, index))}, "
                    f"and by float64 {self._named(int(face[index]))}"
                )

    def _compare_places(self, met: Any, begin: np.ndarray, end: np.ndarray) -> None:
        """How far the points of the picture are from where float64 has them, against their pixels."""
        way = _unit(end - begin)
        normal = self.soup.normals[self._number(met)]
        cosine = np.einsum("nx,nx->n", normal, way)
        corner = self.soup.corners[self._number(met), 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.einsum("nx,nx->n", corner - begin, normal) / cosine
            right = begin + distance[:, None] * way
            camera = self.canonical.points(self.scene.camera.position)
            pixel = 2.0 * np.tan(np.radians(self.scene.camera.fov) / 2.0) / max(self.scene.resolution)
            footprint = pixel * np.linalg.norm(right - camera, axis=1) / np.abs(cosine)
            error = np.linalg.norm(self._on_face(met) - right, axis=1)
            far = (met.face >= 0) & (error > OF_PIXEL * footprint)
        for index in np.flatnonzero(far).tolist():
            self.found.doubtful.append(
                f"what the camera sees in pixel {self._pixel(index)}, {self._named(self._face(met, index))}, lies "
                f"{error[index] / footprint[index]:.2g} pixels from where float64 has it"
            )

    def _compare_light(
        self, met: Any, normal: np.ndarray, target: np.ndarray, its_normal: np.ndarray, its_face: np.ndarray
    ) -> None:
        """Whether a point of a light is hidden, where both faces are turned to each other."""
        start, own = self._on_face(met), self._number(met)
        way = target - start
        asked = (met.face >= 0) & (np.einsum("nx,nx->n", way, normal) > 0.0) & (own != its_face)
        asked &= ~its_normal.any(axis=1) | (np.einsum("nx,nx->n", way, its_normal) < 0.0)
        asked &= ~self._by_spheres(start, target)
        if self.scene.ignore == "object":
            asked &= (its_face < 0) | (self.owner[own] != self.owner[its_face])
        index = np.flatnonzero(asked)
        self.found.asked += len(index)
        crossings = self._passed(
            self.soup.crossings(start[index], target[index], within=DOUBT), own[index], its_face[index]
        )
        length = np.linalg.norm(way[index], axis=1)
        sure: np.ndarray = np.zeros(len(index), bool)
        for doubt, places in ((DOUBT, self.found.sure), (EXACT, self.found.doubtful)):
            face, decided = _blocked(crossings, len(index), doubt)
            differs = decided & (met.hidden[index] != (face >= 0)) & ~sure
            sure |= differs
            for number in np.flatnonzero(differs).tolist():
                between = self._named(int(face[number])) if face[number] >= 0 else "nothing"
                places.append(
                    f"a light is {'hidden' if face[number] < 0 else 'seen'} from "
                    f"{self._named(self._face(met, index[number]))}, in pixel {self._pixel(index[number])}, "
                    f"and by float64 {between} is between"
                )
        off = np.abs(self._height(met))[index] > OF_DISTANCE * length
        for number in np.flatnonzero(off & ~sure).tolist():
            self.found.doubtful.append(
                f"a point of {self._named(self._face(met, index[number]))}, in pixel {self._pixel(index[number])}, "
                "lies off its face by more than a hundredth of its distance to a light"
            )

    # Naming.

    def _face(self, met: Any, index: int) -> int:
        return int(self.first[met.object[index]] + met.face[index]) if met.face[index] >= 0 else -1

    def _named(self, face: int) -> str:
        if face < 0:
            return "nothing"
        thing = int(self.owner[face])
        return f"{self.scene.objects[thing].name}, face {face - int(self.first[thing])}"

    def _pixel(self, index: int) -> tuple[int, int]:
        width, height = self.scene.resolution
        x, y = self.film[index]
        return min(int(x * width), width - 1), min(int(y * height), height - 1)


def nearest(crossings: Crossings, length: np.ndarray, doubt: float) -> tuple[np.ndarray, np.ndarray]:
    """The first face that each segment crosses (-1: none); and whether a move by `doubt` changes nothing."""
    count = len(length)
    distance = crossings.fraction * length[crossings.segment]
    sure = np.flatnonzero(crossings.margin > doubt)
    order = sure[np.argsort(-distance[sure], kind="stable")]
    face, first = np.full(count, -1), np.full(count, np.inf)
    face[crossings.segment[order]] = crossings.face[order]  # of each segment the last, which is the nearest
    first[crossings.segment[order]] = distance[order]
    other = (crossings.margin > -doubt) & (crossings.face != face[crossings.segment])
    rival = other & (distance <= first[crossings.segment] + doubt)
    decided = np.ones(count, bool)
    decided[crossings.segment[rival]] = False
    return face, decided


def _blocked(crossings: Crossings, count: int, doubt: float) -> tuple[np.ndarray, np.ndarray]:
    """A face that surely blocks each segment (-1: none); and whether a move by `doubt` changes nothing."""
    face, decided = np.full(count, -1), np.ones(count, bool)
    decided[crossings.segment[crossings.margin > -doubt]] = False
    sure = crossings.margin > doubt
    face[crossings.segment[sure]] = crossings.face[sure]
    decided[crossings.segment[sure]] = True
    return face, decided


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
