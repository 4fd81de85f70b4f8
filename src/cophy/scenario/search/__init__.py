"""How twin pairs are found that fill the cells of a dataset equally.

assignment: which confounders, kind of do-operation and cell an index stands for.
held_out: which half of the configurations † splits train on.
settled: whether AB tells, on paper, if C stands.
simulated: search by simulation (balls, collision).
tower_search: search by statics on paper (towers).
towers: the geometries and cells of towers.
"""
