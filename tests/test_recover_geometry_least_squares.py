"""The damped Gauss–Newton driver: minima of known problems, its order of convergence, and honest endings."""

from dataclasses import replace

import numpy as np
import pytest

from huesphere.recover.geometry.least_squares import Schedule, descend

SCHEDULE = Schedule(first_damping=1e-3, most_steps=200, trials=12, relative_gain=1e-12)


def marquardt(residual, jacobian):
    """(loss, linearise, step) of Σ residual², the damping multiplying the diagonal of the normal matrix."""

    def linearise(x):
        J, e = jacobian(x), residual(x)
        return J.T @ J, J.T @ e

    def step(x, equations, damping):
        H, g = equations
        return x - np.linalg.solve(H + damping * np.diag(np.diag(H)), g)

    return {"loss": lambda x: float(residual(x) @ residual(x)), "linearise": linearise, "step": step}


def rosenbrock():
    return marquardt(
        lambda x: np.array([1 - x[0], 10 * (x[1] - x[0] ** 2)]),
        lambda x: np.array([[-1.0, 0.0], [-20 * x[0], 10.0]]),
    )


def exponentials():
    """Two decays through exact samples: zero residual at (1, 0.5, 2, 3)."""
    t = np.linspace(0, 3, 25)

    def residual(x):
        return x[0] * np.exp(-x[1] * t) + x[2] * np.exp(-x[3] * t) - (np.exp(-0.5 * t) + 2 * np.exp(-3 * t))

    def jacobian(x):
        first, second = np.exp(-x[1] * t), np.exp(-x[3] * t)
        return np.stack([first, -x[0] * t * first, second, -x[2] * t * second], axis=-1)

    return residual, jacobian


def test_the_minimum_of_rosenbrocks_function_is_found():
    outcome = descend(np.array([-1.2, 1.0]), **rosenbrock(), schedule=SCHEDULE)
    assert outcome.state == pytest.approx([1.0, 1.0], abs=1e-8)
    assert outcome.converged


def test_convergence_to_a_minimum_of_zero_residual_is_quadratic():
    residual, jacobian = exponentials()
    truth, errors = np.array([1.0, 0.5, 2.0, 3.0]), []
    problem = marquardt(residual, jacobian)
    schedule = replace(SCHEDULE, first_damping=1e-12, relative_gain=0.0, most_steps=1)
    state = truth * [1.3, 1.3, 0.7, 0.7]
    for _ in range(6):
        state = descend(state, **problem, schedule=schedule).state
        errors.append(float(np.linalg.norm(state - truth)))
    errors = np.array([e for e in errors if 1e-11 < e < 0.5])  # near the minimum, and above rounding
    order = np.polyfit(np.log(errors[:-1]), np.log(errors[1:]), 1)[0]
    assert len(errors) >= 4
    assert order == pytest.approx(2.0, abs=0.25)


def test_convergence_to_a_minimum_with_residual_is_linear():
    """Gauss–Newton leaves out the residual's curvature: of y = exp(a t) the error then falls by one factor a step."""
    t = np.array([0.0, 1.0, 2.0])
    y = np.array([1.6, 1.0, 6.5])
    problem = marquardt(lambda a: np.exp(a[0] * t) - y, lambda a: (t * np.exp(a[0] * t))[:, None])
    truth = descend(np.array([1.0]), **problem, schedule=replace(SCHEDULE, relative_gain=0.0)).state
    schedule, state, errors = replace(SCHEDULE, first_damping=1e-12, most_steps=1), truth + 0.1, []
    for _ in range(5):
        state = descend(state, **problem, schedule=schedule).state
        errors.append(float(abs(state[0] - truth[0])))
    order = np.polyfit(np.log(errors[1:-1]), np.log(errors[2:]), 1)[0]
    assert order == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("seed", range(20))
def test_the_loss_never_rises(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.standard_normal((2, 6, 3, 3)), rng.standard_normal(6)

    def residual(x):
        return np.einsum("kij,i,j->k", A[0], x, x) + np.sin(A[1, :, 0] @ x) - b

    def jacobian(x):
        return np.einsum("kij,j->ki", A[0] + A[0].swapaxes(1, 2), x) + np.cos(A[1, :, 0] @ x)[:, None] * A[1, :, 0]

    problem, seen = marquardt(residual, jacobian), []

    def linearise(x):  # is called with accepted states alone
        seen.append(problem["loss"](x))
        return problem["linearise"](x)

    outcome = descend(5 * rng.standard_normal(3), **{**problem, "linearise": linearise}, schedule=SCHEDULE)
    assert np.all(np.diff(seen) < 0)
    assert outcome.loss <= seen[-1]
    assert outcome.loss == problem["loss"](outcome.state)


def test_a_descent_cut_short_says_so():
    outcome = descend(np.array([-1.2, 1.0]), **rosenbrock(), schedule=replace(SCHEDULE, most_steps=3))
    assert outcome.ending == "step limit"
    assert not outcome.converged
    assert outcome.steps == 3


def test_steps_that_only_lead_uphill_are_no_convergence():
    problem = {**rosenbrock(), "step": lambda x, equations, damping: x + 1.0}
    start = np.array([1.0, 2.0])
    outcome = descend(start, **problem, schedule=replace(SCHEDULE, trials=4))
    assert outcome.ending == "no trial lowers the loss"
    assert not outcome.converged
    assert (outcome.state == start).all()
    assert outcome.damping == pytest.approx(1e-3 * 10.0**4)


def test_a_trial_without_a_loss_is_rejected():
    problem = rosenbrock()
    tried = []

    def step(x, equations, damping):
        tried.append(damping)
        return problem["step"](x, equations, damping) if len(tried) > 2 else np.full(2, np.nan)

    outcome = descend(np.array([-1.2, 1.0]), **{**problem, "step": step}, schedule=SCHEDULE)
    assert tried[:3] == pytest.approx([1e-3, 1e-2, 1e-1])
    assert outcome.state == pytest.approx([1.0, 1.0], abs=1e-8)


def test_an_exact_start_has_converged():
    outcome = descend(np.array([1.0, 1.0]), **rosenbrock(), schedule=SCHEDULE)
    assert outcome.converged
    assert outcome.loss == 0
    assert outcome.steps == 0


def test_equations_that_promise_nothing_end_the_descent_as_converged():
    problem = {**rosenbrock(), "step": lambda x, equations, damping: None}
    outcome = descend(np.array([0.9, 0.8]), **problem, schedule=SCHEDULE)
    assert outcome.converged
    assert outcome.steps == 0


def test_damping_rises_at_least_to_one_limit_and_falls_at_most_to_the_other():
    schedule = replace(SCHEDULE, first_damping=1e-9, least_raised=1e-2, least_damping=1e-4, most_steps=1)
    uphill = {**rosenbrock(), "step": lambda x, equations, damping: x - 1.0}
    assert descend(np.array([1.0, 1.1]), **uphill, schedule=replace(schedule, trials=1)).damping == 1e-2
    assert descend(np.array([-1.2, 1.0]), **rosenbrock(), schedule=schedule).damping >= 1e-4
    assert descend(np.array([-1.2, 1.0]), **rosenbrock(), schedule=schedule, damping=1.0).damping == pytest.approx(0.1)
