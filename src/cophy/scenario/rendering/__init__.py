"""From states to pictures.

camera: where in the picture a point appears, and which part of it is shown.
renderer: draws sequences with PyBullet.
frames: the pictures of a sequence, and the settings that ask for them.
textures: procedural floors and backdrops.
"""
