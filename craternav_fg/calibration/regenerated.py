"""A shipped constant beside what its calibration gives."""

from dataclasses import dataclass
from enum import Enum

# A shipped value is reproduced if it is within so many standard errors of the regenerated one.
MAX_SIGMAS = 3.0


class Relation(Enum):
    """What the calibration says of a shipped value."""

    FITTED = "fitted"
    """Shipped is the regenerated value, within its statistical error; see `Regenerated.verdict`."""
    EXACT = "exact"
    """Shipped is the regenerated value, rounded: nothing is random."""
    AT_LEAST = "at least"
    """Shipped is a bound: not below the regenerated value, beyond its statistical error."""
    KEPT = "kept"
    """The data give another value, which `known` is; the family's module says why the shipped one is kept."""


@dataclass(frozen=True)
class Regenerated:
    """A constant, as shipped and as regenerated.

    Attributes
    ----------
    name : str
        Name of the constant, with its unit.
    shipped : float
    value : float
        Regenerated.
    error : float
        Standard error of `value`; where nothing is random, half a unit of the last digit that is shipped.
    relation : Relation
    known : float
        What the data give, where that is not the shipped value.
    """

    name: str
    shipped: float
    value: float
    error: float
    relation: Relation = Relation.FITTED
    known: float = float("nan")

    @property
    def sigmas(self) -> float:
        """Shipped less regenerated value, in standard errors."""
        return (self.shipped - self.value) / self.error

    @property
    def holds(self) -> bool:
        """Whether the relation is as stated."""
        match self.relation:
            case Relation.EXACT:
                return abs(self.sigmas) <= 1.0
            case Relation.AT_LEAST:
                return self.sigmas >= -MAX_SIGMAS
            case Relation.KEPT:
                return abs(self.known - self.value) <= MAX_SIGMAS * self.error
            case Relation.FITTED:
                return abs(self.sigmas) <= MAX_SIGMAS

    @property
    def verdict(self) -> str:
        """What the calibration says, in words.

        A fitted value is "confirmed" where the errors within which it passes are smaller than itself and than
        the regenerated one. Else it is "not contradicted": zero, or twice of it, might pass as well.
        """
        if self.relation is not Relation.FITTED:
            return self.relation.value if self.holds else f"not {self.relation.value}"
        if not self.holds:
            return "contradicted"
        least = min(abs(self.shipped), abs(self.value))
        return "confirmed" if MAX_SIGMAS * self.error <= least else "not contradicted"
