"""Fixed bodies around the objects. Their friction and restitution are 1, or 0 where contact shall have none of it:
Bullet multiplies the values of two bodies, so an object's own values hold on the floor."""

from cophy.scenario.physics.scene import Body, Shape

FLOOR_EXTENT_M = 100.0
WALL_THICKNESS_M = 1.0


def floor() -> Body:
    """The ground: its top face is z = 0; impacts on it are inelastic."""
    return Body(Shape.BOX, (FLOOR_EXTENT_M, FLOOR_EXTENT_M, 1.0), position=(0.0, 0.0, -0.5), friction=1.0)


def walls(half_width: float, height: float) -> tuple[Body, Body, Body, Body]:
    """Four frictionless walls whose inner faces are at ±half_width in x and y; objects bounce at their own restitution."""
    centre, length = half_width + WALL_THICKNESS_M / 2, 2 * (half_width + WALL_THICKNESS_M)

    def wall(x: float, y: float) -> Body:
        size = (WALL_THICKNESS_M, length, height) if x else (length, WALL_THICKNESS_M, height)
        return Body(Shape.BOX, size, position=(x, y, height / 2), friction=0.0, restitution=1.0)

    return wall(-centre, 0.0), wall(centre, 0.0), wall(0.0, -centre), wall(0.0, centre)
