"""Is a dataset what the simulator makes of it? All checks are on a sample.

resimulation: experiments are made again from the seed, and simulated again from what is stored.
convergence: experiments are simulated at twice the solver's rate.
identifiability: experiments are simulated under other confounders: does AB tell CD?
"""
