"""Small trees in the layouts that others released, written from their descriptions and not by our exporter."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

TOWER_COLORS = ("red", "green", "blue", "yellow")
BALL_COLORS = ("red", "green", "blue", "yellow", "lime", "purple", "orange", "cyan", "magenta")
COLLISION_COLORS = ("yellow", "green", "blue", "red")


def clip(path: Path, num_frames: int, fps: int, size: int) -> None:
    """An MP4 of grey frames that grow brighter, from 0 to 240."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, (size, size))
    for time in range(num_frames):
        writer.write(np.full((size, size, 3), 240 * time // num_frames, dtype=np.uint8))
    writer.release()


def states_of(starts: np.ndarray, velocities: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(T, object, 13): objects at constant velocity, unturned."""
    states = np.zeros((len(times), len(starts), 13))
    states[..., :3] = starts + velocities * times[:, None, None]
    states[..., 6] = 1.0
    states[..., 7:10] = velocities
    return states


def padded(states: np.ndarray, slots: Sequence[int], num_slots: int) -> np.ndarray:
    wide = np.zeros((len(states), num_slots, 13))
    wide[:, list(slots)] = states
    return wide


class CoPhyTree:
    """CoPhy_224 as its README and the issue describe it: 5 Hz, objects in colour slots, splits beside the tasks."""

    def __init__(self, root: Path, *, clips: bool = True, seed: int = 0) -> None:
        self.root, self.clips, self.rng = root, clips, np.random.default_rng(seed)
        (root / "splits").mkdir(parents=True)

    def sequences(
        self, directory: Path, ab: np.ndarray, cd: np.ndarray, *, colors: tuple[str | None, str | None]
    ) -> None:
        for name, states, text in (("ab", ab, colors[0]), ("cd", cd, colors[1])):
            (directory / name).mkdir(parents=True)
            np.save(directory / name / "states.npy", states)
            if self.clips:
                clip(directory / name / "rgb.mp4", len(states), 5, 32)
                clip(directory / name / "segm.mp4", len(states), 5, 32)
                np.save(directory / name / "bboxes.npy", np.zeros((*states.shape[:2], 4)))
            if text is not None:
                (directory / name / "colors.txt").write_text(text)

    def tower(self, name: str, num_blocks: int = 3, *, gravity: str = "gravity_x=0.5 gravity_y=-0.5") -> Path:
        """Block 0 glides; on even ids it is displaced in C, on odd ids the top block is removed."""
        directory = self.root / "blocktowerCF" / str(num_blocks) / name
        order = self.rng.permutation(4)[:num_blocks].tolist()
        starts = np.column_stack([self.rng.uniform(-0.3, 0.3, (num_blocks, 2)), np.arange(num_blocks) + 0.5])
        velocity = np.zeros_like(starts)
        velocity[0, 0] = 0.3
        times = np.arange(30) / 5
        ab = states_of(starts, velocity, times)
        moved = starts.copy()
        moved[0, 1] += 0.25
        remaining = num_blocks - int(name) % 2
        cd = states_of(moved if remaining == num_blocks else starts, velocity, times)[:, :remaining]
        header = "from bottom to top\n"
        colors = tuple(
            header + "".join(f"color={TOWER_COLORS[s]}\n" for s in part) for part in (order, order[:remaining])
        )
        self.sequences(directory, padded(ab, order, 4), padded(cd, order[:remaining], 4), colors=(colors[0], colors[1]))
        confounders = np.zeros((4, 2))
        confounders[order] = np.column_stack(
            [self.rng.choice([1, 10], num_blocks), self.rng.choice([0.5, 1], num_blocks)]
        )
        np.save(directory / "confounders.npy", confounders)
        (directory / "gravity.txt").write_text(gravity)
        return directory

    def generated_tower(self, name: str, num_blocks: int = 3) -> Path:
        """As the released generator of towers writes it: no colours, no boxes, bottom to top, frictions for gravity."""
        directory = self.tower(name, num_blocks)
        for part in ("ab", "cd"):
            states = np.load(directory / part / "states.npy")
            present = np.flatnonzero(states[0].any(axis=-1))
            bottom_to_top = present[np.argsort(states[0, present, 2])]
            np.save(directory / part / "states.npy", states[:, bottom_to_top])
            (directory / part / "colors.txt").unlink()
            for extra in ("segm.mp4", "bboxes.npy"):
                (directory / part / extra).unlink(missing_ok=True)
        (directory / "gravity.txt").write_text("gravity_x=0.5 gravity_y=0.5")
        return directory

    def balls(self, name: str, num_balls: int = 4) -> Path:
        directory = self.root / "ballsCF" / str(num_balls) / name
        slots = np.sort(self.rng.permutation(9)[:num_balls])
        starts = np.column_stack(
            [np.linspace(-3, 3, num_balls), self.rng.uniform(-2, 2, num_balls), np.full(num_balls, 0.5)]
        )
        velocity = np.column_stack([self.rng.uniform(-0.1, 0.1, (num_balls, 2)), np.zeros(num_balls)])
        times = np.arange(30) / 5
        ab, moved = padded(states_of(starts, velocity, times), slots, 9), starts.copy()
        moved[-1, 1] += 0.5
        cd = padded(states_of(moved, velocity, times), slots, 9)
        if int(name) % 2:
            cd = ab.copy()
            cd[:, slots[0]] = 0
        text = "".join(f"color={BALL_COLORS[slot]}\n" for slot in slots)
        self.sequences(directory, ab, cd, colors=(text, text))
        confounders = np.zeros((9, 3))
        confounders[slots, 0] = self.rng.choice([1, 2, 5], num_balls)
        confounders[slots, 1:] = self.rng.choice([0.0997877, 0.5, 1], (num_balls, 2))
        np.save(directory / "confounders.npy", confounders)
        (directory / "explanations.txt").write_text("a ball was displaced or removed")
        return directory

    def collision(self, name: str, *, moving: str = "sphere", static: str = "cylinder_up") -> Path:
        directory = self.root / "collisionCF" / name
        slots = self.rng.permutation(4)[:2]
        starts = np.array([[-2.0, self.rng.uniform(-0.3, 0.3), 0.5], [2.0, 0.0, 0.5]])
        velocity = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        times = np.arange(15) / 5
        moved = starts.copy()
        moved[1, 0] += 0.4
        ab, cd = (padded(states_of(where, velocity, times), slots, 4) for where in (starts, moved))
        kinds = zip((moving, static), slots, strict=True)
        text = "".join(f"type={kind} color={COLLISION_COLORS[slot]}\n" for kind, slot in kinds)
        self.sequences(directory, ab, cd, colors=(text, text))
        confounders = np.zeros((4, 3))
        confounders[slots] = [[5, 0.0997877, 0.5], [1, 1, 0.1]]
        np.save(directory / "confounders.npy", confounders)
        (directory / "explanations.txt").write_text("the static object was displaced")
        return directory

    def lists(self, task: str, ending: str, **ids: Sequence[str]) -> None:
        """Lists of ids: `<task>_<split><ending>.txt`."""
        for split, names in ids.items():
            (self.root / "splits" / f"{task}_{split}{ending}.txt").write_text("".join(f"{name}\n" for name in names))


def filtered_tree(root: Path, task: str, ids: Sequence[str], *, num_objects: int = 4, clips: bool = True) -> None:
    """CoPhy_112 as its README and the issue describe it: 25 Hz, objects in the order of COLORS.txt, masses alone."""
    rng = np.random.default_rng(7)
    num_states = 75 if task == "collisionCF" else 150
    for name in ids:
        directory = root / task / name
        colors = [TOWER_COLORS[index] for index in rng.permutation(4)[:num_objects]]
        starts = rng.uniform(-0.2, 0.2, (num_objects, 3))
        starts[:, 2] = np.arange(num_objects) + 0.5
        velocity = np.zeros((num_objects, 3))
        velocity[-1 if int(name) % 3 else 0, 0] = 0.2
        ab = states_of(starts, velocity, np.arange(num_states) / 25)
        cd = ab.copy()
        removed = int(name) % 2 and task != "collisionCF"
        if removed:
            cd[:, -1] = 0  # a removed object is a zero column
        else:
            cd[:, 0, 1] += 0.3
        for part, states in (("ab", ab), ("cd", cd)):
            (directory / part).mkdir(parents=True)
            np.save(directory / part / "states.npy", states)
            if clips:
                clip(directory / part / "rgb.mp4", num_states, 25, 32)
        np.save(directory / "confounders.npy", rng.choice([1, 10], num_objects))
        (directory / "COLORS.txt").write_text(str(colors))
        (directory / "do_op.txt").write_text(
            f"Remove the {colors[-1]} cube" if removed else f"Move the {colors[0]} cube of 0.3 in the y direction"
        )
