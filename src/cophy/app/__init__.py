"""The edge to Hydra's configurations: what the commands, tests and benchmarks import, and nothing in the package does.

schemas/: types and ranges of the keys of every command.
cli: runs a command; what the user can mend ends it with one line, and a sweep with all runs that failed.
run_results: the end of a run in the terminal.
key_help: what `--help` says of the keys of a command.
composition: a configuration as the command line composes it, typed or not.
variants: what a run changes beyond its names, in the name of its directory.
datasets: the datasets that a configuration names.
python/: what `import cophy` offers.
report_choices: what the names of runs stand for, which the report asks.
assembly: takes the configuration of a run apart, and carries the run out.
"""
