"""Scenarios: confounders, scenes, simulation, search for twin pairs, and rendering. No torch."""

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
