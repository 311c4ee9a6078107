"""Exercises that answer: what a reader writes is tried at once.

    from exercises import check

    check("ex-hard", soft_backup)

tries the reader's function on inputs whose answer mathematics knows, and
prints what is wrong, or that nothing is filled in yet, or that it is right.
The judge of an exercise is the function below with its label's name. It
needs nothing from the page, and draws none of the page's random numbers.
"""

import itertools
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from scipy.special import expit, logsumexp
from torch.nn.functional import binary_cross_entropy_with_logits

from offairl_lite import plain, tabular

Answer = Callable[..., Any]


class Unfilled(Exception):
    """The reader's function returns nothing yet."""


class Wrong(Exception):
    """Says in a sentence what is wrong with the reader's function."""


def check(label: str, answer: Answer) -> None:
    """Print what is wrong with the reader's function, if anything is."""
    print(textwrap.fill(verdict(label, answer), 72))


def verdict(label: str, answer: Answer) -> str:
    """Return what `check` prints; whatever `answer` does, raise nothing."""
    judge = globals()[label.replace("-", "_")]

    def filled(*inputs: Any) -> Any:
        if (output := answer(*inputs)) is None or output is ...:
            raise Unfilled
        return output

    try:
        # A logarithm of 0 is for the judge to see, and no warning.
        with np.errstate(all="ignore"):
            judge(filled)
    except Unfilled:
        return "Not yet filled in: replace the dots."
    except Wrong as wrong:
        return f"Not yet. {wrong}"
    except NameError as error:
        return (
            f"It stops: {error}. Have the page's cells above been run? In "
            "JupyterLab: Run, Run All Above Selected Cell."
        )
    except Exception as error:
        return f"It stops: {type(error).__name__}: {error}"
    return "Right."


def numbers(output: Any) -> np.ndarray:
    """Return what the reader's function has returned, as an array.

    Raises:
        Wrong: these are no numbers.
    """
    try:
        return torch.as_tensor(output).detach().double().numpy()
    except (TypeError, ValueError, RuntimeError):
        kind = type(output).__name__
        raise Wrong(f"It returns a {kind} and not numbers.") from None


def equal(one: Any, other: Any) -> bool:
    """Return whether shapes and numbers are the same, up to rounding."""
    one, other = np.asarray(one), np.asarray(other)
    return one.shape == other.shape and np.allclose(one, other, 1e-5, 1e-7)


def expect(
    output: Any, right: Any, mistakes: Mapping[str, Any], hint: str
) -> None:
    """Compare an output with what is right, and with known mistakes.

    Raises:
        Wrong: with the sentence of one of the mistakes, with both shapes
            if they differ, or else with the hint.
    """
    output, right = numbers(output), np.asarray(right)
    if equal(output, right):
        return
    for sentence, value in mistakes.items():
        if equal(output, value):
            raise Wrong(sentence)
    if output.shape != right.shape:
        raise Wrong(
            f"It returns the shape {output.shape}, and {right.shape} is "
            "wanted."
        )
    raise Wrong(hint)


def finite(output: Any, advice: str) -> None:
    """Refuse what overflows.

    Raises:
        Wrong: a number is infinite, or none.
    """
    if not np.isfinite(numbers(output)).all():
        raise Wrong(f"It overflows: {advice}")


def log_normal(x: Any, mean: Any, std: Any) -> np.ndarray:
    """Return log N(x; mean, std²)."""
    z = (x - mean) / std
    return -0.5 * z**2 - np.log(std * np.sqrt(2 * np.pi))


def area(log_density: Any, a: Any) -> str:
    """Return the start of a sentence about a density, by quadrature."""
    density = np.exp(numbers(log_density))
    if density.shape != np.shape(a):
        return "Return one number for each action"
    total = np.trapezoid(density, a)
    return f"Your density integrates to {total:.2f}, not to 1"


