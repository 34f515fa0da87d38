"""Surrogate models, which predict the objectives of a scenario without executing it.

Source: Haq et al., "Efficient Online Testing for DNN-Enabled Systems using Surrogate-Assisted and Many-Objective
Optimization", ICSE 2022 (SAMOTA), global and local surrogates. The models come from scikit-learn. Their inputs are
`Encoding.features`, which have one scale by construction, both in training and in prediction. Outputs are centered for
every fit.

All models are kernel machines. scikit-learn fits them. Their predictions are a kernel times coefficients, and are
computed here for all models at once: separate calls for a handful of points would spend most of their time checking
the input.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from behavexplor.data.array_types import Floats

_HELD_OUT = 0.2  # share of the rows that are held out to weight the models
_FEWEST = 10  # least number of rows at which some are held out
_LEAST_LENGTH = 0.1  # least length scale of a kernel, for points that are all alike
_RIDGE = 1e-2  # added to the diagonal of the kernel matrix


def _polynomial(squared: Floats, products: Floats, length: float) -> Floats:  # noqa: ARG001 - a kernel's signature
    return np.asarray((products / length**2 + 1) ** 2)


def _gaussian(squared: Floats, products: Floats, length: float) -> Floats:  # noqa: ARG001
    return np.asarray(np.exp(-squared / (2 * length**2)))


def _matern(squared: Floats, products: Floats, length: float) -> Floats:  # noqa: ARG001
    scaled = np.sqrt(3 * squared) / length
    return np.asarray((1 + scaled) * np.exp(-scaled))


Kernel = Callable[[Floats, Floats, float], Floats]
POLYNOMIAL, RBF, GAUSSIAN_PROCESS = _polynomial, _gaussian, _matern
KERNELS: tuple[Kernel, ...] = (POLYNOMIAL, RBF, GAUSSIAN_PROCESS)


@dataclass(frozen=True)
class Ensemble:
    """Several models of k objectives, fitted to the same n points.

    Attributes:
        kernels: kernel of each model.
        points: training points, shape (n, features).
        length: length scale of the kernels.
        coefficients: coefficients of the kernels at the points, shape (models, n, k).
        means: means of the objectives, which are subtracted before the fit, shape (k,).
        weights: weights of the models, which sum to 1 for each objective, shape (models, k).
    """

    kernels: tuple[Kernel, ...]
    points: Floats
    length: float
    coefficients: Floats
    means: Floats
    weights: Floats

    def outputs(self, points: Floats) -> Floats:
        """Compute each model's predictions at points of shape (p, features). Returns shape (models, p, k)."""
        squared, products = _products(points, self.points)
        values = np.stack([kernel(squared, products, self.length) for kernel in self.kernels])
        return np.asarray(values @ self.coefficients + self.means)

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Predict objectives, and the greatest disagreement of the models about them.

        Args:
            points: points, shape (p, features).

        Returns:
            Weighted mean and widest difference of the models' predictions, each of shape (p, k).
        """
        outputs = self.outputs(points)
        return np.einsum("mpk,mk->pk", outputs, self.weights), outputs.max(0) - outputs.min(0)


def _products(points: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Compute the squared distances and scalar products of all pairs, each of shape (points, others)."""
    products = points @ others.T
    squared = (points**2).sum(1)[:, None] + (others**2).sum(1) - 2 * products
    return np.maximum(squared, 0.0), products


def fit_ensemble(points: Floats, values: Floats, rng: np.random.Generator) -> Ensemble:
    """Fit a quadratic polynomial, an RBF regressor and a Gaussian process, weighted by their errors on held-out rows.

    Args:
        points: training points, shape (n, features), n >= 2.
        values: objectives at the points, shape (n, k).
        rng: random generator that chooses the held-out rows.
    """
    n = len(points)
    weights = np.full((len(KERNELS), values.shape[1]), 1 / len(KERNELS))
    if n >= _FEWEST:
        order = rng.permutation(n)
        test, train = order[: int(_HELD_OUT * n)], order[int(_HELD_OUT * n) :]
        outputs = _fit(points[train], values[train], KERNELS, weights).outputs(points[test])
        inverse = 1 / (np.sqrt(((outputs - values[test]) ** 2).mean(1)) + 1e-9)
        weights = inverse / inverse.sum(0)
    return _fit(points, values, KERNELS, weights)


def fit_rbf(points: Floats, values: Floats) -> Ensemble:
    """Fit a single RBF regressor. The arguments are those of `fit_ensemble`."""
    return _fit(points, values, (RBF,), np.ones((1, values.shape[1])))


def _fit(points: Floats, values: Floats, kernels: tuple[Kernel, ...], weights: Floats) -> Ensemble:
    """Fit models whose length scale is the median distance of the points, so that no length has to be searched for."""
    squared, _ = _products(points, points)
    length = max(float(np.sqrt(np.median(squared[np.triu_indices(len(points), 1)]))), _LEAST_LENGTH)
    means = values.mean(0)
    coefficients = [_coefficients(kernel, length, points, values - means) for kernel in kernels]
    return Ensemble(kernels, points, length, np.stack(coefficients), means, weights)


def _coefficients(kernel: Kernel, length: float, points: Floats, values: Floats) -> Floats:
    """Fit the coefficients of a kernel by scikit-learn's model, shape (n, k)."""
    from sklearn.gaussian_process import GaussianProcessRegressor  # noqa: PLC0415 - slow to import
    from sklearn.gaussian_process.kernels import Matern  # noqa: PLC0415
    from sklearn.kernel_ridge import KernelRidge  # noqa: PLC0415

    if kernel is GAUSSIAN_PROCESS:
        process = GaussianProcessRegressor(Matern(length, nu=1.5), alpha=_RIDGE, optimizer=None).fit(points, values)
        return np.asarray(process.alpha_).reshape(values.shape)
    if kernel is POLYNOMIAL:
        model = KernelRidge(kernel="poly", degree=2, gamma=1 / length**2, coef0=1.0, alpha=_RIDGE)
    else:
        model = KernelRidge(kernel="rbf", gamma=1 / (2 * length**2), alpha=_RIDGE)
    return np.asarray(model.fit(points, values).dual_coef_)
