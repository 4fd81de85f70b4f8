"""An experiment in words: its do-operation, and what is hidden in it."""

from collections.abc import Collection

import numpy as np

from cophy.drawing.labels.text import Line
from cophy.scenario import Camera, Scenario, Shape

NOUNS = {Shape.BOX: "block", Shape.SPHERE: "ball", Shape.CYLINDER: "cylinder"}
CONFOUNDERS = {"mass": "{:g}\u00a0kg", "friction": "friction\u00a0{:g}", "restitution": "restitution\u00a0{:g}"}
TOGETHER = "\u00a0"  # a space at which no line ends
SMALLEST = 0.005  # a part of a movement, or of gravity, below this is not named


class Words:
    """Words about the experiments of a loaded dataset."""

    def __init__(self, scenario: Scenario, arrays: dict[str, np.ndarray]) -> None:
        self.scenario, self.arrays = scenario, arrays
        grid = scenario.confounders
        self._hidden = [name for name in CONFOUNDERS if len(getattr(grid, name)) > 1]
        self._gravity_is_hidden = max(len(grid.gravity_x), len(grid.gravity_y)) > 1

    @property
    def hidden(self) -> str:
        """Names of the confounders, as in "mass, friction and gravity"."""
        names = [*self._hidden, *(["gravity"] if self._gravity_is_hidden else [])]
        return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

    def object_name(self, experiment: int, slot: int) -> str:
        """As in "red block"."""
        return f"{list(self.scenario.colors)[slot]} {NOUNS[Shape(self.arrays['shape'][experiment, slot])]}"

    def slots(self, experiment: int) -> list[int]:
        """The slots of A's objects, the highest object first."""
        present = np.flatnonzero(self.arrays["presence"][experiment, 0])
        height = self.arrays["states"][experiment, 0, 0, present, 2].round(2)
        return [int(slot) for slot in present[np.argsort(-height, kind="stable")]]

    def do_operation(self, experiment: int) -> str:
        """What makes C of A, as in "the red block moved 0.40 m to the left"."""
        slot = int(self.arrays["do_slot"][experiment])
        name = f"the {self.object_name(experiment, slot)}"
        if not self.arrays["presence"][experiment, 1, slot]:
            return f"{name} taken away"
        parts = _parts(self.arrays["do_offset"][experiment], self.scenario.camera)
        return f"{name} moved " + " and ".join(f"{size:.2f}{TOGETHER}m {way}" for way, size in parts.items())

    def confounders(self, experiment: int, bold: Collection[str] = ()) -> list[Line]:
        """A line for each object, and one for gravity where that is hidden.

        Args:
            experiment: Whose confounders.
            bold: Lines with one of these texts stand out.
        """
        lines = []
        for slot in self.slots(experiment):
            values = [CONFOUNDERS[name].format(self.arrays[name][experiment, slot]) for name in self._hidden]
            color = list(self.scenario.colors.values())[slot]
            lines.append(Line(f"{self.object_name(experiment, slot)}: {', '.join(values)}", swatch=color))
        if self._gravity_is_hidden:
            parts = _parts(self.arrays["gravity"][experiment], self.scenario.camera)
            said = ", ".join(f"{size:g}{TOGETHER}{way}" for way, size in parts.items())
            lines.append(Line(f"gravity in m/s²: {said}"))
        return [Line(line.text, line.swatch, bold=line.text in bold) for line in lines]

    def differing(self, experiment: int, other: int) -> set[str]:
        """Texts of the lines of confounders that two experiments do not share."""
        mine, others = ({line.text for line in self.confounders(row)} for row in (experiment, other))
        return mine ^ others


def _parts(vector: np.ndarray, camera: Camera) -> dict[str, float]:
    """The parts of a vector, (3,), as the camera's viewer names them: direction -> size, those that are not zero."""
    ahead = np.subtract(camera.target, camera.eye)[:2]
    ahead = ahead / np.linalg.norm(ahead)
    right = np.array([ahead[1], -ahead[0]])
    ways = (("to the right", "to the left"), ("to the back", "to the front"), ("up", "down"))
    sizes = (float(vector[:2] @ right), float(vector[:2] @ ahead), float(vector[2]))
    return {way[size < 0]: abs(size) for way, size in zip(ways, sizes, strict=True) if abs(size) >= SMALLEST}
