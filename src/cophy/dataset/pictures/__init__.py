"""The pictures of a dataset, and what is seen in them; sets of shards in directories below that of the states.

needed_frames: which frames are drawn: all, or only those that somebody looks at.
images: `Images`, rendered pictures of generated experiments.
estimates: `Estimates`, what a trained de-renderer sees in the frames.
"""
