"""A study: which scenes, variants, resolutions, samples and replicates are measured. A preset is a study by name."""

from pathlib import Path
from typing import Any, Literal

import attrs

from termwise.renderer.fingerprint import Unknown
from termwise.renderer.terms import DEFAULTS, VARIANTS, Chain, Variant, find, registered
from termwise.renderer.terms.variant import CHAINS
from termwise.reports.statistics.convergence import RADII_NEEDED
from termwise.scenes import strict
from termwise.scenes.limits import Kernel
from termwise.scenes.model import in_range, positive, unit_interval
from termwise.scenes.strict import FileError
from termwise.scenes.terms import Term

PRESETS = Path(__file__).parent / "presets"

DEFAULT_SAMPLES = 16

_count = in_range(1, 2**31 - 1)


def _samples(study: object, attribute: attrs.Attribute, value: dict[str, int]) -> None:
    known = [name for term in VARIANTS for name in (term, *(f"{term}.{variant}" for variant in VARIANTS[term]))]
    for name, count in value.items():
        if name not in known:
            raise ValueError(f"samples.{name} = {count!r}: unknown key: allowed are {', '.join(known)}")
        if count < 1:
            raise ValueError(f"samples.{name} = {count}: allowed is at least 1")


def _photons_of(study: "Study", attribute: attrs.Attribute, value: dict[str, int]) -> None:
    for name, count in value.items():
        if name not in study.scenes:
            raise ValueError(f"photons_of.{name} = {count}: no such scene: allowed are {', '.join(study.scenes)}")
        if not 1 <= count < 2**31:
            raise ValueError(f"photons_of.{name} = {count}: allowed is a number in [1, {2**31 - 1}]")


def _distinct(study: object, attribute: attrs.Attribute, value: tuple["Setting", ...]) -> None:
    names = [setting.name for setting in value]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{attribute.name}: {name!r} is named twice: allowed are distinct names")


def _enough(study: object, attribute: attrs.Attribute, value: tuple[float, ...]) -> None:
    if value and len(set(value)) < RADII_NEEDED:
        raise ValueError(f"{attribute.name} = {value}: allowed are {RADII_NEEDED} distinct factors or more, or none")


def _some(study: object, attribute: attrs.Attribute, value: tuple[str, ...]) -> None:
    if not value:
        raise ValueError(f"{attribute.name} = []: allowed is at least one")


def _of_terms() -> Any:
    """A class with a field of each term: the names of the variants that are measured by default."""
    fields = {
        term: attrs.field(
            type=tuple[str, ...], default=tuple(name for name, variant in table.items() if variant.measured)
        )
        for term, table in VARIANTS.items()
    }
    return attrs.make_class("OfTerms", fields, frozen=True, kw_only=True)


@attrs.frozen(kw_only=True)
class Variants(_of_terms()):
    """Variants of each term to measure, a field a term; the first is the one in `total`."""

    def __attrs_post_init__(self) -> None:
        """Refuse a variant that does not exist."""
        for term in VARIANTS:
            names = getattr(self, term)
            if not names:
                raise ValueError(f"{term} = []: allowed is at least one of {', '.join(VARIANTS[term])}")
            for name in names:
                find(term, name)
                if names.count(name) > 1:
                    raise ValueError(f"{term}: {name!r} is named twice: allowed are distinct variants")


@attrs.frozen(kw_only=True)
class Exact:
    """Scenes with a known answer (see `reports.study.exact`).

    Attributes
    ----------
    roughness, f0, mu_o : the furnace's grid.
    gloss, bounces : of the closed glossy sphere, seen after 1 .. `bounces` vertices.
    samples : per pixel and replicate, of all variants.
    """

    roughness: tuple[float, ...] = attrs.field(validator=[_some, in_range(1e-4, 1.5)])
    f0: tuple[float, ...] = attrs.field(validator=[_some, unit_interval])
    mu_o: tuple[float, ...] = attrs.field(validator=[_some, in_range(0.0, 1.0, open_low=True)])
    gloss: tuple[float, ...] = attrs.field(validator=[_some, unit_interval])
    bounces: int = attrs.field(validator=in_range(1, 64))
    samples: int = attrs.field(validator=_count)


@attrs.frozen(kw_only=True)
class Setting:
    """A change to scenes: measured against its own limit, and against the terms of the unchanged scene.

    Attributes
    ----------
    name : short; the changed scene is called `<scene>.<name>`.
    what : the change in one sentence.
    scenes : those scenes of the study that it is measured on.
    change : field of the scene -> value, tables within tables, as in `scenes.model.Scene`.
    variants : per term; the first is the one in `total`.
    chain : what the other terms are at the vertices of a specular chain, see `renderer.terms.variant`.
    """

    name: str = attrs.field(validator=attrs.validators.matches_re(r"[a-z0-9]+(-[a-z0-9]+)*"))
    what: str
    scenes: tuple[str, ...] = attrs.field(validator=_some)
    change: dict[str, Any]
    variants: Variants = Variants(**{term: (name,) for term, name in (DEFAULTS | CHAINS["path"]).items()})
    chain: Chain = "path"


