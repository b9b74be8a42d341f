"""What an image depends on in a scene: `key = sha256(fields that its term reads, fields that no term names)`.

A field is named by its path, "photons.count"; those of all objects share one, "objects.material.gloss". A term's row
(`scenes.terms`) names what it reads. A field that some row names is in the keys of the terms that read it, and of no
other; one that no row names is in every key, so that a new field can make a key too fine, never an image stale.
"""

import functools
import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import attrs

from termwise.scenes.model import Scene, absorb
from termwise.scenes.textures import Texture

UNREAD = ("name", "exposure", "objects.name", "substitutions")
"""Fields that no image depends on."""


@attrs.frozen
class Read:
    """Fields that a term reads.

    Attributes
    ----------
    fields : their paths.
    of : scene -> all that the term sees of them, where that is less than they say.
    when : scene -> whether it reads them there.
    """

    fields: tuple[str, ...]
    of: Callable[[Scene], object] | None = None
    when: Callable[[Scene], bool] = lambda scene: True


def read(*fields: str, **options: Any) -> Read:
    """A `Read` of the fields named."""
    return Read(fields, **options)


def fields_of(thing: Any, path: str = "") -> Iterator[tuple[str, str, Any]]:
    """Path, class and value of each field of the scene's model, as it was made: in order, object by object."""
    for field in attrs.fields(type(thing)):
        here, value = f"{path}{field.name}", getattr(thing, field.name)
        several = isinstance(value, tuple) and (not value or attrs.has(type(value[0])))
        for item in value if several else (value,):
            if attrs.has(type(item)) and not isinstance(item, Texture):
                yield from fields_of(item, f"{here}.")
            else:
                yield here, type(thing).__name__, item


class _Told:
    """What a hash is fed with."""

    def __init__(self) -> None:
        self.content = bytearray()

    def update(self, more: bytes) -> None:
        self.content += more


@functools.lru_cache(maxsize=4)
def _told(scene: Scene) -> tuple[tuple[str, bytes], ...]:
    """Path and content of each field: told once a scene, for each job of a study asks, and of a thousand objects."""
    told = []
    for path, kind, value in fields_of(scene):
        state = _Told()
        absorb(state, (path, kind, value))
        told.append((path, bytes(state.content)))
    return tuple(told)


def digest(scene: Scene, *, without: Collection[str], seen: Iterable[Read] = ()) -> str:
    """sha256 of the fields of a scene but those `without`, and of what is `seen` of some of them."""
    state = hashlib.sha256()
    for path, content in _told(scene):
        if path not in without:
            state.update(content)
    for each in seen:
        if each.of is not None:
            absorb(state, (each.fields, each.of(scene)))
    return state.hexdigest()
