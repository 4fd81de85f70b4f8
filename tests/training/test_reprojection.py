"""What the colours of rendered images say about estimates: true ones agree with them, and faults of many kinds are named."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from cophy.dataset.images import render_sequence
from cophy.dataset.spec import DatasetSpec
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.training.reprojection import check_intervention, check_seen, compare, to_csv

ROW = 3
RIGHT_M = np.array([0.8, 0.0, 0.0])


class Sequence(NamedTuple):
    """Images (T, R, R, 3), true positions (T, K, 3), presence logits (T, K), and the scenario."""

    rgb: np.ndarray
    position: np.ndarray
    logit: np.ndarray
    scenario: Scenario


@pytest.fixture
def sequence(tiny: tuple[DatasetSpec, dict[str, Any]]) -> Sequence:
    spec, arrays = tiny
    times = slice(0, 5)
    with Renderer(spec.scenario, 112) as renderer:
        rgb = render_sequence(renderer, arrays, ROW, 0, times).rgb
    position = arrays["states"][ROW, 0, :: spec.scenario.clock.states_per_frame, :, :3][times]
    logit = np.where(arrays["presence"][ROW, 0], 5.0, -5.0) * np.ones((len(rgb), 1))
    return Sequence(rgb, position, logit, spec.scenario)


def slots_of(sequence: Sequence) -> list[int]:
    return np.flatnonzero(sequence.logit[0] > 0).tolist()


def test_true_positions_agree_with_the_image(sequence: Sequence) -> None:
    evidence = compare(*sequence)
    slots = slots_of(sequence)
    np.testing.assert_array_equal(np.flatnonzero(evidence.shown), slots)
    assert (evidence.distance_m[slots] < 0.25).all()
    assert np.isnan(np.delete(evidence.distance_m, slots)).all()
    check_seen("AB", evidence, sequence.scenario)
    lines = to_csv(evidence, evidence, sequence.scenario).splitlines()
    assert len(lines) == 1 + 2 * sequence.scenario.num_slots
    assert lines[1 + slots[0]].startswith(f"AB,{list(sequence.scenario.colors)[slots[0]]},0.9933,0.")


def test_the_reprojection_error_is_the_distance_across_the_line_of_sight(sequence: Sequence) -> None:
    true = compare(*sequence)
    moved = compare(*sequence._replace(position=sequence.position + RIGHT_M))  # every camera looks along y
    slots = slots_of(sequence)
    np.testing.assert_allclose(moved.distance_m[slots], 0.8, atol=0.2)
    assert (true.distance_m[slots] < 0.25).all()


def blank(sequence: Sequence) -> Sequence:
    return sequence._replace(rgb=np.full_like(sequence.rgb, 200))


def noise(sequence: Sequence) -> Sequence:
    return sequence._replace(rgb=np.random.default_rng(0).integers(0, 256, sequence.rgb.shape, np.uint8))


def missed(sequence: Sequence) -> Sequence:
    logit = sequence.logit.copy()
    logit[:, slots_of(sequence)[0]] = -5
    return sequence._replace(logit=logit)


def confused(sequence: Sequence) -> Sequence:
    """One object is taken for another colour."""
    free = np.flatnonzero(sequence.logit[0] < 0)[0]
    order = np.arange(sequence.logit.shape[1])
    order[[free, slots_of(sequence)[0]]] = order[[slots_of(sequence)[0], free]]
    return sequence._replace(logit=sequence.logit[:, order], position=sequence.position[:, order])


def displaced(sequence: Sequence) -> Sequence:
    return sequence._replace(position=sequence.position + RIGHT_M)


def farther(sequence: Sequence) -> Sequence:
    """All objects are estimated to be twice as far from the camera, where they are seen."""
    return sequence._replace(position=2 * sequence.position - np.array(sequence.scenario.camera.eye))


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (blank, "which shows no such colour"),
        (noise, "AB shows .*, which the de-renderer does not find"),
        (missed, "AB shows .*, which the de-renderer does not find"),
        (confused, "AB shows .*, which the de-renderer does not find"),
        (displaced, r"in AB up to (0\.[6-9]|1\.)\d* m from where the image shows it, more than 0\.5 m"),
        (farther, r"times as large as an object at the estimated place"),
    ],
)
def test_estimates_that_the_image_contradicts_are_refused(
    sequence: Sequence, fault: Callable[[Sequence], Sequence], message: str
) -> None:
    with pytest.raises(CophyError, match=message):
        check_seen("AB", compare(*fault(sequence)), sequence.scenario)


def test_images_without_objects_are_refused(sequence: Sequence) -> None:
    empty = compare(*blank(sequence)._replace(logit=-5 * np.abs(sequence.logit)))
    with pytest.raises(CophyError, match="finds no object in C"):
        check_seen("C", empty, sequence.scenario)


def test_images_of_unknown_colours_are_not_compared(sequence: Sequence) -> None:
    evidence = compare(*blank(sequence), colors_known=False)
    assert evidence.shown is None
    check_seen("AB", evidence, sequence.scenario)


def test_c_is_one_do_operation_on_a(sequence: Sequence) -> None:
    observed, slots, scenario = compare(*sequence), slots_of(sequence), sequence.scenario
    still = np.zeros(len(observed.found))
    check_intervention(observed, observed, still, scenario, [len(slots)])
    with pytest.raises(CophyError, match=f"objects in AB: {len(slots)} .* the de-renderer knows 7 or 8"):
        check_intervention(observed, observed, still, scenario, [8, 7])
    with pytest.raises(CophyError, match=r"C differs from A in .*, .*: only one object"):
        check_intervention(observed, observed, still + 1.0, scenario, [len(slots)])
    one_less = observed._replace(found=compare(*missed(sequence)).found)
    with pytest.raises(CophyError, match="which AB does not"):
        check_intervention(one_less, observed, still, scenario, [len(slots) - 1])
    if scenario.name == "collision":
        with pytest.raises(CophyError, match="in collision, no object is removed"):
            check_intervention(observed, one_less, still, scenario, [len(slots)])
    else:
        check_intervention(observed, one_less, still, scenario, [len(slots)])
