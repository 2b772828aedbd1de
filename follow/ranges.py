"""The rules for most settings: a finite number, above zero unless it may be zero, and plausible."""

import math
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def require_numbers(
    kind: str, settings: "DataclassInstance", *, may_be_zero: Collection[str] = (), any_sign: Collection[str] = ()
) -> None:
    """Raise ValueError naming the first number among the settings that is not finite or not positive."""
    for name in (f.name for f in fields(settings)):
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if name in any_sign:
            rule, holds = "a finite number", True
        elif name in may_be_zero:
            rule, holds = "zero or a positive number", value >= 0
        else:
            rule, holds = "a positive number", value > 0
        if not (holds and math.isfinite(value)):
            raise ValueError(f"{kind} {name} must be {rule}, not {value:g}")


def require_at_least(kind: str, settings: "DataclassInstance", least: Mapping[str, float], why: str) -> None:
    """Raise ValueError naming the first number smaller than `least`; `why` follows "raise it"."""
    for name, smallest in least.items():
        value = getattr(settings, name)
        if value < smallest:
            raise ValueError(f"{kind} {name} must be at least {smallest:g}, not {value:g}: raise it, {why}")


def require_at_most(kind: str, settings: "DataclassInstance", most: Mapping[str, float]) -> None:
    """Raise ValueError naming the first number larger than `most` in either direction: usually one in another unit."""
    for name, largest in most.items():
        value = getattr(settings, name)
        if value is not None and abs(value) > largest:
            raise ValueError(f"{kind} {name} must be at most {largest:g}, not {value:g}: check its unit")
