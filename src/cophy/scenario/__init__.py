"""What is simulated: scenarios, their scenes and twins, and pictures of them (no torch).

scenario: what every scenario has, and how a twin pair is made.
blocktower, balls, collision: the three scenarios of the paper.
confounders: the grid of values, and configurations of them.
do_operations: displace an object, or remove one.
experiment: AB and CD under the same confounders; twin pairs.
symmetry: rotations and reflections that leave a scenario as it is.

physics: rigid bodies and their simulation. search: how twins are found. rendering: pictures. oracles: what only they need.
"""

from cophy.scenario.balls import Balls
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.collision import Collision
from cophy.scenario.confounders import ConfounderGrid, Confounders
from cophy.scenario.do_operations import Displace, Remove
from cophy.scenario.experiment import Experiment
from cophy.scenario.physics.scene import Body, Scene, Shape, Trajectory
from cophy.scenario.physics.simulation_settings import Clock, Solver
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Camera, Scenario, Task

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