def ex_hard(answer: Answer) -> None:
    """Chapter 1: V = α log Σ exp(Q / α)."""
    alpha, q = 0.3, np.random.default_rng(0).normal(size=(5, 3))
    soft = alpha * logsumexp(q / alpha, axis=1)
    value = numbers(answer(np.zeros((1, 2)), alpha)).sum()
    mistakes = {
        "This is the hard maximum, whose best policy is greedy. Here the "
        "policy is a softmax, and so is its maximum soft.": q.max(1),
        "The temperature is missing.": logsumexp(q, axis=1),
        "Divide by α inside the exponential and multiply by α outside: a "
        "value is in units of reward.": soft / alpha,
        "This averages over the actions. Add them up.": (
            soft - alpha * np.log(3)
        ),
    }
    hint = (
        "If both of two actions are worth 0, the entropy of the choice is "
        f"worth α log 2 = {alpha * np.log(2):.2f}; yours is {value:.2f}."
    )
    expect(answer(q.copy(), alpha), soft, mistakes, hint)
    advice = "use `logsumexp`, or subtract the largest Q first."
    finite(answer(q + 1_000, alpha), advice)


def ex_order(answer: Answer) -> None:
    """Chapter 1: the visits at time t are p₀ Pᵗ."""
    size, steps = 6, 8
    p = np.random.default_rng(0).dirichlet(np.ones(size), size)
    first = np.eye(size)[2]

    def marched(p: np.ndarray) -> np.ndarray:
        powers = [np.linalg.matrix_power(p, t) for t in range(steps)]
        return np.stack([first @ power for power in powers], 1)

    by_state = np.zeros((size, steps))
    by_state[:, 0] = first
    for s, t in itertools.product(range(size), range(steps - 1)):
        by_state[s, t + 1] = by_state[:, t] @ p[:, s]
    visits = numbers(answer(p.copy(), first.copy(), steps))
    total = f"your visits add up to {visits.sum():.1f}, not to {steps}"
    mistakes = {
        f"Visits are lost: {total}. Which entries of time t are still 0 "
        "when you use them for time t + 1?": by_state,
        "Backwards: a row of P says where a step comes from.": marched(p.T),
        "Rows are states, and columns are times.": marched(p).T,
    }
    expect(visits, marched(p), mistakes, f"Something is off: {total}.")


def ex_gail_sign(answer: Answer) -> None:
    """Chapter 2: -log(1 - D) of the logit is a softplus."""
    logit = np.linspace(-4, 4, 9)
    reward = np.logaddexp(0, logit)
    mistakes = {
        "This is log(1 - D), a part of the loss. It falls where D rises: "
        "it pays for being found out.": -reward,
        "This is -log D. It pays for looking unlike the expert.": (
            np.logaddexp(0, -logit)
        ),
        "This is log D: it rises with D, but is never positive.": (
            -np.logaddexp(0, -logit)
        ),
    }
    hint = "Where D = 1/2, the logit is 0 and the reward log 2 = 0.69."
    expect(answer(logit.copy()), reward, mistakes, hint)
    advice = "at a logit of 1,000 D rounds to 1. Write it as a softplus."
    finite(answer(np.array([-1e3, 1e3])), advice)


def ex_best_logit(answer: Answer) -> None:
    """Chapter 2: where the slope of the cross-entropy is 0."""
    expert, policy = np.array([[[60.0, 12], [5, 3]], [[4, 4], [6, 6]]])
    odds = np.log(expert / policy)
    best = odds - np.log(expert.sum() / policy.sum())
    logit = numbers(answer(expert.copy(), policy.copy()))
    mistakes = {
        "You compare counts. The expert was watched four times as long, "
        "which says nothing about where it goes: compare shares.": odds,
        "Upside down: it should be high where the expert goes.": -best,
        "This is D. Its logit is log D - log(1 - D).": expit(best),
        "This is the ratio. Take its logarithm.": np.exp(best),
    }
    at = np.resize(logit, best.shape)[0, 0]
    share = expert[0, 0] / expert.sum(), policy[0, 0] / policy.sum()
    slope = share[1] * expit(at) - share[0] * expit(-at)
    hint = (
        "The cross-entropy is not yet least: its slope in the first logit "
        f"is {slope:.2f}, and should be 0."
    )
    expect(logit, best, mistakes, hint)


