"""What a diagnosis finds, as values."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, TYPE_CHECKING

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.gyroscope import GyroscopeComparison
from vio_eval_ros.diagnosis.limits import DEFAULT, DiagnosisLimits
from vio_eval_ros.diagnosis.warnings import warnings_of

if TYPE_CHECKING:
    from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun

SCHEMA = 'vio_eval_ros.diagnosis/1'


@dataclass(frozen=True)
class Cause:
    """
    One thing that is wrong.

    :param name: one of ``CAUSES``.
    :param confidence: 0 to 1, that its size is beyond what healthy runs show.
    :param value: its size: what the estimate is wrong by, not what corrects it.
    :param unit: of the value.
    :param uncertainty: half the width of the 95 % interval of the value; NaN where it has none.
    :param ate_before_m: the ATE with the causes before this one undone.
    :param ate_after_m: the ATE with this one undone as well.
    :param evidence: one sentence of numbers.
    :param advice: one sentence on what to do.
    :param flags: of ``replay``, that correct it; empty where only the estimator can. What begins
        with a question mark is appended to the spec of the side.
    :param side: ``estimate`` or ``ground_truth``, of which it is wrong.
    """

    name: str
    confidence: float
    value: float
    unit: str
    uncertainty: float
    ate_before_m: float
    ate_after_m: float
    evidence: str
    advice: str
    flags: tuple[str, ...] = ()
    side: str = 'estimate'


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """
    What is wrong with an estimate.

    :param causes: the one that explains most first; empty where nothing is unusual.
    :param cannot_tell: names of causes that this motion, or these data, cannot show.
    :param findings: everything measured, by name, also where it is healthy.
    :param corrected: the estimate with all causes undone, as far as that can be done afterwards.
    :param begin_ns: the first stamp of the estimate, as it was received.
    :param errors_before: errors of the estimate against interpolated truth, by name.
    :param errors_after: those of the corrected one.
    :param limits: what counted as healthy.
    :param profile: the platform that the limits are of.
    :param gyroscope: what a gyroscope says of the estimate, where one was given.
    :param run: the poses that were diagnosed, as they came; None where they are not at hand.
    :param assumed: what was taken for granted when the sides were read, as sentences.
    """

    causes: tuple[Cause, ...]
    cannot_tell: tuple[str, ...]
    findings: dict[str, Any]
    corrected: Trajectory
    begin_ns: int
    errors_before: dict[str, float]
    errors_after: dict[str, float]
    limits: DiagnosisLimits = DEFAULT
    profile: str = PROFILES[0]
    gyroscope: GyroscopeComparison | None = None
    run: DiagnosedRun | None = None
    assumed: tuple[str, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """What to know of these poses that is not a cause, as sentences; ``assumed`` first."""
        return [*self.assumed, *warnings_of(self.findings, self.gyroscope, self.limits)]

    def errors(self) -> dict[str, dict[str, float | None]]:
        """Return each error before and after all causes are undone, by its name."""
        return {
            name: without_nan({'before': value, 'after': self.errors_after.get(name)})
            for name, value in self.errors_before.items()
        }

    def to_dict(self, errors: bool = False) -> dict[str, Any]:
        """
        Return all but the trajectory as plain numbers, strings and lists: what ``--json`` prints.

        :param errors: whether the findings have the errors before and after.
        """
        findings = without_nan(self.findings)
        if self.gyroscope is not None:
            findings['gyroscope'] = without_nan(vars(self.gyroscope))
        if errors:
            findings['errors'] = self.errors()
        return {
            'schema': SCHEMA,
            'profile': self.profile,
            'limits': self.limits.to_dict(),
            'causes': [without_nan(asdict(cause)) for cause in self.causes],
            'cannot_tell': list(self.cannot_tell),
            'warnings': self.warnings,
            'findings': findings,
        }
