"""Physics: scenarios, scenes, confounders, do-operations, simulation, and the search for experiments (no torch)."""

from cophy.scenario.balls import Balls
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.collision import Collision
from cophy.scenario.confounders import ConfounderGrid, Confounders
from cophy.scenario.do_operations import Displace, Remove
from cophy.scenario.experiment import Experiment
from cophy.scenario.physics import Clock, Simulator, Solver
from cophy.scenario.scenario import Camera, Scenario, Task
from cophy.scenario.scene import Body, Scene, Shape, Trajectory

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
