"""Looks: replicates of both sides are added until a row is decided or a budget of seconds is spent.

A row is judged at 1, 2, 4 and 8 times the replicates of its study, each time by the one rule of
`reports.statistics.rule` at a quarter of its level: whichever look ends it,

    P(false alarm) ≤ Σ_looks α/4 = α,     P(EQUIVALENT | bias = margin) ≤ Σ_looks 5 %/4 = 5 %.

At a full level each time, five looks would call a bias of exactly the margin EQUIVALENT in 10 to 14 % of runs. A budget
decides only how far a row gets, never what a look finds: its replicates are those of the seed, whatever the machine.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple, Protocol

import numpy as np

LOOKS = (1, 2, 4, 8)
"""Times the replicates of the study, on both sides: K = 16, 32, 64, 128 unless it says otherwise."""


class Item(NamedTuple):
    """What is rendered in replicates: a cell of ours or a limit of the reference, named by its content."""

    side: Literal["ours", "reference"]
    key: str


class Ledger:
    """Seconds of rendering, without compilation, as they are kept with the replicates: what rows share counts once."""

    def __init__(self) -> None:
        self._seconds: dict[Item, np.ndarray] = {}

    def book(self, item: Item, seconds: np.ndarray) -> None:
        """Put down the seconds (K,) of all replicates of an item so far."""
        if len(seconds) > len(self._seconds.get(item, ())):
            self._seconds[item] = np.asarray(seconds, dtype=np.float64)

    @property
    def spent(self) -> float:
        """Seconds of all replicates, both sides."""
        return float(sum(seconds.sum() for seconds in self._seconds.values()))

    def missing(self, counts: Mapping[Item, int]) -> float:
        """Seconds that so many replicates would take beyond those there are, by the mean of these."""
        means = {item: self._seconds[item].mean() for item in counts}
        return float(sum(means[item] * max(0, count - len(self._seconds[item])) for item, count in counts.items()))

    def took(self, side: str, wanted: Iterable[Mapping[Item, int]]) -> float:
        """Seconds that one side needed for so many replicates of each row, what they share counted once."""
        most: dict[Item, int] = {}
        for counts in wanted:
            for item, count in counts.items():
                most[item] = max(count, most.get(item, 0))
        return float(sum(self._seconds[item][:count].sum() for item, count in most.items() if item.side == side))


class Row(Protocol):
    """A row that can be looked at again."""

    def wanted(self, factor: int) -> Mapping[Item, int]:
        """How many replicates of what a look takes."""
        ...

    def look(self, factor: int) -> bool:
        """Take them, book their seconds and judge the row; whether that decided it."""
        ...


def go_on(undecided: Sequence[Row], ledger: Ledger, budget: float) -> None:
    """Look again at rows that the first look left undecided, as far as the budget pays for whole looks.

    All rows have a look before any has the next, the cheapest first, so that few noisy rows do not take what would
    decide many. A row that is decided gets no further replicates; one that the rest of the budget does not pay for
    stays as it is.

    Parameters
    ----------
    undecided : rows after their look at factor 1.
    ledger : with the seconds of that look.
    budget : seconds for all looks, the first one among them.
    """
    for factor in LOOKS[1:]:
        left = []
        for row in sorted(undecided, key=lambda row: ledger.missing(row.wanted(factor))):
            if ledger.spent + ledger.missing(row.wanted(factor)) <= budget and not row.look(factor):
                left.append(row)
        undecided = left
