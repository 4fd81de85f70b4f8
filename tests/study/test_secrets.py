"""What is never told: where D ends, its pictures, paths of the disk."""

from typing import Any

import cv2
import numpy as np

from cophy.drawing.files import read_frames
from cophy.drawing.overview import render_sequence
from cophy.scenario.rendering import Renderer
from cophy.study.clips import CLIP, PICTURE
from tests.study.conftest import Site, take_one


def numbers_in(content: Any) -> list[float]:
    """Every number somewhere in decoded JSON."""
    if isinstance(content, dict):
        return [number for value in content.values() for number in numbers_in(value)]
    if isinstance(content, list):
        return [number for value in content for number in numbers_in(value)]
    return [float(content)] if isinstance(content, int | float) and not isinstance(content, bool) else []


def tells(content: Any, end: tuple[float, float]) -> bool:
    """Whether both coordinates are among the numbers, to a tenth of a pixel."""
    return all(any(abs(number - value) < 0.06 for number in numbers_in(content)) for value in end)


def test_nothing_of_d_is_said_before_the_answer(site: Site) -> None:
    """Where an object ends that moves is in no response, until the answer of a practice, which shows that it would be found."""
    browser, scenes, num_moving = site.participant(), site.study.experiments.scenes, 0
    for _ in range(4):
        place = browser.get("/api/place").json()
        assignment = site.study.sessions.place(browser.cookies["cophy_study"]).assignment
        assert assignment is not None
        starts = {each["slot"]: each["at"] for each in scenes.objects(assignment.experiment)}
        ends = scenes.ends(assignment.experiment)
        moving = {slot: end for slot, end in ends.items() if np.hypot(*np.subtract(end, starts[slot])) > 1}
        num_moving += len(moving)
        begun = browser.post(f"/api/assignments/{place['position']}/begin", json={}).json()
        assert not [slot for slot, end in moving.items() if tells([place, begun], end)]
        after = take_one(browser)
        told = [slot for slot, end in moving.items() if tells(after, end)]
        assert told == (list(moving) if place["is_practice"] else [])
    assert num_moving > 0


def test_no_picture_of_d_is_ever_drawn(site: Site) -> None:
    """The only files that there are to be sent: the first frame of CD, and AB."""
    experiments, clips = site.study.experiments, site.study.clips
    names = {f"{experiment}-{what}" for experiment in experiments.shown for what in (PICTURE, CLIP)}
    assert {path.name for path in clips.directory.iterdir()} == names
    experiment = experiments.shown[0]
    with Renderer(experiments.scenario, 64) as renderer:
        first = render_sequence(renderer, experiments.arrays, experiment, 1, [0]).rgb[0]
        observed = render_sequence(renderer, experiments.arrays, experiment, 0, slice(None)).rgb
    assert (read_frames(clips.path(experiment, PICTURE))[0] == first).all()
    video = cv2.VideoCapture(str(clips.path(experiment, CLIP)))
    shown = [cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2RGB) for _ in observed]
    assert np.abs(np.stack(shown).astype(int) - observed).mean() < 5
    assert not video.read()[0]


def test_no_path_of_the_disk_is_said(site: Site) -> None:
    browser = site.participant()
    paths = ["/", "/api/place", "/api/welcome", "/media/0/picture", "/web/study.js", "/media/9/picture", "/web/x", "/x"]
    for path in paths:
        assert str(site.study.clips.directory.parent).encode() not in browser.get(path).content
