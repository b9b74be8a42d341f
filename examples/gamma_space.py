"""An estimator with a classic fault: it averages its samples after gamma encoding. The study must catch it.

termwise compare cornell_box --study quick --estimators examples/gamma_space.py
"""

import numpy as np

import termwise


def gamma_space(scene, samples, seed):
    """Ambient occlusion whose samples are averaged in display space: too dark wherever it is noisy."""
    passes = [termwise.render(scene, "ambient", samples=1, seed=seed + k).mean for k in range(samples)]
    return np.mean([image ** (1 / 2.2) for image in passes], axis=0) ** 2.2


termwise.register("ambient", "gamma-space", gamma_space, termwise.Limit("ambient"))
