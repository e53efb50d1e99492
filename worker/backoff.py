"""How long to wait before trying again: doubling, capped, and spread so that workers do not come in step."""

from dataclasses import dataclass
from random import Random


@dataclass(frozen=True, slots=True, kw_only=True)
class Backoff:
    """A schedule of waiting times.

    Attributes:
        first_s: Longest wait after the first failure.
        cap_s: Longest wait ever.
    """

    first_s: float
    cap_s: float

    def delay_s(self, failures: int, rng: Random) -> float:
        """Return a wait between half and all of the doubled, capped time.

        Args:
            failures: Failures in a row so far, >= 1.
            rng: Source of the spread.
        """
        # Past 2**32 the cap has long been reached; the exponent is bounded so that floats stay finite.
        longest_s = min(self.cap_s, self.first_s * 2.0 ** min(failures - 1, 32))
        return longest_s * rng.uniform(0.5, 1.0)
