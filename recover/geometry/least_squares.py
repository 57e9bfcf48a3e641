"""Damped Gauss–Newton (Levenberg–Marquardt): the one loop that all nonlinear least squares of ``recover`` run through.

The caller provides functions of a state (the unknowns): its loss, its normal equations, and the state to which a step
with a given damping leads. The loop here accepts a trial step that lowers the loss and then lowers the damping; it
repeats any other step at a higher damping; and it ends when an accepted step lowers the loss by next to nothing. The
loss never rises, and the reason for the end is part of the result.

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
    """Rules for the damping after accepted and rejected trials, and for the end of the descent."""

    first_damping: float  # damping of the first trial; the caller's ``step`` decides what it multiplies
    most_steps: int  # limit of accepted steps
    trials: int  # limit of dampings that are tried for one step
    relative_gain: float  # the descent ends after a step that lowers the loss by a smaller share than this
    raise_by: float = 10.0  # factor of the damping after a trial that did not lower the loss
    lower_by: float = 10.0  # divisor of the damping after a trial that lowered the loss
    least_damping: float = 0.0  # lower limit of the damping after an accepted trial
    least_raised: float = 0.0  # lower limit of the damping after a rejected trial


@dataclass(frozen=True)
class Outcome(Generic[State]):
    """The last state of a descent, and why it ended."""

    state: State
    loss: float  # of ``state``
    steps: int  # number of accepted steps
    damping: float  # damping with which the next step would be tried
    ending: Ending

    @property
    def converged(self) -> bool:
        """True if the descent ended because its last step gained next to nothing, or no step promised a gain."""
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

    ``loss(state)`` is the number to minimise; a trial whose loss is NaN is rejected. ``linearise(state)`` returns the
    normal equations at the accepted state and is called once a step. ``step(state, equations, damping)`` returns the
    trial state, or None where the equations promise no gain that is worth a trial, which ends the descent as converged.
    ``damping`` replaces the schedule's ``first_damping``, as when a descent is continued under other weights.
    Errors of the three functions, such as LinAlgError of a singular matrix, are passed on.
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
            # A loss of exactly 0 cannot fall: the state is the minimum.
            return Outcome(state, lowest, steps, damping, "no trial lowers the loss" if lowest > 0 else "converged")
        enough = lowest - reached < schedule.relative_gain * lowest
        state, lowest, steps = trial, reached, steps + 1
        damping = max(damping / schedule.lower_by, schedule.least_damping)
        if enough:
            return Outcome(state, lowest, steps, damping, "converged")
    return Outcome(state, lowest, steps, damping, "step limit")
