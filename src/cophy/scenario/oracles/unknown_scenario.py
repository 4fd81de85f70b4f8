"""What is said where an oracle is asked about a scenario that it does not know."""

from cophy.errors import CophyError
from cophy.scenario.scenario import Scenario


def unknown_scenario(scenario: Scenario) -> CophyError:
    """The error that names the scenario and the remedy."""
    return CophyError(
        f"the oracles do not know scenario={scenario.name}: leave out model=oracle_*, or register "
        f"{type(scenario).__name__} in cophy.scenario.oracles"
    )
