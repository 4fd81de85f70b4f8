"""What only the oracles (docs/benchmark/oracles.md) need of a scenario. Functions dispatch on the scenario's class; others are refused.

hypotheses: what D could be, its mean and how sure that is.
resampling: CD of other experiments that the search could have made of the same A and C.
posterior: what D could be with AB.
configuration_search: which configurations of confounders explain AB.
configuration_prior: how likely each configuration is, given A and C.
tower_prior: the same for towers, from the conditions of their search.
initial_velocities: drawn as the scenario draws them, or inferred from AB.
initial_velocity_fit: the fit of initial velocities to the first frames of AB, through the simulator.
unknown_scenario: the error for a scenario that the oracles do not know.
"""
