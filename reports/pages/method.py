"""Sources of the Method page; the equations of variants are the ones in `renderer.terms`."""

from termwise.renderer.terms import VARIANTS
from termwise.renderer.terms.variant import Variant

REFERENCES = (
    ("kajiya", "J. T. Kajiya. The rendering equation. SIGGRAPH 1986."),
    (
        "paper",
        "Visualisation of a 3D scene with ray tracing. Course paper, 2020 (in Russian): the estimators called “paper”.",
    ),
    ("cook-torrance", "R. L. Cook, K. E. Torrance. A reflectance model for computer graphics. ACM TOG 1(1), 1982."),
    ("beckmann", "P. Beckmann, A. Spizzichino. The scattering of electromagnetic waves from rough surfaces. 1963."),
    (
        "smith",
        "B. G. Smith. Geometrical shadowing of a random rough surface. IEEE Trans. Antennas and Propagation 15(5), "
        "1967.",
    ),
    (
        "schlick",
        "C. Schlick. An inexpensive BRDF model for physically-based rendering. Computer Graphics Forum 13(3), 1994.",
    ),
    (
        "heitz",
        "E. Heitz, E. d'Eon. Importance sampling microfacet-based BSDFs using the distribution of visible normals. "
        "Computer Graphics Forum (EGSR) 33(4), 2014.",
    ),
    ("burley", "B. Burley. Practical hash-based Owen scrambling. JCGT 9(4), 2020."),
    ("woop", "S. Woop, C. Benthin, I. Wald. Watertight ray/triangle intersection. JCGT 2(1), 2013."),
    ("arvo", "J. Arvo, D. Kirk. Particle transport and image synthesis. SIGGRAPH 1990."),
    ("jensen", "H. W. Jensen. Global illumination using photon maps. Eurographics Workshop on Rendering 1996."),
    ("knaus", "C. Knaus, M. Zwicker. Progressive photon mapping: a probabilistic approach. ACM TOG 30(3), 2011."),
    ("mitsuba", "W. Jakob et al. Mitsuba 3 renderer. 2022."),
    (
        "welch",
        "B. L. Welch. The generalization of “Student's” problem when several different population variances are "
        "involved. Biometrika 34, 1947.",
    ),
    (
        "holm",
        "S. Holm. A simple sequentially rejective multiple test procedure. Scandinavian Journal of Statistics 6, 1979.",
    ),
    (
        "benjamini",
        "Y. Benjamini, Y. Hochberg. Controlling the false discovery rate: a practical and powerful approach to "
        "multiple testing. Journal of the Royal Statistical Society B 57(1), 1995.",
    ),
    ("efron", "B. Efron. The jackknife, the bootstrap and other resampling plans. SIAM 1982."),
    (
        "jung",
        "A. Jung, J. Hanika, C. Dachsbacher. Detecting bias in Monte Carlo renderers using Welch's t-test. "
        "JCGT 9(2), 2020.",
    ),
    (
        "wang",
        "Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli. Image quality assessment: from error visibility to "
        "structural similarity. IEEE Trans. Image Processing 13(4), 2004.",
    ),
    (
        "okabe",
        "M. Okabe, K. Ito. Color universal design: how to make figures and presentations that are friendly to "
        "colorblind people. 2008.",
    ),
)


def find(term: str, name: str) -> Variant | None:
    """The variant of a row, None for `total` and for what the renderer no longer knows."""
    return VARIANTS.get(term, {}).get(name)  # type: ignore[call-overload]
