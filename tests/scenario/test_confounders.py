def test_neighbours_differ_in_one_value(scenario_of) -> None:
    grid = scenario_of("blocktower").confounders
    near = [grid.decode(c, 3) for c in grid.neighbours(0, 3)]
    assert len(near) == len(set(map(str, near))) == 3 + 3 + 2 + 2  # masses, frictions, gravity x, gravity y
    own = grid.decode(0, 3)
    for other in near:
        values, theirs = ([*c.mass, *c.friction, *c.gravity_xy] for c in (own, other))
        assert sum(a != b for a, b in zip(values, theirs, strict=True)) == 1
