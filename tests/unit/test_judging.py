"""Images of any renderer in Python: what is taken, plain words, and hints after BIASED.

Hints are tried on faults that are planted here into a picture of edges and gradients. What is planted is known, and
a hint that names it is right; a fault of another kind has none.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import scipy
import xarray

import termwise
from termwise.reports.judging import hints
from termwise.reports.judging.suite import slug
from termwise.reports.results.exr import write_exr
from termwise.reports.statistics import accumulation
from termwise.scenes import srgb
from termwise.scenes.terms import TermImage

SIZE = 48
Y, X = np.mgrid[:SIZE, :SIZE] / SIZE
PICTURE = (0.3 + np.exp(-((X - 0.3) ** 2 + (Y - 0.7) ** 2) * 20) + ((X > 0.6) & (Y < 0.4)) * 0.5)[..., None] * np.array(
    [1.0, 0.7, 0.4]
)
Draw = Callable[..., np.ndarray]


def same(image: np.ndarray) -> np.ndarray:
    return image


@pytest.fixture
def draw() -> Draw:
    """A function: 16 replicates of a picture with gamma noise, each changed as a faulty renderer would."""
    rng = np.random.default_rng(7)

    def replicates(picture: np.ndarray = PICTURE, change: Callable = same, *, noise: float = 0.1, count: int = 16):
        shape = (count, *picture.shape[:2], 1)
        return np.stack([change(picture * factor) for factor in rng.gamma(1 / noise**2, noise**2, shape)])

    return replicates


def hinted(judgement: "termwise.reports.judging.judge.Judgement") -> str:
    assert judgement.verdict == "BIASED"
    return judgement.hints[0].text if judgement.hints else ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: image[::-1], "ours is flipped upside down"),
        (lambda image: image[:, ::-1], "ours is flipped left to right"),
        (lambda image: image[::-1, ::-1], "ours is turned by 180°"),
        (lambda image: image.swapaxes(0, 1), "ours is transposed"),
        (lambda image: image[..., ::-1], "order BGR"),
        (lambda image: np.pi * image, "ours is divided by π"),
        (lambda image: image / np.pi, "ours is multiplied by π"),
        (lambda image: 4 * image, "ours is divided by 4"),
        (lambda image: image / 2, "ours is multiplied by 2"),
        (lambda image: 683 * image, "ours is divided by 683"),
        (lambda image: 1.05 * image, "one factor, 0.95"),
        (lambda image: image ** (1 / 2.2), "it is gamma-encoded (1/2.2)"),
        (lambda image: image**2.2, "a gamma of 2.2 was undone once too often"),
        (lambda image: np.roll(image, (-1, 2), (0, 1)), "ours is shifted by 2 px to the left, 1 px down"),
        (lambda image: np.minimum(image, 0.9), "the reference is clamped at 0.9"),
        (lambda image: np.pi * image[::-1], "ours is flipped upside down and divided by π"),
        (lambda image: image[::-1, :, ::-1], "ours is flipped upside down and the channels of ours are taken in the"),
        (lambda image: np.pi * np.roll(image, -2, 1), "ours is shifted by 2 px to the right and divided by π"),
        (
            lambda image: srgb.encoded(image)[:, ::-1, ::-1],
            "left to right and the channels of ours are taken in the order BGR and decoded by sRGB's curve: it is",
        ),
        (
            lambda image: np.minimum(srgb.encoded(image), 1.0),
            "sRGB's curve and the reference is clamped at 1, above which ours has no value: it is sRGB-encoded",
        ),
        (lambda image: srgb.encoded(2 * image), "decoded by sRGB's curve and divided by 2: it is sRGB-encoded"),
        (lambda image: np.minimum(2 * image, 1.0), "divided by 2 and the reference is clamped at 0.5, above which"),
        (
            lambda image: np.minimum(2 * image, 1.0) ** (1 / 2.2),
            "power 2.2 and divided by 2 and the reference is clamped at 0.5, above which ours has no value: it is",
        ),
    ],
)
def test_a_planted_cause_is_hinted_at(draw: Draw, change: Callable, words: str):
    text = hinted(termwise.judge(draw(change=change), draw()))
    assert text.startswith("agrees if ")
    assert words in text


def test_a_border_that_is_off_is_hinted_at(draw: Draw):
    picture = PICTURE.copy()
    picture[-1] *= 0.6
    assert "border alone" in hinted(termwise.judge(draw(picture, noise=0.05), draw(noise=0.05)))


def test_the_brightest_pixels_that_are_off_are_hinted_at(draw: Draw):
    """Two highlights, of 2304 pixels less than a thousandth, that ours has too dark."""
    dim, right = PICTURE.copy(), PICTURE.copy()
    for at in ((20, 21), (33, 12)):
        dim[at], right[at] = 10.0, 20.0
    assert "brightest pixels alone" in hinted(termwise.judge(draw(dim), draw(right)))


def filtered(*weights: float, picture: np.ndarray = PICTURE) -> np.ndarray:
    """The picture, each pixel with those beside it."""
    found = picture
    for axis in (0, 1):
        found = scipy.ndimage.convolve1d(found, np.array(weights), axis=axis, mode="nearest")
    return found


def test_a_wider_filter_is_hinted_at(draw: Draw):
    """Noise has seen the filter, too: it is the picture that is blurred."""
    ours = draw(filtered(0.2, 0.6, 0.2), noise=0.05)
    assert "a wider pixel filter" in hinted(termwise.judge(ours, draw(noise=0.05)))
    assert "a narrower pixel filter" in hinted(termwise.judge(draw(noise=0.05), ours))


def test_a_filter_that_is_no_gaussian_is_said_to_be_nearer(draw: Draw):
    """So little noise that what a Gaussian leaves of it is proven: its kind is named, and that it is not all."""
    judgement = termwise.judge(draw(filtered(0.1, 0.15, 0.5, 0.15, 0.1), noise=0.005), draw(noise=0.005))
    text = hinted(judgement)
    assert text.startswith("is nearer if the reference is blurred by ")
    assert text.endswith("ours has a wider pixel filter; not all of the error is gone")
    assert judgement.hints[0].verdict == "BIASED"


def test_a_cause_of_another_kind_has_no_hint(draw: Draw):
    half = np.where(X[..., None] < 0.5, 1.05, 1.0)
    assert hinted(termwise.judge(draw(PICTURE * half), draw())) == ""
    assert termwise.judge(draw(), draw()).hints == ()
    assert termwise.judge(draw(change=lambda image: 1.05 * image), draw(), hint=False).hints == ()


SCATTERED = np.cumsum([0.5**k * scipy.ndimage.gaussian_filter(PICTURE, (k, k, 0)) for k in range(40)], axis=0)
"""Light that has scattered once more often than its index at most: half of it goes on, and spreads."""


@pytest.fixture
def at_depth(draw: Draw) -> tuple[Callable[[int, int], np.ndarray], list[tuple[int, int]]]:
    """The reference of few depths, and what was asked of it."""
    noise = draw(np.ones_like(PICTURE), noise=0.02)
    asked: list[tuple[int, int]] = []

    def replicates(depth: int, count: int) -> np.ndarray:
        asked.append((depth, count))
        return noise[:count] * SCATTERED[depth - 1]

    return replicates, asked


@pytest.mark.parametrize(
    ("depth", "change", "words"),
    [
        (1, same, "agrees if the reference has direct light alone: raise the limit of bounces of ours"),
        (2, same, "agrees if light scatters 2 times at most in the reference too"),
        (5, same, "agrees if light scatters 5 times at most in the reference too"),
        (3, lambda image: np.roll(image, 1, 0), "shifted by 1 px up and light scatters 3 times at most"),
        (4, lambda image: scipy.ndimage.gaussian_filter(image, (0.6, 0.6, 0)), "pixel filter; raise the limit of ours"),
    ],
)
def test_light_that_ends_too_soon_is_hinted_at(draw: Draw, at_depth: Any, depth: int, change: Callable, words: str):
    less, asked = at_depth
    ours = change(SCATTERED[depth - 1]) * draw(np.ones_like(PICTURE), noise=0.02)
    reference = draw(SCATTERED[-1], noise=0.02)
    judgement = termwise.judge(ours, reference, at_depth=less)
    assert words in hinted(judgement)
    assert {at for at, count in asked if count > 4} == {depth}
    assert len({at for at, _ in asked}) <= 6
    assert judgement.hints[0].left < 0.01
    assert not any("scatters" in hint.text for hint in termwise.judge(ours, reference).hints)


def test_light_that_ends_too_soon_behind_such_a_filter_is_said_to_be_nearer(draw: Draw, at_depth: Any):
    less, _ = at_depth
    ours = draw(filtered(0.3, 0.0, 0.4, 0.0, 0.3, picture=SCATTERED[2]), noise=0.005)
    text = hinted(termwise.judge(ours, draw(SCATTERED[-1], noise=0.005), at_depth=less))
    assert text.startswith("is nearer if the reference is blurred by ")
    assert "light scatters 3 times at most in the reference too" in text


@pytest.mark.parametrize(
    ("change", "verdict", "depths"),
    [
        (1.0, "EQUIVALENT", 0),
        (1.05, "BIASED", 0),
        (0.9, "BIASED", 6),
        (np.where(X < 0.5, 1.0, 0.9)[..., None], "BIASED", 6),
    ],
)
def test_another_cause_is_not_light_that_ends(draw: Draw, at_depth: Any, change: Any, verdict: str, depths: int):
    """And where there is no light missing, none is rendered; where there is, few replicates suffice to refute it."""
    less, asked = at_depth
    sides = draw(SCATTERED[-1] * change, noise=0.02), draw(SCATTERED[-1], noise=0.02)
    judgement = termwise.judge(*sides, at_depth=less)
    assert judgement.verdict == verdict
    assert not any("scatters" in hint.text for hint in judgement.hints)
    assert len({at for at, _ in asked}) <= depths
    assert {count for _, count in asked} <= {4}
    asked.clear()
    termwise.judge(*sides, at_depth=less, hint=False)
    assert not asked


def test_a_cause_is_refuted_on_a_part_of_a_large_image(draw: Draw, monkeypatch: pytest.MonkeyPatch):
    """What is no cause is not tried on the whole; what is one is found as in small images."""
    monkeypatch.setattr(hints, "PART", 16)
    monkeypatch.setattr(hints, "_STEP", 8)
    whole, sizes = accumulation.measure, []

    def measured(ours: np.ndarray, *arguments: Any, **options: Any) -> Any:
        sizes.append(ours.shape[1:3])
        return whole(ours, *arguments, **options)

    monkeypatch.setattr(hints.accumulation, "measure", measured)
    half = np.where(X[..., None] < 0.5, 1.05, 1.0)
    assert hinted(termwise.judge(draw(PICTURE * half), draw())) == ""
    first, *others = sizes
    assert first == (SIZE, SIZE)
    assert len(others) >= 3
    assert set(others) == {(16, 16)}
    sizes.clear()
    assert "shifted by 2 px to the left" in hinted(termwise.judge(draw(change=lambda i: np.roll(i, 2, 1)), draw()))
    assert max(sizes[1:]) == (SIZE - 6, SIZE - 6)


def test_what_the_whole_tolerates_refutes_no_cause_on_a_part(draw: Draw, monkeypatch: pytest.MonkeyPatch):
    """Single pixels of a corner are off by 1.3 %, 0.4 % rms of the image, and by more than 1 % of the corner."""
    monkeypatch.setattr(hints, "PART", 16)
    monkeypatch.setattr(hints, "_STEP", 8)
    checker = (-1.0) ** np.indices((SIZE, SIZE)).sum(axis=0)
    corner = (X > 2 / 3) & (Y > 2 / 3)
    ours = 2.0 * (1.0 + 0.013 * checker * corner)[..., None] * np.ones(3)
    noise = {"noise": 0.002}
    judgement = termwise.judge(draw(ours, **noise), draw(np.ones_like(ours), **noise))
    assert "ours is divided by 2" in hinted(judgement)


def test_hints_within_a_mask(draw: Draw):
    """What is outside of the mask is broken, and does not hide the cause."""
    mask = np.zeros((SIZE, SIZE), bool)
    mask[6:40, 4:44] = True

    def inner(image: np.ndarray) -> np.ndarray:
        return np.where(mask[..., None], image, 5.0)

    judgement = termwise.judge(draw(change=lambda image: 3 * inner(image)), draw(change=inner), mask=mask)
    assert "one factor, 0.333" in hinted(judgement)
    assert termwise.judge(draw(change=inner), draw(), mask=mask).verdict == "EQUIVALENT"
    assert termwise.judge(draw(change=inner), draw()).verdict == "BIASED"


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (1.02 * PICTURE, "2 % too bright, everywhere"),
        (0.9 * PICTURE, "10 % too dark, everywhere"),
        (0 * PICTURE, "black, everywhere"),
        (PICTURE * np.array([1.1, 0.9, 1.0]), "wrong colours: red 10 % too bright, green 10 % too dark"),
        (PICTURE * np.array([1.0, 1.0, 1.05]), "blue 5 % too bright"),
        (PICTURE[::-1], "misplaced"),
        (PICTURE + np.where(X < 0.5, 0.1, -0.1)[..., None] * np.array([1.0, -0.2973, 0.0]), "misplaced by "),
        (0.995 * np.roll(PICTURE, 3, 0), "misplaced by "),
        (np.where(((X < 0.3) & (Y < 0.3))[..., None], 1.3, 1.0) * PICTURE, "most of all at tile x 0-15, y 0-15"),
        (np.where(((X < 0.3) & (Y < 0.3))[..., None], 1.04, 1.0) * PICTURE, "too bright"),
    ],
)
def test_a_proven_error_in_plain_words(draw: Draw, picture: np.ndarray, words: str):
    judgement = termwise.judge(draw(picture), draw(), noiseless=True, hint=False)
    assert judgement.verdict == "BIASED"
    assert words in judgement.headline


def test_other_verdicts_in_plain_words(draw: Draw):
    assert termwise.judge(draw(), draw()).headline.startswith("agrees: off by ")
    noisy = termwise.judge(draw(noise=3.0), draw(noise=3.0))
    assert noisy.verdict == "UNDERPOWERED"
    assert noisy.samples_ratio is not None
    replicates = int(np.ceil(16 * noisy.samples_ratio))
    assert noisy.headline.startswith("too noisy to say: needs ")
    assert noisy.headline.endswith(f"or {replicates} replicates a side")
    known = termwise.judge(draw(noise=3.0), draw(noise=3.0), samples=8)
    assert known.headline == f"too noisy to say: needs {known.samples_to_margin} samples a pixel"
    nothing = np.zeros((4, 8, 8, 3))
    assert "nothing to compare" in termwise.judge(nothing, nothing).headline
    broken = draw()
    broken[3, 5, 6, 0] = np.nan
    assert termwise.judge(broken, draw()).headline.endswith("1 value NaN or infinite, the first at x 6, y 5 of ours[3]")


def test_one_factor_is_everywhere_beside_a_sky_without_noise(draw: Draw):
    """Where nothing varies, the factor itself is known less well than its tiles."""
    picture = np.where(Y[..., None] < 0.4, 0.7, PICTURE)

    def drawn(gain: float) -> np.ndarray:
        return gain * np.where(Y[..., None] < 0.4, picture, draw(picture))

    assert termwise.judge(drawn(1.02), drawn(1.0)).headline == "2 % too bright, everywhere"


def test_the_largest_error_is_named_and_not_the_surest(draw: Draw):
    """Of two tiles the brighter one is off by less, and surely; the column at the border has nothing at all."""
    picture = PICTURE.copy()
    picture[0:16, 0:16] *= 1.05
    picture[32:48, 16:32] *= 1.5
    picture[:, -1] = 0.0
    ours, reference = draw(picture), draw()
    judged = termwise.judge(ours, reference, hint=False)
    said = " ".join(judged.reasons)
    assert f"right column (x {SIZE - 1}): -100.00%" in said
    assert "tile x 16-31, y 32-47: +" in said
    # One bright pixel is not what a place that is black lacks.
    ours[:, 20, 20], reference[:, 20, 20] = 300.0, 300.0
    assert "right column" in " ".join(termwise.judge(ours, reference, hint=False).reasons)


def test_what_no_samples_help_is_not_counted_in_them(draw: Draw):
    ours = draw()
    ours[3, 5, 5] = 1e9
    assert "do a few pixels hold all the light" in termwise.judge(ours, draw()).headline


def test_what_lossy_files_hide_no_samples_show(draw: Draw, tmp_path: Path):
    header = {"compression": OpenEXR.DWAA_COMPRESSION, "type": OpenEXR.scanlineimage}
    for side in ("ours", "theirs"):
        (tmp_path / side).mkdir()
        for k, image in enumerate(draw().astype(np.float32)):
            OpenEXR.File(header, {"RGB": image}).write(str(tmp_path / side / f"{k}.exr"))
    judged = termwise.judge(tmp_path / "ours", tmp_path / "theirs")
    assert judged.verdict == "UNDERPOWERED"
    assert judged.headline.endswith("no samples help: write ZIP")
    assert any("lossy compression (DWAA)" in line for line in judged.warnings)


def test_files_are_named_where_they_do_not_fit(draw: Draw, tmp_path: Path):
    for side in ("ours", "theirs"):
        (tmp_path / side).mkdir()
        for k, image in enumerate(draw().astype(np.float32)):
            np.save(tmp_path / side / f"{k}.npy", image)
    ours, theirs, mask = tmp_path / "ours", tmp_path / "theirs", tmp_path / "mask.npy"
    with pytest.raises(ValueError, match=r"images and reference are the same files \(.*0.npy"):
        termwise.judge(ours, ours)
    np.save(mask, np.ones((8, 9)))
    with pytest.raises(ValueError, match=rf"mask.npy: is 9 x 8 pixels: allowed are {SIZE} x {SIZE}"):
        termwise.judge(ours, theirs, mask=mask)
    np.save(mask, np.full((SIZE, SIZE), np.nan))
    with pytest.raises(ValueError, match=r"mask.npy: holds values that are not finite"):
        termwise.judge(ours, theirs, mask=mask)
    broken = np.load(ours / "2.npy")
    broken[4, 6] = np.nan
    np.save(ours / "2.npy", broken)
    assert termwise.judge(ours, theirs).headline.endswith(f"the first at x 6, y 4 of {ours / '2.npy'}")


def test_the_samples_that_are_asked_for_suffice(draw: Draw):
    """So many times the replicates, and the verdict is another one."""
    first = termwise.judge(draw(noise=0.5, count=8), draw(noise=0.5, count=8))
    assert first.verdict == "UNDERPOWERED"
    assert first.samples_ratio is not None
    count = int(np.ceil(1.5 * 8 * first.samples_ratio))  # with them it is in 80 % of runs
    assert termwise.judge(draw(noise=0.5, count=count), draw(noise=0.5, count=count)).verdict == "EQUIVALENT"


def test_margin_and_level_are_those_asked_for(draw: Draw):
    ours, reference = draw(), draw()
    wide, narrow = (termwise.judge(ours, reference, margin=margin) for margin in (0.02, 0.0002))
    assert (wide.verdict, narrow.verdict) == ("EQUIVALENT", "UNDERPOWERED")
    assert "±2.00%" in wide.sentence
    off = [termwise.judge(1.006 * ours, reference, level=level, hint=False) for level in (0.2, 1e-9)]
    assert off[0].family_low > off[1].family_low  # type: ignore[operator]
    assert "1e-07%" in off[1].sentence
    with pytest.raises(ValueError, match="margin"):
        termwise.judge(ours, reference, margin=0.0)
    with pytest.raises(ValueError, match="level"):
        termwise.judge(ours, reference, level=1.5)


def test_an_object_is_a_place_of_its_own(draw: Draw, tmp_path: Path):
    """3 % on 8 x 8 of 64 x 64 pixels: 0.05 % of the mean."""
    inside = np.zeros((64, 64), int)
    inside[40:48, 8:16] = 5
    flat = np.ones((64, 64, 3))
    ours, reference = draw(np.where(inside[..., None] == 5, 1.03, 1.0) * flat, noise=0.05), draw(flat, noise=0.05)
    np.save(tmp_path / "objects.npy", inside)
    for objects in (inside, tmp_path / "objects.npy", str(tmp_path / "objects.npy")):
        judgement = termwise.judge(ours, reference, objects=objects)
        assert judgement.verdict == "BIASED"
        assert "object 5" in judgement.reasons[0]
    assert "object 5" in judgement.headline
    named = termwise.judge(ours, reference, objects=inside, object_names=["", "", "", "", "", "lamp"])
    assert "lamp" in named.headline


def test_negative_pixels_where_they_are_allowed(draw: Draw):
    def lobes(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[::9, ::7] -= 0.6
        image[1::9, 1::7] += 0.6
        return image

    ours, reference = draw(change=lobes), draw(change=lobes)
    assert termwise.judge(ours, reference, allow_negative=True).verdict == "EQUIVALENT"
    with pytest.raises(ValueError, match="--allow-negative"):
        termwise.judge(ours, reference)
    assert termwise.judge(ours, draw()).verdict == "BIASED"


def test_what_holds_replicates_is_taken(draw: Draw, tmp_path: Path):
    """Arrays, lists, files, folders: one verdict."""
    ours, reference = draw().astype(np.float32), draw().astype(np.float32)
    for side, stack in (("mine", ours), ("ref", reference)):
        for k, image in enumerate(stack):
            write_exr(tmp_path / side / f"{k:02d}.exr", {"": image}, {})
    expected = termwise.judge(ours, reference).bias
    files = sorted((tmp_path / "mine").iterdir())
    for given in (list(ours), tmp_path / "mine", str(tmp_path / "mine"), files, [str(path) for path in files]):
        assert termwise.judge(given, reference).bias == pytest.approx(expected, rel=1e-12)
    assert termwise.judge(tmp_path / "mine", tmp_path / "ref").settings["images"][0].endswith("00.exr")
    kept = TermImage.from_replicates(ours, samples=64, seconds=8.0, keep=True)
    judgement = termwise.judge(kept, reference, margin=0.0005)
    assert judgement.bias == pytest.approx(expected, rel=1e-12)
    assert judgement.samples_to_margin == np.ceil(64 * (judgement.samples_ratio or 0))
    with pytest.raises(ValueError, match="images: holds its mean alone"):
        termwise.judge(TermImage(PICTURE, PICTURE, 1, 4, 0.0), reference)


def test_a_judgement_shows_itself(draw: Draw, tmp_path: Path):
    judgement = termwise.judge(draw(change=lambda image: np.pi * image), draw())
    assert repr(judgement) == f"<BIASED: {judgement.headline}>"
    shown = judgement._repr_html_()
    assert shown.count("data:image/png;base64,") == 3
    for words in ("BIASED", "everywhere", "90 % interval", "divided by π"):
        assert words in shown
    assert len(shown) < 100_000
    page = judgement.save(tmp_path / "there")
    assert page == tmp_path / "there" / "index.html"
    text = page.read_text("utf-8")
    assert "divided by π" in text
    assert 'id="viewer"' in text
    assert len(list((tmp_path / "there" / "data" / "images").iterdir())) >= 3


def test_the_docstring_stands_on_its_own():
    """No reader has to look up a name that is not public."""
    text = termwise.judge.__doc__ or ""
    assert "measure" not in text
    assert all(f"{name}" in text for name in ("margin", "level", "objects", "mask", "exact", "BIASED", "EQUIVALENT"))


@pytest.mark.parametrize("name", ["a/b", "..", "a b: c", "", "é"])
def test_a_case_has_a_folder_of_its_own_within_the_suite(name: str):
    assert "/" not in slug(name)
    assert slug(name).strip(".")


def test_an_image_too_large_for_the_viewer_says_so(draw: Draw, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from termwise.reports.pages import judge as page

    monkeypatch.setattr(page, "VIEWED_PIXELS", SIZE * SIZE - 1)
    judgement = termwise.judge(draw(), draw())
    text = judgement.save(tmp_path).read_text("utf-8")
    assert "have no viewer" in text
    assert 'id="viewer"' not in text
    assert not (tmp_path / "data").exists()
    ours, reference = judgement.ours, judgement.reference
    assert ours is not None
    assert reference is not None
    with xarray.open_dataset(tmp_path / "results.nc", engine="h5netcdf") as kept:
        assert kept["image"].dims == ("y", "x", "channel")
        assert kept["channel"].values.tolist() == ["red", "green", "blue"]
        assert kept.attrs["exposure"] == pytest.approx(0.18 / np.mean(reference.mean @ [0.2126, 0.7152, 0.0722]))
        np.testing.assert_array_equal(kept["image"], ours.mean)
        np.testing.assert_array_equal(kept["reference_variance"], reference.variance)
        for side, found in judgement.maps.items():
            assert kept[f"tile_p_{side}"].dims == (f"tile_y_{side}", f"tile_x_{side}")
            for name in ("bias", "p", "holm", "benjamini_hochberg"):
                np.testing.assert_array_equal(kept[f"tile_{name}_{side}"], getattr(found, name))
