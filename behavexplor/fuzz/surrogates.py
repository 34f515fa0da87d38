"""Surrogate models: what the objectives of a scenario might be, without executing it.

Source: Haq et al., "Efficient Online Testing for DNN-Enabled Systems using Surrogate-Assisted and Many-Objective
Optimization", ICSE 2022 (SAMOTA), global and local surrogates. Models come from scikit-learn. Their inputs are
`Encoding.features`, which are on one scale by construction, in training and in prediction alike; outputs are
centered anew for every fit.

All models are kernel machines: scikit-learn fits them, and their predictions, a kernel times coefficients, are
computed here for all of them at once. Asked one by one for a handful of points, they would mostly check their input.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_HELD_OUT = 0.2  # share of the rows that models are weighted by
_FEWEST = 10  # rows with which some are held out
_LEAST_LENGTH = 0.1  # of kernels, where points are alike
_RIDGE = 1e-2  # on the diagonal of the kernel matrix


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
        kernels: of the models.
        points: shape (n, features).
        length: what the kernels take for near.
        coefficients: of the kernels at the points, shape (models, n, k).
        means: of the objectives, taken off before the fit, shape (k,).
        weights: of the models, shape (models, k); they sum to 1 for each objective.
    """

    kernels: tuple[Kernel, ...]
    points: Floats
    length: float
    coefficients: Floats
    means: Floats
    weights: Floats

    def outputs(self, points: Floats) -> Floats:
        """What each model predicts at points of shape (p, features); shape (models, p, k)."""
        squared, products = _products(points, self.points)
        values = np.stack([kernel(squared, products, self.length) for kernel in self.kernels])
        return np.asarray(values @ self.coefficients + self.means)

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Objectives, and how far the models disagree about them at most.

        Args:
            points: shape (p, features).

        Returns:
            Weighted mean and widest difference of the models' predictions, each of shape (p, k).
        """
        outputs = self.outputs(points)
        return np.einsum("mpk,mk->pk", outputs, self.weights), outputs.max(0) - outputs.min(0)


def _products(points: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Squared distances and scalar products of all pairs, each of shape (points, others)."""
    products = points @ others.T
    squared = (points**2).sum(1)[:, None] + (others**2).sum(1) - 2 * products
    return np.maximum(squared, 0.0), products


def fit_ensemble(points: Floats, values: Floats, rng: np.random.Generator) -> Ensemble:
    """A quadratic polynomial, an RBF regressor and a Gaussian process, weighted by their errors on held-out rows.

    Args:
        points: shape (n, features), n >= 2.
        values: shape (n, k).
        rng: chooses the rows that are held out.
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
    """One RBF regressor; arguments as of `fit_ensemble`."""
    return _fit(points, values, (RBF,), np.ones((1, values.shape[1])))


def _fit(points: Floats, values: Floats, kernels: tuple[Kernel, ...], weights: Floats) -> Ensemble:
    """Models whose length is the median distance of the points, so that nothing has to be searched for."""
    squared, _ = _products(points, points)
    length = max(float(np.sqrt(np.median(squared[np.triu_indices(len(points), 1)]))), _LEAST_LENGTH)
    means = values.mean(0)
    coefficients = [_coefficients(kernel, length, points, values - means) for kernel in kernels]
    return Ensemble(kernels, points, length, np.stack(coefficients), means, weights)


def _coefficients(kernel: Kernel, length: float, points: Floats, values: Floats) -> Floats:
    """What scikit-learn's model of a kernel fits, shape (n, k)."""
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
