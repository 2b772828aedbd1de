"""What a check of `follow doctor` found."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum


class Health(str, Enum):
    """How bad a finding is."""

    OK = "ok"
    WARN = "warn"
    RED = "red"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor: what was checked, how bad it is, what was found, how to fix it, and where to do that."""

    name: str
    verdict: Health
    text: str
    fix: str = ""
    where: str = ""

    def __str__(self) -> str:
        return f"{self.verdict.value:4} {self.name}: {self.text}" + (f"  ->  {self.fix}" if self.fix else "")


class NotFitError(RuntimeError):
    """Something is red; the message names it."""


def is_fit(findings: Iterable[Finding], waived: Sequence[str] = ()) -> bool:
    """Whether nothing is red except what was waived by name."""
    return all(finding.verdict is not Health.RED or finding.name in waived for finding in findings)


def places(findings: Iterable[Finding]) -> list[str]:
    """Where the fixes are to be done, each place once."""
    return list(dict.fromkeys(finding.where for finding in findings if finding.fix and finding.where))
