"""Damped Gauss–Newton (Levenberg–Marquardt): the one loop that all nonlinear least squares of ``recover`` run through.

The caller knows the problem: what a state is, its loss, its normal equations, and the state to which these equations
lead at a given damping. The loop knows the rest: a trial that lowers the loss is accepted and the damping lowered, one
that does not is repeated at a higher damping, and it ends when an accepted step gains next to nothing. The loss never
rises, and how it ended is part of the result.

Source: K. Levenberg, Quart. Appl. Math. 2 (1944) 164–168; D. W. Marquardt, J. SIAM 11 (1963) 431–441.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

State = TypeVar("State")
Equations = TypeVar("Equations")

Ending = Literal["converged", "no trial lowers the loss", "step limit"]


@dataclass(frozen=True)
class Schedule:
    """How the damping follows success and failure, and when the descent ends."""

    first_damping: float  # of the first trial; what it multiplies is the caller's choice
    most_steps: int
    trials: int  # dampings that are tried for one step
    relative_gain: float  # a step that lowers the loss by a smaller share of it is the last
    raise_by: float = 10.0  # factor of the damping after a trial that did not lower the loss
    lower_by: float = 10.0  # divisor of the damping after one that did
    least_damping: float = 0.0  # below which success does not lower it
    least_raised: float = 0.0  # to which failure raises it at least


@dataclass(frozen=True)
class Outcome(Generic[State]):
    """Where a descent ended, and why."""

    state: State
    loss: float  # of that state
    steps: int  # that were accepted
    damping: float  # at which a next step would be tried
    ending: Ending

    @property
    def converged(self) -> bool:
        """Whether it ended because there was nothing more to gain, and not at a limit or a dead end."""
        return self.ending == "converged"


def descend(
    start: State,
    *,
    loss: Callable[[State], float],
    linearise: Callable[[State], Equations],
    step: Callable[[State, Equations, float], State | None],
    schedule: Schedule,
    damping: float | None = None,
) -> Outcome[State]:
    """The state of least ``loss`` that damped Gauss–Newton steps reach from ``start``.

    ``loss(state)`` is the number that must fall; a trial whose loss is NaN is rejected. ``linearise(state)`` makes the
    equations, once a step, at the accepted state. ``step(state, equations, damping)`` makes the trial state; None says
    that the equations promise no gain that is worth a trial, which ends the descent as converged. ``damping`` takes the
    place of the schedule's first one, as when a descent is continued under other weights.
    What the three functions raise, such as LinAlgError of a singular matrix, is passed on.
    """
    state, lowest, steps = start, loss(start), 0
    damping = schedule.first_damping if damping is None else damping
    while steps < schedule.most_steps:
        equations = linearise(state)
        for _ in range(schedule.trials):
            trial = step(state, equations, damping)
            if trial is None:
                return Outcome(state, lowest, steps, damping, "converged")
            reached = loss(trial)
            if reached < lowest:
                break
            damping = max(damping * schedule.raise_by, schedule.least_raised)
        else:
            # A loss of exactly 0 cannot fall: that is the minimum, not a dead end.
            return Outcome(state, lowest, steps, damping, "no trial lowers the loss" if lowest > 0 else "converged")
        enough = lowest - reached < schedule.relative_gain * lowest
        state, lowest, steps = trial, reached, steps + 1
        damping = max(damping / schedule.lower_by, schedule.least_damping)
        if enough:
            return Outcome(state, lowest, steps, damping, "converged")
    return Outcome(state, lowest, steps, damping, "step limit")
