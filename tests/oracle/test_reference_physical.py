"""Full light transport split by term: the parts add up, and each is what its name says."""

import itertools

import attrs
import numpy as np
import pytest
import trimesh

from termwise import reference
from termwise.reference import backend, store
from termwise.scenes.limits import physical
from termwise.scenes.model import Camera, Material, Mesh, Object, PointLight, Scene, Sky
from termwise.scenes.terms import TABLE

GLOSSY = Material(color=(0.8, 0.6, 0.3), gloss=0.5, roughness=0.3, f0=(1.0, 0.8, 0.5))
TEXTURE = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)


def rectangle(name: str, height: float, half: float, material: Material = GLOSSY, *, down: bool = False) -> Object:
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0, 0, height]
    return Object(name, Mesh.from_arrays(corners, [[0, 2, 1], [0, 3, 2]] if down else [[0, 1, 2], [0, 2, 3]]), material)


def lit_scene(sky: Sky) -> Scene:
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    lamp = attrs.evolve(rectangle("lamp", 2.0, 0.3, down=True), emission=(9.0, 8.0, 7.0))
    cube = Object("cube", Mesh.from_arrays(box.vertices + [0, 0, 0.5], box.faces), GLOSSY)
    return Scene(
        "lit",
        Camera(position=(3.0, 2.0, 2.0), target=(0.0, 0.0, 0.6)),
        (rectangle("ground", 0.0, 2.0), cube, lamp),
        lights=(PointLight((1.0, 1.0, 1.5), (3.0, 3.0, 3.0)),),
        sky=sky,
        resolution=(32, 32),
    )


@pytest.mark.slow
@pytest.mark.skipif(backend.choose().variant == "scalar_rgb", reason="a million paths, one by one")
@pytest.mark.parametrize(
    ("sky", "depth"),
    [(Sky((0.2, 0.4, 0.8)), None), (Sky((0.2, 0.4, 0.8)), 2), (Sky(texture=TEXTURE, radius=6.0), None)],
    ids=["constant", "two-deep", "texture"],
)
def test_parts_add_up_to_plain_path(sky, depth):
    """ambient + direct + specular = Mitsuba's `path` in the same scene, within the noise of 8 batches each."""
    scene = lit_scene(sky)
    count, spp = 8, 256
    limit = reference.shared(scene, attrs.evolve(physical("ambient"), depth=depth))
    parts = [reference.replicate_parts(scene, limit, spp=spp, seed=1, replicate=k) for k in range(count)]
    sums = np.array([np.sum(list(part.values()), axis=0).mean(axis=(0, 1), dtype=float) for part in parts])

    import drjit as dr
    import mitsuba as mi

    from termwise.reference.wavefront import meets_surface, pixel_means

    here = reference.loaded(scene)
    # What is left after 64 segments is 1e-6 at an albedo of 0.8; `hide_emitters` lets camera rays through a lamp.
    segments = 64 if depth is None else depth + 1
    plain = mi.load_dict({"type": "path", "max_depth": segments, "rr_depth": 65, "hide_emitters": True})

    def estimate(samples):
        lit = meets_surface(here.scenes["physical"].ray_intersect(samples.ray))
        color, _, _ = plain.sample(here.scenes["physical"], samples.sampler, mi.RayDifferential3f(samples.ray))
        return (dr.select(lit, color, 0.0),)

    camera = here.description["camera"]
    whole = np.array(
        [pixel_means(estimate, camera, spp=spp, seed=10**6 + k)[0].mean(axis=(0, 1)) for k in range(count)]
    )
    error = np.sqrt((sums.var(axis=0, ddof=1) + whole.var(axis=0, ddof=1)) / count)
    assert (np.abs(sums.mean(axis=0) - whole.mean(axis=0)) < 5 * error).all()
    assert (error < 3e-3 * whole.mean(axis=0)).all()
    for term, image in parts[0].items():
        assert image.mean() > 0.02 * whole.mean() or TABLE[term].absent(scene)


def test_depths_are_kept_apart_and_more_depth_is_more_light(tmp_path):
    """In each pixel of the first part, whose paths are the same, cut. Of 64 vertices none is here."""
    scene = attrs.evolve(lit_scene(Sky((0.2, 0.4, 0.8))), resolution=(8, 6))
    limits = [attrs.evolve(physical("ambient"), depth=depth) for depth in (1, 2, 64, None)]
    options = {"spp": 4, "seed": 1, "count": 1, "folder": tmp_path}
    images = [store.replicates(scene, limit, **options).images for limit in limits]
    assert len({store.key(scene, limit, spp=4, seed=1) for limit in limits}) == len(limits)
    for less, more in itertools.pairwise(images[:3]):
        assert (less <= more).all()
        assert less.mean() < more.mean()
    assert np.array_equal(images[2], images[3])
