"""Parts that several networks are made of.

graph_convolution: Eq. 1 of the paper, with f and g.
graph: which objects hear which, and with what weight.
slot_mlp: what replaces the graph convolution in the ablation `mlp`.
packing: leaves out slots that no experiment of a batch needs.
mlp: the one builder of multi-layer perceptrons.
"""
