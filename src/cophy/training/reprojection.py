"""Comparison of what a de-renderer finds with the colours in its images, and refusal of images that it does not see."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from PIL import ImageColor

from cophy.errors import CophyError
from cophy.scenario import Scenario

MAX_COLOR_ANGLE = (
    0.1  # rad between a pixel's RGB and its object's; ours: rendered objects differ by 0.02, two colours by 0.09
)
BRIGHTNESS = 0.5, 1.1  # of a pixel relative to the colour of its object; ours: rendered objects have 0.54 to 1.04
MIN_AREA = 0.2  # ours: fewer pixels of a colour, as a share of a square of the object's size, are no object
MAX_DISTANCE = 0.5  # in object sizes; ours: the estimated centre must lie on the object
APPARENT_SIZE = 0.7, 1.4  # in object sizes; ours: of all rendered objects that are not hidden


class Evidence(NamedTuple):
    """What a de-renderer and the colours of a sequence say about each slot.

    Attributes:
        presence: (K,) presence probability of the de-renderer, mean over frames.
        found: (K,) bool, whether the de-renderer finds the object in most frames.
        shown: (K,) bool, whether most frames have pixels of its colour, or None where the colours are not known.
        distance_m: (K,) reprojection error: median distance in metres, across the line of sight, from the estimated centre to
            the centroid of these pixels. NaN if not both found and shown.
        apparent_size: (K,) median edge of a square with as many pixels, relative to the object's size at its estimated place.
    """

    presence: np.ndarray
    found: np.ndarray
    shown: np.ndarray | None
    distance_m: np.ndarray
    apparent_size: np.ndarray


def compare(
    rgb: np.ndarray, position: np.ndarray, presence_logit: np.ndarray, scenario: Scenario, *, colors_known: bool = True
) -> Evidence:
    """Compare estimates with the images that they come from.

    Args:
        rgb: (T, R, R, 3) uint8 images.
        position: (T, K, 3) estimates, metres.
        presence_logit: (T, K) estimates.
        scenario: Its camera and colours are those of the images.
        colors_known: Whether they are; if not, only presence is reported.
    """
    found = (presence_logit > 0).mean(axis=0) > 0.5
    presence = (1 / (1 + np.exp(-presence_logit.astype(np.float64)))).mean(axis=0)
    if not colors_known:
        unknown = np.full(len(found), np.nan)
        return Evidence(presence, found, None, unknown, unknown)
    area, centroid = map(np.stack, zip(*(_measure(image, scenario) for image in rgb), strict=True))
    camera, resolution = scenario.camera, rgb.shape[1]
    size_px = scenario.object_size_m * camera.pixels_per_metre(position, resolution)
    typical_px = scenario.object_size_m * camera.pixels_per_metre(np.array(camera.target), resolution)
    shown = (area >= MIN_AREA * typical_px**2).mean(axis=0) > 0.5
    both = found & shown
    distance = np.linalg.norm(camera.project(position, resolution) - centroid, axis=-1) / size_px
    distance_m, apparent = np.full((2, len(found)), np.nan)
    distance_m[both] = scenario.object_size_m * np.nanmedian(distance[:, both], axis=0)
    apparent[both] = np.median(np.sqrt(area[:, both]) / size_px[:, both], axis=0)
    return Evidence(presence, found, shown, distance_m, apparent)


def _measure(image: np.ndarray, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Return number (K,) and centroid (K, 2), in pixels, of the pixels of each colour; the centroid of none is NaN."""
    colors = np.array([ImageColor.getrgb(color) for color in scenario.colors.values()], dtype=np.float32)
    length = np.linalg.norm(colors, axis=1)
    pixels = image.reshape(-1, 3).astype(np.float32)
    along = pixels @ (colors / length[:, None]).T
    cosine = along / np.maximum(np.linalg.norm(pixels, axis=1), 1)[:, None]
    brightness = along / length
    cosine[(brightness < BRIGHTNESS[0]) | (brightness > BRIGHTNESS[1])] = 0
    nearest = cosine.argmax(axis=1)
    labels = np.where(cosine.max(axis=1) > np.cos(MAX_COLOR_ANGLE), nearest, len(colors))
    count = np.bincount(labels, minlength=len(colors) + 1)[:-1]
    y, x = np.divmod(np.arange(len(pixels)), image.shape[1])
    edges = x, y + 1  # not pixel centres: TinyRenderer draws everything half a pixel to the right and up
    sums = [np.bincount(labels, weights, minlength=len(colors) + 1)[:-1] for weights in edges]
    return count, np.stack(sums, axis=-1) / np.where(count, count, np.nan)[:, None]


