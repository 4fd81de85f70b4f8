"""What the devices of a run measured, brought together."""

from typing import TypeVar

from torch import distributed

Part = TypeVar("Part")


def of_all_devices(own: list[Part]) -> list[Part]:
    """The parts of all devices that share a run, in the order of their ranks; alone, what is given."""
    if not distributed.is_initialized():
        return own
    every: list[list[Part]] = [[]] * distributed.get_world_size()
    distributed.all_gather_object(every, own)
    return [part for of_one in every for part in of_one]
