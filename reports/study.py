"""A study: which scenes, variants, resolutions, samples and replicates are measured. A preset is a study by name."""

from pathlib import Path

import attrs

from renderer.terms import VARIANTS, find
from scenes import strict
from scenes.model import in_range
from scenes.strict import FileError
from scenes.terms import Term

STUDIES = Path(__file__).parent / "studies"

_count = in_range(1, 2**31 - 1)


@attrs.frozen(kw_only=True)
class Samples:
    """Samples per pixel and replicate of each term; powers of two keep low-discrepancy points well spread."""

    ambient: int = attrs.field(default=64, validator=_count)
    direct: int = attrs.field(default=16, validator=_count)
    specular: int = attrs.field(default=16, validator=_count)
    background: int = attrs.field(default=16, validator=_count)


@attrs.frozen(kw_only=True)
class Variants:
    """Variants of each term to measure; the first is the one in `total`."""

    ambient: tuple[str, ...] = ("cosine", "paper")
    direct: tuple[str, ...] = ("next-event", "path", "paper")
    specular: tuple[str, ...] = ("vndf", "paper")
    background: tuple[str, ...] = ("seen",)

    def __attrs_post_init__(self) -> None:
        """Refuse a variant that does not exist."""
        for term in VARIANTS:
            names = getattr(self, term)
            if not names:
                raise ValueError(f"{term} = []: allowed is at least one of {', '.join(VARIANTS[term])}")
            for name in names:
                find(term, name)


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
    photons : photons per pass at most, instead of a scene's larger count; None: the scenes' own.
    samples, variants : per term.
    """

    scenes: tuple[str, ...]
    resolution: tuple[int, int] = attrs.field(validator=in_range(1, 65536))
    seed: int = attrs.field(default=1, validator=in_range(0, 2**31 - 1))
    replicates: int = attrs.field(default=16, validator=in_range(4, 4096))
    reference_replicates: int = attrs.field(default=16, validator=in_range(4, 4096))
    reference_spp: int = attrs.field(default=64, validator=_count)
    photons: int | None = None
    samples: Samples = Samples()
    variants: Variants = Variants()

    def of(self, term: Term) -> tuple[int, tuple[str, ...]]:
        """Samples and variants of a term."""
        return getattr(self.samples, term), getattr(self.variants, term)


def studies() -> tuple[str, ...]:
    """Names of the studies that ship with Termwise."""
    return tuple(sorted(path.stem for path in STUDIES.glob("*.toml")))


def load(study: str | Path) -> Study:
    """Load a study by name, or any study file by path; errors as for scenes."""
    path = STUDIES / f"{study}.toml" if str(study) in studies() else Path(study)
    if path.suffix != ".toml":
        raise FileError(f"{study}: no such study: allowed are {', '.join(studies())} or a path that ends in .toml")
    return strict.read(path, Study, strict.converter())
