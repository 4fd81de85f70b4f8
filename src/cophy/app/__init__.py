"""The edge to Hydra's configurations: what the commands, tests and benchmarks import, and nothing in the package does.

schemas: one dataclass per command, with the types and ranges of its keys.
model_schemas: the same for the choices of `model=`.
registration: makes the schemas known to Hydra.
cli: runs a command; what the user can mend ends it with one line, and a sweep with all runs that failed.
composition: a configuration as the command line composes it, typed or not.
variants: what a run changes beyond its names, in the name of its directory.
datasets: the datasets that a configuration names.
report_choices: what the names of runs stand for, which the report asks.
assembly: takes the configuration of a run apart, and carries the run out.
"""
