from cophy.scenario import Body, Displace, Remove, Scene, Shape

BODIES = tuple(Body(Shape.BOX, (1, 1, 1), (0.0, 0.0, 0.5 + z), slot, mass=1.0) for z, slot in enumerate((2, 0)))
SCENE = Scene((Body(Shape.BOX, (9, 9, 1), (0, 0, -0.5)), *BODIES), gravity=(0, 0, -10))


def test_displacing_moves_one_object_and_leaves_a_intact() -> None:
    changed = Displace("displace", 0, (0.5, -0.25, 0.0)).apply(SCENE)
    assert [body.position for body in changed.objects] == [(0.0, 0.0, 0.5), (0.5, -0.25, 1.5)]
    assert [body.position for body in SCENE.objects] == [(0.0, 0.0, 0.5), (0.0, 0.0, 1.5)]


def test_removing_takes_one_object_and_leaves_a_intact() -> None:
    assert [body.slot for body in Remove("remove", 2).apply(SCENE).objects] == [0]
    assert len(SCENE.objects) == 2
