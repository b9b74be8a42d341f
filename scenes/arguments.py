"""Arguments of the public functions: what is wrong is one line that names the argument, its value, what is allowed."""

from numbers import Integral

SEEDS = 2**64
"""Seeds that every generator takes are below it."""


def whole(name: str, value: object, low: int = 1, high: int | None = None) -> int:
    """An integer argument in [low, high]; a ValueError where it is none, a bool included, or out of range."""
    number = int(value) if isinstance(value, Integral) and not isinstance(value, bool) else low - 1
    if low <= number and (high is None or number <= high):
        return number
    span = f"of at least {low}" if high is None else f"in [{low}, {high}]"
    raise ValueError(f"{name} = {value!r}: allowed is an integer {span}")


def seed_of(value: object) -> int:
    """A seed."""
    return whole("seed", value, 0, SEEDS - 1)
