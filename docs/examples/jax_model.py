"""An MLP in JAX, from the shards alone; its five trainings are samples, which the energy score judges together.

python docs/examples/jax_model.py DATASET OUTPUT.npz
"""

import sys
from pathlib import Path

import h5py
import jax
import jax.numpy as jnp
import numpy as np

PER_FRAME = 4  # stored states per frame


def read(dataset: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (experiment, AB or CD, frame, slot, xyz) and the splits of a dataset."""
    positions, splits = [], []
    for shard in sorted(dataset.glob("shard-*.h5")):
        with h5py.File(shard) as file:
            positions.append(file["states"][:, :, ::PER_FRAME, :, :3])
            splits.append(file["split"][:])
    return np.concatenate(positions), np.concatenate(splits)


def predict(weights: list[jax.Array], inputs: jax.Array) -> jax.Array:
    """Return D - C, (experiment, values)."""
    first, second = weights
    return jax.nn.relu(inputs @ first) @ second


@jax.jit
def step(weights: list[jax.Array], inputs: jax.Array, motion: jax.Array) -> list[jax.Array]:
    """Return the weights after a step of gradient descent."""
    gradients = jax.grad(lambda each: jnp.square(predict(each, inputs) - motion).mean())(weights)
    return [weight - 0.1 * gradient for weight, gradient in zip(weights, gradients, strict=True)]


def main(dataset: Path, output: Path, steps: int = 2000) -> None:
    """Train five times, and write a file of samples."""
    position, split = read(dataset)
    initial, outcome = position[:, 1, :1], position[:, 1, 1:]
    inputs = np.concatenate([position[:, 0].reshape(len(split), -1), initial.reshape(len(split), -1)], axis=1)
    motion, train, test = (outcome - initial).reshape(len(split), -1), split == 0, split == 2
    samples = []
    for seed in range(5):
        keys = jax.random.split(jax.random.key(seed), 2)
        shapes = (inputs.shape[1], 128), (128, motion.shape[1])
        weights = [jax.random.normal(k, s) / np.sqrt(s[0]) for k, s in zip(keys, shapes, strict=True)]
        for batch in np.random.default_rng(seed).choice(np.flatnonzero(train), (steps, 64)):
            weights = step(weights, inputs[batch], motion[batch])
        samples.append(initial[test] + np.asarray(predict(weights, inputs[test])).reshape(outcome[test].shape))
    np.savez_compressed(output, experiment=np.flatnonzero(test), samples=np.stack(samples, axis=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
