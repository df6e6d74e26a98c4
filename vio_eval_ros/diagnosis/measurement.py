"""One measured parameter of a run, and whether it is beyond what healthy runs show."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

from vio_eval_ros.diagnosis.fitting import student, T_95

#: largest uncertainty of an observable parameter, over its healthy limit
OBSERVABLE_RATIO = 2.0
#: smallest significant excess over the healthy limit, over the uncertainty
SIGNIFICANT_RATIO = 1.5


@dataclass(frozen=True)
class Measurement:
    """
    One parameter of a run.

    :param name: of the cause that it may be.
    :param value: its size, in its unit.
    :param uncertainty: half the width of the 95 % interval; NaN where it has none, infinite
        where it is not observable.
    :param healthy: the largest size that healthy runs show.
    :param needed_confidence: from which on it is unusual.
    :param size: what is compared with the healthy limit, where it is not the value itself.
    :param size_uncertainty: likewise.
    """

    name: str
    value: float
    unit: str
    uncertainty: float
    healthy: float
    needed_confidence: float
    size: float
    size_uncertainty: float

    @property
    def observable(self) -> bool:
        """Whether a fault of a size that matters would have shown."""
        return not self.size_uncertainty > OBSERVABLE_RATIO * self.healthy

    @property
    def unusual(self) -> bool:
        """Whether it is beyond what healthy runs show, as far as it is observable."""
        return self.confidence >= self.needed_confidence if self.observable else self.significant

    @property
    def significant(self) -> bool:
        """Whether it is beyond what healthy runs show by much more than its uncertainty."""
        return self.size - self.healthy > SIGNIFICANT_RATIO * self.size_uncertainty

    @property
    def confidence(self) -> float:
        """The probability that the size is beyond what healthy runs show."""
        sigma = self.size_uncertainty / T_95
        if not sigma > 0:
            return 1.0 if self.size > self.healthy else 0.0
        return student((self.size - self.healthy) / sigma)

    def as_unobservable(self) -> Measurement:
        """Return the same value, from which nothing follows."""
        return replace(self, size=0.0, size_uncertainty=math.inf)
