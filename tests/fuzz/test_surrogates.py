"""Surrogate models against scikit-learn's own predictions, and on functions they should learn."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern
from sklearn.kernel_ridge import KernelRidge

from behavexplor.fuzz.samota import GAUSSIAN_PROCESS, KERNELS, POLYNOMIAL, RBF, fit_ensemble, fit_rbf

RNG = np.random.default_rng(0)
POINTS = RNG.random((60, 4))
VALUES = np.stack([POINTS[:, 0] ** 2 + POINTS[:, 1] * POINTS[:, 2], np.sin(6 * POINTS[:, 3])], axis=1)
NEW = RNG.random((20, 4))


def predicted_by_scikit_learn(points, values, new):
    """Predictions of models of scikit-learn, in the order of `KERNELS`; shape (models, new, k)."""
    length = np.median([np.linalg.norm(a - b) for i, a in enumerate(points) for b in points[:i]])
    models = {
        POLYNOMIAL: KernelRidge(kernel="poly", degree=2, gamma=1 / length**2, coef0=1.0, alpha=1e-2),
        RBF: KernelRidge(kernel="rbf", gamma=1 / (2 * length**2), alpha=1e-2),
        GAUSSIAN_PROCESS: GaussianProcessRegressor(Matern(length, nu=1.5), alpha=1e-2, optimizer=None),
    }
    means = values.mean(0)
    return np.stack([models[kernel].fit(points, values - means).predict(new) + means for kernel in KERNELS])


def test_the_models_predict_what_scikit_learn_does():
    ensemble = fit_ensemble(POINTS, VALUES, np.random.default_rng(1))
    assert ensemble.outputs(NEW) == pytest.approx(predicted_by_scikit_learn(POINTS, VALUES, NEW), abs=1e-6)


@pytest.mark.parametrize("n", [10, 59])
def test_models_weigh_as_the_inverse_of_their_errors_on_a_fifth_of_the_points(n):
    points, values = POINTS[:n], VALUES[:n]
    order = np.random.default_rng(1).permutation(n)
    held_out, rest = order[: n // 5], order[n // 5 :]
    errors = predicted_by_scikit_learn(points[rest], values[rest], points[held_out]) - values[held_out]
    inverse = 1 / np.sqrt((errors**2).mean(axis=1))
    weights = fit_ensemble(points, values, np.random.default_rng(1)).weights
    assert weights == pytest.approx(inverse / inverse.sum(axis=0), rel=1e-3)


def test_the_ensemble_is_a_weighted_mean_and_its_uncertainty_the_widest_disagreement():
    ensemble = fit_ensemble(POINTS, VALUES, np.random.default_rng(1))
    outputs = ensemble.outputs(NEW)
    predicted, unsure = ensemble.predict(NEW)
    assert predicted == pytest.approx((outputs * ensemble.weights[:, None]).sum(0))
    assert unsure == pytest.approx(outputs.max(0) - outputs.min(0))
    assert ensemble.weights.sum(0) == pytest.approx([1, 1])


def test_it_learns():
    predicted, _ = fit_ensemble(POINTS, VALUES, np.random.default_rng(1)).predict(NEW)
    truth = np.stack([NEW[:, 0] ** 2 + NEW[:, 1] * NEW[:, 2], np.sin(6 * NEW[:, 3])], axis=1)
    assert (((predicted - truth) ** 2).mean(0) < [0.1 * truth[:, 0].var(), 0.4 * truth[:, 1].var()]).all()


def test_a_better_model_weighs_more():
    """The first objective is a quadratic polynomial, the second is none."""
    weights = fit_ensemble(POINTS, VALUES, np.random.default_rng(1)).weights
    assert weights[0, 0] > 0.4
    assert weights[0, 1] < weights[2, 1]


def test_models_disagree_more_where_nothing_is_known():
    ensemble = fit_ensemble(POINTS, VALUES, np.random.default_rng(1))
    assert ensemble.predict(POINTS + 3)[1].mean() > 5 * ensemble.predict(POINTS)[1].mean()


@pytest.mark.parametrize("n", [2, 5, 9])
def test_few_points_weigh_all_models_equally(n):
    ensemble = fit_ensemble(POINTS[:n], VALUES[:n], np.random.default_rng(1))
    assert ensemble.weights == pytest.approx(np.full((3, 2), 1 / 3))
    assert np.isfinite(ensemble.predict(NEW)[0]).all()


def test_equal_points_and_values_are_no_trouble():
    points, values = np.ones((12, 4)), np.ones((12, 1))
    ensemble = fit_ensemble(points, values, np.random.default_rng(1))
    assert ensemble.predict(points)[0] == pytest.approx(values)


def test_one_rbf_model_is_an_ensemble_of_one():
    model = fit_rbf(POINTS, VALUES[:, :1])
    predicted, unsure = model.predict(POINTS)
    assert predicted == pytest.approx(VALUES[:, :1], abs=0.05)
    assert (unsure == 0).all()
    assert model.kernels == (RBF,)
