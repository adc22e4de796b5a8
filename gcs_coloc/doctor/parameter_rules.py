"""What a vehicle's parameter must be: one row a parameter with predicate, severity and remedy, and how rows are applied."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from gcs_coloc.doctor.finding import Finding, Severity, right, stop
from gcs_coloc.doctor.parameters import look_up


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """One parameter that the vehicle needs for aiding."""

    names: tuple[str, ...]
    """The names that it has had, the newest first."""
    accepts: Callable[[float], bool]
    """Whether a value is right."""
    severity: Severity
    """How much another value matters."""
    wrong: str | Callable[[float], str]
    """What another value means, or how to say it of that value."""
    set_to: float | Callable[[float], float] | None = None
    """The right value, or how to get it from another one; None: there is nothing to set."""
    remedy_more: str = ""
    """What follows "set NAME = VALUE" in the remedy."""
    good: str | None = None
    """What a right value means; None: it is not told."""
    unreadable: str | None = None
    """What a parameter that could not be read may mean; None: the vehicle does without it."""


def equals(value: float) -> Callable[[float], bool]:
    """The predicate of exactly one right value."""
    return lambda found: found == value


def differs_from(value: float) -> Callable[[float], bool]:
    """The predicate of exactly one wrong value."""
    return lambda found: found != value


def apply_rules(parameters: Mapping[str, float], rules: Iterable[ParameterRule]) -> Iterator[Finding]:
    """What the rules conclude from the parameters that a vehicle told."""
    for rule in rules:
        found = look_up(parameters, rule.names)
        if found is None:
            if rule.unreadable is not None:
                yield stop(
                    f"{' or '.join(rule.names)} could not be read",
                    f"run the doctor again, nearer to the vehicle; else {rule.unreadable}",
                )
            continue
        name, value = found
        if rule.accepts(value):
            if rule.good is not None:
                yield right(f"{name} = {value:g}: {rule.good}")
            continue
        text = f"{name} = {value:g}: {rule.wrong if isinstance(rule.wrong, str) else rule.wrong(value)}"
        wanted = rule.set_to(value) if callable(rule.set_to) else rule.set_to
        if wanted is None:
            yield Finding(rule.severity, text)
        else:
            yield Finding(rule.severity, text, f"set {name} = {wanted:g}{rule.remedy_more}", (name, wanted))