def ex_two_logits(answer: Answer) -> None:
    """Chapter 3: the cross-entropy of D = eᶠ / (eᶠ + π)."""
    rng, loss = (
        torch.Generator().manual_seed(0),
        binary_cross_entropy_with_logits,
    )
    f, log_pi = torch.randn(2, 8, generator=rng, dtype=torch.double)
    for label in (torch.ones_like(f), torch.zeros_like(f)):
        mistakes = {
            "Two logits, averaged: log π has no gradient, so f learns as "
            "if it were not there. Subtract it from f.": (
                (loss(f, label) + loss(log_pi, label)) / 2
            ),
            "log π is missing from the logit.": loss(f, label),
            "The sign of log π is wrong.": loss(f + log_pi, label),
            "The labels are the wrong way round: 1 is the expert.": (
                loss(f - log_pi, 1 - label)
            ),
        }
        hint = "D = exp(f) / (exp(f) + π) has the logit f - log π."
        output = answer(f.clone(), log_pi.clone(), label)
        expect(output, loss(f - log_pi, label), mistakes, hint)
    far = torch.tensor([800.0]), torch.tensor([-800.0]), torch.ones(1)
    finite(answer(*far), "exp(f) is too large. Work with the logit.")


def ex_links(answer: Answer) -> None:
    """Chapter 3: the v for which E v(s') is the same for all actions."""
    row, column = np.divmod(np.arange(16), 4)
    torus = np.stack(
        [
            (row + up) % 4 * 4 + (column + right) % 4
            for up, right in ((0, 1), (0, -1), (1, 0), (-1, 0))
        ],
        axis=1,
    )
    resting = np.column_stack([np.arange(16), torus])
    for where, successors, connected in (
        ("a torus whose squares must be left at once", torus, 1),
        ("a torus whose squares you may stay on", resting, 1),
        ("two separate toruses", np.concatenate([torus, torus + 16]), 2),
    ):
        one = np.eye(len(successors))[successors]
        conditions = (one - one[:, :1]).reshape(-1, len(successors))
        free = len(successors) - np.linalg.matrix_rank(conditions)
        mistakes = {
            "You link a state to its successors. Linked are two states to "
            "which one and the same state can lead.": connected,
        }
        count = numbers(answer(successors.copy()))
        hint = f"It says {count} for {where}; {free} is right."
        expect(count, free, mistakes, hint)


def ex_broadcast(answer: Answer) -> None:
    """Chapter 4: the mean of (Q - y)², row by row."""
    rng = torch.Generator().manual_seed(0)
    q = torch.randn(5, 1, generator=rng, dtype=torch.double)
    y = torch.randn(5, generator=rng, dtype=torch.double)
    squares = (q[:, 0] - y).square()
    perfect = numbers(answer(y[:, None].clone(), y.clone())).round(2)
    mistakes = {
        "(B, 1) minus (B,) is (B, B): every estimate is compared with "
        "every target.": (q - y).square().mean(),
        "This is the sum. Take the mean over the batch.": squares.sum(),
        "A square for each row. Take their mean.": squares,
    }
    hint = f"If all estimates are right, your loss is {perfect}, and not 0."
    expect(answer(q.clone(), y.clone()), squares.mean(), mistakes, hint)


def ex_printed_gradient(answer: Answer) -> None:
    """Chapter 4: y = r + γ (1 - terminated) (min Q - α log π)."""
    rng = torch.Generator().manual_seed(0)
    r, log_pi, *q = torch.randn(4, 6, generator=rng, dtype=torch.double)
    end = torch.tensor([0.0, 0, 1, 0, 1, 0], dtype=torch.double)
    both, alpha, gamma = torch.stack(q), 0.2, 0.9
    least, bonus, goes_on = both.amin(0), -alpha * log_pi, gamma * (1 - end)
    mistakes = {
        "So the paper prints it. Five things are wrong.": (
            r - gamma * q[0] - bonus
        ),
        "Nothing follows a termination.": r + gamma * (least + bonus),
        "The sign of the next value is wrong.": r
        - goes_on * (least + bonus),
        "The sign of the entropy is wrong: what is improbable is paid.": (
            r + goes_on * (least - bonus)
        ),
        "The entropy belongs to the next state: γ and 1 - terminated count "
        "for it as well.": r + goes_on * least + bonus,
        "Of the two critics the smaller counts.": r
        + goes_on * (q[0] + bonus),
    }
    hint = "V(s') = min Q - α log π, and y = r + γ (1 - terminated) V(s')."
    output = answer(r, end, both, log_pi, alpha, gamma)
    expect(output, r + goes_on * (least + bonus), mistakes, hint)


