"""What can be known of D without the motion of AB (paper Sec. 3, Table 6 right)?

shortcuts: the questions: what C, the do-operation or the observed outcome alone tell.
classifiers: boosted trees that are asked them, cross-validated over twin pairs.
visible_features: what there is to be seen before anything moves.
"""
