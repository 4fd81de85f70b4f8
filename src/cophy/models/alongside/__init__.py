"""A predictor that reads AB step by step while it predicts D; not in the paper.

alongside: the rollout of D.
history: what every object and every pair goes through in AB.
own: what an object knows of itself in one frame.
contacts: when and how two objects would touch in the next step, and what that does to their motion.
"""