def ex_jacobian(answer: Answer) -> None:
    """Chapter 5: the density of tanh(u)."""
    a = torch.linspace(-1, 1, 20_001, dtype=torch.double)[1:-1]
    mean, log_std = torch.tensor([0.4, -0.5], dtype=torch.double)
    u, normal = (
        torch.atanh(a),
        torch.distributions.Normal(mean, log_std.exp()),
    )
    right = plain.log_density(u[:, None], mean, log_std)
    output = answer(a.clone(), mean, log_std)
    found = area(output, a)
    mistakes = {
        f"{found}: it is that of u, taken at a. First undo the tanh.": (
            normal.log_prob(a)
        ),
        f"{found}: the Jacobian of tanh is missing.": normal.log_prob(u),
        f"{found}: the Jacobian has the wrong sign. Near ±1 much of u is "
        "pressed into little of a.": 2 * normal.log_prob(u) - right,
    }
    expect(output, right, mistakes, f"{found}: is the Jacobian right?")


def ex_clamp(answer: Answer) -> None:
    """Chapter 6: SAC's best answer to f - log π, in one state."""
    f, alpha = np.array([1.0, 0.0]), 0.2

    def soft(reward: np.ndarray) -> np.ndarray:
        return reward / alpha - logsumexp(reward / alpha)

    for tail in (-8.0, np.log(0.4)):
        log_pi = np.array([np.log1p(-np.exp(tail)), tail])
        held = f - np.maximum(log_pi, -5)
        mistakes = {
            "-log π is not clamped.": soft(f - log_pi),
            "The clamp is on the wrong side: -log π is at most 5.": (
                soft(f - np.minimum(log_pi, -5))
            ),
            "Its probabilities do not add up to 1.": held / alpha,
            "SAC's own temperature is missing.": held - logsumexp(held),
        }
        hint = "The best answer is the softmax of (f - clamped log π) / α."
        expect(answer(f.copy(), log_pi, alpha), soft(held), mistakes, hint)


def ex_blind(answer: Answer) -> None:
    """Chapter 6: a reward whose canonical form is constant."""
    gamma, shape = 0.9, (4, 3, 4)
    reward = numbers(answer(4, 3, gamma))

    def varies(gamma: float) -> float:
        mean = reward.mean((1, 2))
        form = reward + gamma * mean - mean[:, None, None]
        return np.ptp(form) / np.ptp(reward)

    if reward.shape != shape:
        raise Wrong(f"It returns the shape {reward.shape}, not (S, A, S).")
    if np.ptp(reward) < 1e-9:
        raise Wrong("It is constant.")
    if np.ptp(reward, axis=1).max() > 1e-9:
        raise Wrong("It depends on the action, and EPIC sees that.")
    if np.ptp(reward, axis=2).max() < 1e-9:
        raise Wrong("It sees s alone. Let s' take back what s has added.")
    if varies(1.0) < 1e-9:
        raise Wrong("Nearly: what comes a step later counts γ times.")
    if varies(gamma) > 1e-9:
        part = f"{varies(gamma):.0%} of its own range"
        raise Wrong(f"Its canonical form still has {part}.")


def ex_one_flag(answer: Answer) -> None:
    """Chapter 7: y = r + γ (1 - terminated) V, whatever was truncated."""
    reward, value = np.array([[1.0, 2, 3, 4], [30, 20, 10, 40]])
    ended, cut = np.array([[0.0, 1, 0, 1], [0, 0, 1, 1]])
    later = 0.9 * value
    mistakes = {
        "A time limit is no end: what is cut still has a next value.": (
            reward + (1 - np.maximum(ended, cut)) * later
        ),
        "A termination is an end: nothing follows it.": reward + later,
        "You have the flags the wrong way round.": reward
        + (1 - cut) * later,
    }
    output = answer(reward.copy(), ended, cut, value, 0.9)
    hint = "Where nothing has ended, y = r + γ V(s')."
    expect(output, reward + (1 - ended) * later, mistakes, hint)


def ex_loops(answer: Answer) -> None:
    """Chapter 7: the best logit in the absorbing state."""
    for expert, policy, copies in ((400, 20, 1), (400, 20, 100), (5, 9, 2)):
        right = np.log((policy + copies) / (expert + copies))
        mistakes = {
            "Upside down: among the expert's rows s_a is rarer.": -right,
            "The loops are rows, too: an episode has n + w of them.": (
                np.log(policy / expert)
            ),
            "Both sides store w loops an episode. What share of their "
            "rows is that?": 0.0,
        }
        hint = f"With w = {copies} an episode has {expert} + {copies} rows."
        expect(answer(expert, policy, copies), right, mistakes, hint)


