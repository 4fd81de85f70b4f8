"""What is simulated: scenarios, their scenes and twins, and pictures of them (no torch).

scenario: what every scenario has, and how a twin pair is made.
blocktower: BlocktowerCF of the paper, stacked cubes that stand or fall.
balls: BallsCF of the paper, balls that roll inside four walls.
collision: CollisionCF of the paper, a moving object that is sent towards a static one.
confounders: the grid of values, and configurations of them.
do_operations: displace an object, or remove one.
experiment: AB and CD under the same confounders; twin pairs.
symmetry: rotations and reflections that leave a scenario as it is.
physics/: rigid bodies and their simulation.
search/: how twins are found.
rendering/: from states to pictures.
oracles/: what only the oracles need.
"""

from cophy.scenario.balls import Balls
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.collision import Collision
from cophy.scenario.confounders import ConfounderGrid, Confounders
from cophy.scenario.experiment import Displace, Experiment, Remove
from cophy.scenario.physics import Body, Clock, Scene, Shape, Solver, Trajectory
from cophy.scenario.scenario import Camera, Scenario, Task
from cophy.scenario.simulator import Simulator

__all__ = [
    "Balls",
    "Blocktower",
    "Body",
    "Camera",
    "Clock",
    "Collision",
    "ConfounderGrid",
    "Confounders",
    "Displace",
    "Experiment",
    "Remove",
    "Scenario",
    "Scene",
    "Shape",
    "Simulator",
    "Solver",
    "Task",
    "Trajectory",
]