def check_seen(name: str, evidence: Evidence, scenario: Scenario) -> None:
    """Refuse images whose colours contradict the de-renderer.

    Args:
        name: Of the images, for the message.

    Raises:
        CophyError: An object is found that the images do not show, or not at this place or in this size; or one that they show
            is not found.
    """
    if not evidence.found.any() and not (evidence.shown is not None and evidence.shown.any()):
        raise CophyError(f"the de-renderer finds no object in {name}: give images of {scenario.name}")
    if evidence.shown is None:
        return
    if np.any(missed := evidence.shown & ~evidence.found):
        raise CophyError(f"{name} shows {_names(missed, scenario)}, which the de-renderer does not find")
    if np.any(invented := evidence.found & ~evidence.shown):
        raise CophyError(f"the de-renderer finds {_names(invented, scenario)} in {name}, which shows no such colour")
    limit = MAX_DISTANCE * scenario.object_size_m
    if np.any(away := evidence.distance_m > limit):
        farthest = np.nanmax(evidence.distance_m)
        raise CophyError(
            f"the de-renderer finds {_names(away, scenario)} in {name} up to {farthest:.2f} m from where the image shows "
            f"it, more than {limit:g} m: are these images of {scenario.name}, from its camera?"
        )
    size = evidence.apparent_size
    if np.any(misfit := (size < APPARENT_SIZE[0]) | (size > APPARENT_SIZE[1])):
        ratios = ", ".join(f"{ratio:.2f}" for ratio in size[misfit])
        raise CophyError(
            f"{_names(misfit, scenario)} in {name}: {ratios} times as large as an object at the estimated place: are these "
            f"images of {scenario.name}, from its camera?"
        )


def check_intervention(
    observed: Evidence, initial: Evidence, moved_m: np.ndarray, scenario: Scenario, num_objects: Collection[int]
) -> None:
    """Refuse sequences with another number of objects than trained on, and a C that is no single do-operation on A.

    Args:
        observed: Evidence of AB.
        initial: Evidence of C.
        moved_m: (K,) distance of each estimated position in C from that in A.
        num_objects: Numbers of objects in AB that the de-renderer was trained on.

    Raises:
        CophyError: AB or C shows what the training data do not.
    """
    in_ab, in_c = observed.found, initial.found
    if in_ab.sum() not in num_objects:
        known = " or ".join(map(str, sorted(num_objects)))
        raise CophyError(
            f"number of objects in AB: {in_ab.sum()} ({_names(in_ab, scenario)}); the de-renderer knows {known}"
        )
    if np.any(new := in_c & ~in_ab):
        raise CophyError(f"C shows {_names(new, scenario)}, which AB does not")
    gone = in_ab & ~in_c
    if gone.any() and not any("remove" in kind for kind in scenario.do_operations):
        raise CophyError(f"C lacks {_names(gone, scenario)}; in {scenario.name}, no object is removed")
    changed = gone | (in_c & (moved_m > MAX_DISTANCE * scenario.object_size_m))
    if changed.sum() > 1:
        raise CophyError(f"C differs from A in {_names(changed, scenario)}: only one object may be moved or removed")


def _names(slots: np.ndarray, scenario: Scenario) -> str:
    return ", ".join(name for name, chosen in zip(scenario.colors, slots, strict=True) if chosen)


def to_csv(observed: Evidence, initial: Evidence, scenario: Scenario) -> str:
    """Return a line per sequence and slot; what is not known is empty."""
    lines = ["sequence,object,presence_probability,reprojection_error_m,apparent_size"]
    for sequence, evidence in (("AB", observed), ("C", initial)):
        for name, presence, *measured in zip(
            scenario.colors, evidence.presence, evidence.distance_m, evidence.apparent_size, strict=True
        ):
            values = ",".join("" if np.isnan(value) else f"{value:.3f}" for value in measured)
            lines.append(f"{sequence},{name},{presence:.4f},{values}")
    return "\n".join(lines) + "\n"


def in_words(observed: Evidence, initial: Evidence, scenario: Scenario) -> list[str]:
    """Return a line per object that is found in AB: presence, and the reprojection error where it is known."""
    lines = []
    for slot, name in enumerate(scenario.colors):
        parts = [
            f"presence {100 * evidence.presence[slot]:.1f} % in {sequence}"
            + ("" if np.isnan(error := evidence.distance_m[slot]) else f", reprojection error {error:.2f} m")
            for sequence, evidence in (("AB", observed), ("C", initial))
        ]
        if observed.found[slot]:
            lines.append(f"{name}: {'; '.join(parts)}")
    return lines