@attrs.frozen(kw_only=True)
class Study:
    """What is measured, and how often.

    Attributes
    ----------
    scenes : names of the library or paths of scene files.
    resolution : width and height, instead of the scenes' own.
    seed : fixed before the run; ours and the reference derive unrelated streams from it.
    replicates, reference_replicates : K and R, independent seeds, each with photon maps of its own.
    reference_spp : samples per pixel of a reference replicate.
    audit : whether references are held against a second integrator too, beside their halves (`reports.study.audits`).
    physical_spp : the same for full light transport, against which no verdict is due.
    kernel_maps : photon maps a replicate of the kernel references of kernels of a radius, which such estimates are then
        judged against (at least 64 over all replicates are wanted); None: they are judged against E itself, with an
        allowance for the light that photons stand for.
    nearest_maps : the same of the k nearest photons, twice as many for `paper`.
    half_width : of the 90 % interval of the mean of a judged row that is meant to be right, relative: replicates are
        allotted by a pilot so that few are wider (see `reports.study.allotment`); None: each side has those that the
        study says.
    photons : photons per pass at most, instead of a scene's larger count; None: the scenes' own.
    photons_of : photons per pass of the scenes named, whatever `photons` and the scenes say.
    samples : samples per pixel and replicate of a term, or of one variant as "term.variant"; powers of two keep
        low-discrepancy points well spread. DEFAULT_SAMPLES where nothing is said.
    variants : per term; the first is the one in `total`.
    exact : scenes with a known answer to measure as well; None: none.
    settings : changes to scenes to measure as well.
    radii : factors on the radius of the photon kernels, at which they are measured to extrapolate them to 0; three or
        more, or none.
    budget : seconds of rendering, both sides together, within which undecided rows get more replicates (see
        `reports.statistics.sequential`); None: each row has one look, at the whole level.
    folder : of the results, below the output folder.
    """

    scenes: tuple[str, ...] = attrs.field(validator=_some)
    resolution: tuple[int, int] = attrs.field(validator=in_range(1, 65536))
    seed: int = attrs.field(default=1, validator=in_range(0, 2**31 - 1))
    replicates: int = attrs.field(default=16, validator=in_range(4, 4096))
    reference_replicates: int = attrs.field(default=16, validator=in_range(4, 4096))
    reference_spp: int = attrs.field(default=64, validator=_count)
    audit: bool = True
    physical_spp: int = attrs.field(default=16, validator=_count)
    kernel_maps: int | None = attrs.field(default=None, validator=attrs.validators.optional(_count))
    nearest_maps: int | None = attrs.field(default=None, validator=attrs.validators.optional(_count))
    half_width: float | None = attrs.field(
        default=None, validator=attrs.validators.optional(in_range(1e-6, 1.0, open_low=False))
    )
    photons: int | None = attrs.field(default=None, validator=attrs.validators.optional(_count))
    photons_of: dict[str, int] = attrs.field(factory=dict, validator=_photons_of)
    samples: dict[str, int] = attrs.field(factory=dict, validator=_samples)
    variants: Variants = Variants()
    exact: Exact | None = None
    settings: tuple[Setting, ...] = attrs.field(default=(), validator=_distinct)
    radii: tuple[float, ...] = attrs.field(default=(), validator=[positive, _enough])
    budget: float | None = attrs.field(default=None, validator=attrs.validators.optional(positive))
    folder: Literal["compare", "variants"] = "compare"

    def samples_of(self, variant: Variant) -> int:
        """Samples per pixel and replicate of a variant."""
        of_term = self.samples.get(variant.term, DEFAULT_SAMPLES)
        return self.samples.get(f"{variant.term}.{variant.name}", of_term)

    def maps_of(self, kernel: Kernel) -> int | None:
        """Photon maps a replicate of a kernel's reference; None where the study renders none."""
        if kernel.shape != "nearest":
            return self.kernel_maps
        # The paper's own estimate is to be told from one that is right, 1 to 2 % away.
        return self.nearest_maps and self.nearest_maps * (2 if kernel.scale == 1.0 else 1)

    def variants_of(self, term: Term) -> tuple[str, ...]:
        """Names of the variants of a term."""
        return getattr(self.variants, term)


def studies() -> tuple[str, ...]:
    """Names of the studies that ship with Termwise."""
    return tuple(sorted(path.stem for path in PRESETS.glob("*.toml")))


def load(study: str | Path) -> Study:
    """Load a study by name, or any study file by path; errors as for scenes."""
    path = PRESETS / f"{study}.toml" if str(study) in studies() else Path(study)
    if path.suffix != ".toml":
        raise FileError(f"{study}: no such study: allowed are {', '.join(studies())} or a path that ends in .toml")
    return strict.read(path, Study, strict.converter())


def unkept() -> list[tuple[Term, str, str]]:
    """Term, name and reason of the registered estimators without a fingerprint: their images last for one run."""
    found = []
    for term in VARIANTS:
        for name in registered(term):
            try:
                VARIANTS[term][name].estimator.fingerprint()
            except Unknown as error:
                found.append((term, name, str(error)))
    return found


def with_registered(study: Study) -> Study:
    """The study with all estimators that were added by `renderer.terms.register`."""
    added = {
        term: (*study.variants_of(term), *(name for name in registered(term) if name not in study.variants_of(term)))
        for term in VARIANTS
    }
    return attrs.evolve(study, variants=Variants(**added))
