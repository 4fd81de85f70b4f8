"""Names of the checks that fail."""

from collections.abc import Iterable

from cophy.audit.checks import Check


def failing(checks: Iterable[Check]) -> set[str]:
    return {check.name for check in checks if not check.passed}
