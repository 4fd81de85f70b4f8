"""Types and ranges of the keys of every command.

commands: one dataclass per command.
trainer_arguments: what lightning.Trainer takes.
study_command: the same for study.py.
models: the same for the choices of `model=`.
registration: makes the schemas known to Hydra.
"""
