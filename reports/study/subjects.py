"""What is measured: a scene with its variants; and the scene as a setting of the study changes it."""

from collections.abc import Iterator
from typing import Any

import attrs
import cattrs

from termwise.renderer.plan import check
from termwise.renderer.terms import VARIANTS, Chain, Variant
from termwise.renderer.terms.variant import CHAINS
from termwise.reports.study import exact
from termwise.reports.study.study import Setting, Study
from termwise.scenes import limits, strict
from termwise.scenes.limits import Limit
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.terms import TABLE, TERMS, Term

# Direct at the vertices of a specular chain, but for settings that name another: kernel bias must not leak into a
# specular verdict.
CHAIN: Chain = "path"
# What a setting cannot change: these say what the scene is, not how it is read.
_FIXED = ("name", "objects", "lights", "resolution", "texture", "substitutions")


@attrs.frozen(eq=False)
class Subject:
    """A scene and the variants that are measured on it.

    Attributes
    ----------
    scene : as it is rendered; a setting's name follows that of its base.
    variants : of each term; the first is the one in `total`.
    chain : what the other terms are at the vertices of a specular chain.
    setting, base : of a changed scene, and the scene without the change, whose terms are its `correct`.
    """

    scene: Scene
    variants: dict[Term, tuple[Variant, ...]]
    chain: Chain = CHAIN
    setting: Setting | None = None
    base: Scene | None = None

    @property
    def unchanged(self) -> Scene:
        """The scene that says what is right."""
        return self.base or self.scene

    def correct(self, term: Term) -> Limit:
        """The term's true integral, in the unchanged scene."""
        return limits.correct(term, self.unchanged.scope)


def scenes_of(study: Study, names: tuple[str, ...] = (), *, approximate: bool = False) -> tuple[Scene, ...]:
    """Scenes of a study, or those named, at the study's resolution; `approximate` as in `scenes.load.load`."""
    prepared = []
    for name in names or study.scenes:
        scene = attrs.evolve(load(name, approximate=approximate), resolution=study.resolution)
        count = study.photons_of.get(scene.name, min(scene.photons.count, study.photons or scene.photons.count))
        scene = attrs.evolve(scene, photons=attrs.evolve(scene.photons, count=count))
        prepared.append(scene)
    twice = [scene.name for scene in prepared]
    for name in twice:
        if twice.count(name) > 1:
            raise ValueError(f"scenes: {name!r} is named twice: allowed are distinct names")
    return tuple(prepared)


def variants_of(study: Study, scene: Scene, term: Term) -> tuple[Variant, ...]:
    """Variants of a term that mean what the scene means: those that fit it, and whose limit has its scope."""
    chosen = [VARIANTS[term][name] for name in study.variants_of(term)]
    chosen = [variant for variant in chosen if variant.unfit(scene) is None]
    return tuple(variant for variant in chosen if variant.limit(scene, 1).scope in (None, scene.scope))


def subjects(study: Study, scenes: tuple[Scene, ...]) -> Iterator[Subject]:
    """Each scene as it is, then as the study's settings change it.

    Raises
    ------
    ValueError : a setting changes what does not exist, or a variant would ignore an option.
    """
    for scene in scenes:
        yield _checked(Subject(scene, {term: variants_of(study, scene, term) for term in TERMS}))
    for setting in study.settings:
        for base in scenes:
            if base.name in setting.scenes:
                try:
                    scene = changed(base, setting.change)
                except ValueError as error:
                    raise ValueError(f"settings: {setting.name}: {error}") from None
                scene = attrs.evolve(scene, name=f"{base.name}.{setting.name}")
                variants: dict[Term, tuple[Variant, ...]] = {
                    term: tuple(VARIANTS[term][name] for name in getattr(setting.variants, term)) for term in TERMS
                }
                yield _checked(Subject(scene, variants, setting.chain, setting, base))


