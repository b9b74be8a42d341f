"""A path tracer in NumPy with a command line: python tiny_renderer.py SCENE OUTPUT SPP SEED DEPTH."""

import json
import sys

import numpy as np

spp, seed, depth = map(int, sys.argv[3:])
with open(sys.argv[1]) as file:
    scene = json.load(file)
rng, things = np.random.default_rng(seed), scene["objects"]
counts = [len(thing["faces"]) for thing in things]
color = np.repeat([thing["material"]["color"] for thing in things], counts, axis=0)
emission = np.repeat([thing["emission"] for thing in things], counts, axis=0)
a, b, c = np.concatenate([np.array(thing["vertices"])[thing["faces"]] for thing in things]).swapaxes(0, 1)
normal = np.cross(b - a, c - a)
normal /= np.linalg.norm(normal, axis=1, keepdims=True)

camera, (width, height) = scene["camera"], scene["film"]["resolution"]
right, up, forward = (np.array(camera[name]) for name in ("right", "up", "forward"))
y, x = np.repeat(np.mgrid[:height, :width].reshape(2, 1, -1), spp, axis=1).reshape(2, -1)
t = np.tan(np.radians(camera["horizontal_fov"]) / 2)
film = 2 * (np.stack([x, y], axis=1) + rng.random((len(x), 2))) / (width, height) - 1
way = forward + film[:, :1] * t * right - film[:, 1:] * t * height / width * up
place = np.broadcast_to(np.array(camera["position"]), way.shape)

pixel, weight, image = width * y + x, np.ones(way.shape), np.zeros((height * width, 3))
sky = np.array(scene["sky"]["radiance"] if scene["sky"] else (0, 0, 0))
for _ in range(depth + 1):
    if not len(way):
        break
    p = np.cross(way[:, None], c - a)  # Möller and Trumbore, each ray against each triangle
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / (p * (b - a)).sum(-1)
        s = place[:, None] - a
        u, q = (s * p).sum(-1) * inverse, np.cross(s, b - a)
        v, distance = (q * way[:, None]).sum(-1) * inverse, (q * (c - a)).sum(-1) * inverse
        distance = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-6), distance, np.inf)
    face = distance.argmin(axis=1)
    near = distance[np.arange(len(face)), face]
    met = np.isfinite(near)
    front = (normal[face] * way).sum(-1) < 0
    light = np.where(met[:, None], emission[face] * front[:, None], sky)
    np.add.at(image, pixel, weight * light / spp)
    survival = np.clip(color[face].max(axis=1), 0.0, 0.99)
    on = met & (rng.random(len(met)) < survival)
    weight = weight[on] * color[face[on]] / survival[on, None]
    n = np.where(front[:, None], normal[face], -normal[face])[on]
    place, pixel = (place + near[:, None] * way)[on] + 1e-9 * n, pixel[on]
    way = n + (sphere := rng.normal(size=n.shape)) / np.linalg.norm(sphere, axis=1, keepdims=True)
np.save(sys.argv[2], image.reshape(height, width, 3).astype(np.float32))
