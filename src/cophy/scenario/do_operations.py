"""Do-operations (paper Sec. 3): visible changes of the initial scene A that make it C. A itself stays as it is."""

from dataclasses import dataclass, replace

from cophy.scenario.physics.scene import Scene, Vector


@dataclass(frozen=True)
class Displace:
    """Move one object.

    kind: the scenario's name for it, one of its `do_operations`. slot: of the object. offset_m: metres, world frame.
    """

    kind: str
    slot: int
    offset_m: Vector

    def apply(self, scene: Scene) -> Scene:
        """The scene with the object moved."""
        body = next(body for body in scene.objects if body.slot == self.slot)
        x, y, z = (p + d for p, d in zip(body.position, self.offset_m, strict=True))
        return scene.with_object(replace(body, position=(x, y, z)))


@dataclass(frozen=True)
class Remove:
    """Take one object away. kind: the scenario's name for it, one of its `do_operations`. slot: of the object."""

    kind: str
    slot: int

    def apply(self, scene: Scene) -> Scene:
        """The scene without the object."""
        return scene.without_object(self.slot)


DoOperation = Displace | Remove
