"""Parts that several networks are made of.

graph_convolution: Eq. 1 of the paper, with f and g.
relative_messages: f of Eq. 1 that also sees how two objects lie to each other.
graph: which objects hear which, and with what weight.
slot_mlp: what replaces the graph convolution in the ablation `mlp`.
packing: leaves out slots that no experiment of a batch needs.
mlp: the one builder of multi-layer perceptrons.
"""
