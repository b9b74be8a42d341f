"""Numbers in text as all programs read them: Python alone takes 1_0 for 10, and the digits of any script."""

from collections.abc import Iterable


def reals(words: Iterable[str]) -> list[float]:
    """Each word as a number; a ValueError names the first that is none."""
    return [float(_plain(word)) for word in words]


def wholes(words: Iterable[str]) -> list[int]:
    """Each word as a whole number; a ValueError names the first that is none."""
    return [int(_plain(word)) for word in words]


def _plain(word: str) -> str:
    if "_" in word or not word.isascii():
        raise ValueError(f"{word[:60]!r} is no number")
    return word