# Two primitives of chapter 8: means, standard deviations and weights.
PRIMITIVES = np.array([[-1.0, 0.5], [0.4, 0.8], [0.3, 0.7]])


def ex_log_product(answer: Answer) -> None:
    """Chapter 8: the product of Gaussians, normalised by quadrature."""
    (mean, std, weight), a = PRIMITIVES, np.linspace(-6, 6, 4_001)
    each = log_normal(a[:, None], mean, std)
    total, sigma = each @ weight, 1 / (weight / std).sum()
    output = answer(a.copy(), *PRIMITIVES.copy())
    found = area(output, a)
    mistakes = {
        f"{found}: log Z is missing, and it depends on the state.": total,
        "This is the sum of the primitives.": (
            logsumexp(each, axis=1, b=weight)
        ),
        "So the released code does it. A precision is w / σ², not w / σ.": (
            log_normal(a, sigma * (weight / std * mean).sum(), sigma)
        ),
    }
    right = total - np.log(np.trapezoid(np.exp(total), a))
    hint = "Is it a Gaussian whose precision is the sum of w / σ²?"
    expect(output, right, mistakes, hint)


def ex_why_not_add(answer: Answer) -> None:
    """Chapter 8: the log density of a mixture, far out as well."""
    (mean, std, weight), a = PRIMITIVES, np.linspace(-3, 3, 7)
    each = log_normal(a[:, None], mean, std)
    right = logsumexp(each, axis=1, b=weight)
    mistakes = {
        "A mean of logarithms is the logarithm of a product.": (
            each @ weight
        ),
        "This is the density. Return its logarithm.": np.exp(right),
        "The weights are missing.": logsumexp(each, axis=1),
    }
    hint = "π(a) = Σ w π_k(a): add densities, then take the logarithm."
    expect(answer(a, *PRIMITIVES.copy()), right, mistakes, hint)
    far = answer(np.array([80.0]), *PRIMITIVES.copy())
    finite(far, "far out all densities round to 0. Use `logsumexp`.")


def ex_wilson(answer: Answer) -> None:
    """Chapter 9: the least p with pⁿ of at least 2.5 %."""
    for n in (5, 36):
        p = numbers(answer(n))
        mistakes = {
            "5 % is for both sides of an interval. On this side 2.5 % may "
            "lie outside.": 0.05 ** (1 / n),
            "With this p all arrive in 97.5 % of the cases. How small may "
            "it be?": 0.975 ** (1 / n),
            "This is the chance not to arrive.": 1 - 0.025 ** (1 / n),
        }
        share = (100 * p**n).round(1)
        hint = f"With this p all {n} arrive in {share} % of the cases."
        expect(p, 0.025 ** (1 / n), mistakes, hint)


def ex_lag(answer: Answer) -> None:
    """Chapter 10: a slow critic follows at every second update."""
    updates, r, gamma, tau = 600, -2.0, 0.9, 0.02

    def followed(steps: int, gamma: float) -> float:
        slow = 0.0
        for _ in range(steps):
            slow += tau * (r + gamma * slow - slow)
        return slow

    mistakes = {
        "Slow critics follow at every second update.": (
            followed(updates, gamma)
        ),
        "There they end. They are not there yet.": r / (1 - gamma),
        "The target is r + γ Q with the slow Q, not r alone.": (
            followed(updates // 2, 0.0)
        ),
    }
    output, right = answer(updates, r, gamma, tau), followed(300, gamma)
    hint = (
        f"After {updates} updates it is at {right:.1f}: r = {r:g}, γ = 0.9."
    )
    expect(output, right, mistakes, hint)


def ex_third_film(answer: Answer) -> None:
    """Chapter 12: how much several films hide together."""
    left, right = (tabular.maze(4, side).mdp for side in ("Left", "Right"))
    wet = tabular.maze(4, "Left", slip=0.3).mdp
    for worlds in ([left, right], [left, left, right], [wet, left, left]):
        free = tabular.separation(worlds).free
        first = tabular.separation(worlds[:2]).free
        last = tabular.separation(worlds[-2:]).free
        mistakes = {
            "Constants are hidden in every world: count them, too.": free
            - 1,
            "All films must agree, not only the first two.": first,
            "All films must agree, not only the last two.": last,
        }
        count = numbers(answer([tabular.shapings(mdp) for mdp in worlds]))
        hint = f"It says {count} for {len(worlds)} films; {free} is right."
        expect(count, free, mistakes, hint)