def named(study: Study, name: str, variant: Variant, *, approximate: bool = False) -> tuple[Subject, int]:
    """The subject of a study by its scene's name, or a scene by its own as the study prepares it; and the samples.

    Raises
    ------
    ValueError : Neither is there.
    """
    for case in exact.cases(study):
        if (case.name, case.variant) == (name, variant):
            return Subject(case.scene, {variant.term: (variant,)}), case.samples
    count = study.samples_of(variant)
    prepared = scenes_of(study)
    if name in [f"{base.name}.{setting.name}" for setting in study.settings for base in prepared]:
        return next(each for each in subjects(study, prepared) if each.scene.name == name), count
    (scene,) = [scene for scene in prepared if scene.name == name] or scenes_of(study, (name,), approximate=approximate)
    return Subject(scene, {variant.term: (variant,)}), count


def _checked(subject: Subject) -> Subject:
    if subject.setting is not None:
        _same_scope(subject)
    for variants in subject.variants.values():
        for variant in variants:
            check(subject.scene, variant, chain=subject.chain)
    return subject


def _same_scope(subject: Subject) -> None:
    """Refuse a variant of another scope: what it differs by would be laid to the setting."""
    for variants in subject.variants.values():
        for variant in variants:
            scope = variant.limit(subject.scene, 1).scope
            if scope not in (None, subject.scene.scope):
                fitting = [
                    other.name
                    for other in VARIANTS[variant.term].values()
                    if other.limit(subject.scene, 1).scope == subject.scene.scope
                ]
                raise ValueError(
                    f"settings: {subject.scene.name}: {variant.term} = {variant.name!r}, of scope {scope!r}: "
                    f"allowed with scope = {subject.scene.scope!r} are {', '.join(fitting)}"
                )


def changed(thing: Any, change: dict[str, Any]) -> Any:
    """A value of the scene's model with the fields of a table in place of its own."""
    fields = {field.name: field for field in attrs.fields(type(thing)) if field.name not in _FIXED}
    values = {}
    for name, value in change.items():
        if name not in fields:
            raise ValueError(f"change: {name}: unknown key: allowed are {', '.join(fields)}")
        current = getattr(thing, name)
        if attrs.has(type(current)):
            if not isinstance(value, dict):
                raise ValueError(f"change: {name} = {value!r}: allowed is a table")
            values[name] = changed(current, value)
        else:
            try:
                values[name] = _converter.structure(value, fields[name].type)
            except (TypeError, cattrs.BaseValidationError) as error:
                raise ValueError(f"change: {name} = {value!r}: allowed is {error}") from None
    return attrs.evolve(thing, **values)


_converter = strict.converter()


def own_limit(study: Study, subject: Subject, variant: Variant) -> Limit:
    """What a variant is judged against: its kernel reference where it has a kernel and the study renders those."""
    scene = subject.scene
    samples = study.samples_of(variant)
    limit, kernel = variant.limit(scene, samples), variant.kernel(scene, samples)
    if subject.chain == "paper" and TABLE[variant.term].meets:
        met = {term: VARIANTS[term][name] for term, name in CHAINS[subject.chain].items()}
        kernel = met["direct"].kernel(scene, samples)
        limit = attrs.evolve(limit, scope="all", ambient=met["ambient"].limit(scene, samples).factor)
    if kernel is None or study.maps_of(kernel) is None:
        return limit
    # The kernel reference scatters diffusely and leaves surfaces as Mitsuba does; its roulette decides how densely the
    # nearest photons lie.
    photons = scene.photons
    served = photons.scattering == "diffuse" and scene.ignore == "face"
    served &= photons.survival is None or kernel.shape != "nearest"
    return attrs.evolve(limit, kernel=kernel) if served else limit


def exact_part(scene: Scene, variant: Variant, own: Limit) -> Limit | None:
    """The light of a photon estimate that no photon stands for, where it is judged with an allowance for the others.

    None where it has a kernel reference, or photons stand for all of its light.
    """
    kernel = variant.kernel(scene, 1)
    if kernel is None or own.kernel is not None or kernel.stored == "all":
        return None
    return Limit("direct", scope="first-hit", shadows=scene.shadows)
