"""What chapter 4 says."""

import math

import numpy as np
import torch
from torch.nn.functional import softplus

from checks import exact, live, recorded
from offairl_lite import experiments, tabular
from offairl_lite.plain import descend, log_density
from offairl_lite.runs import records


@exact
def improvement_improves_everywhere(values):
    """Each improvement raises the soft value, the first in every state."""
    assert (np.diff(values, axis=0) > -1e-9).all()
    assert (values[1] > values[0]).all()


@exact
def soft_policy_iteration_converges(iterates, optimum, gain):
    """The first improvement brings more than 90 % of the gain, and after
    five the value is right to nine decimals."""
    assert gain[1] > 0.9 * gain[-1]
    assert np.abs(iterates[5].value - optimum.value).max() < 1e-9
    assert np.allclose(iterates[-1].policy, optimum.policy)


@exact
def entropy_earns_at_most_its_bound(grid, solutions, num_moves):
    """A soft value exceeds the ordinary one by at most what entropy can
    earn, and at a low temperature the ordinary optimum returns."""
    greedy = tabular.soft_value_iteration(grid.mdp, grid.reward, 0.0)
    for alpha, soft in solutions.items():
        gap = soft.value - greedy.value
        bound = alpha * math.log(num_moves) / (1 - grid.mdp.discount)
        assert (gap > -1e-9).all()
        assert (gap <= bound).all()
    best, earned = (
        tabular.policy_return(grid.mdp, policy, grid.reward)
        for policy in (greedy.policy, solutions[0.003].policy)
    )
    assert earned > best - 0.01


@exact
def temperature_and_reward_are_one_knob(grid, solutions):
    """If reward and temperature are multiplied by the same factor, the
    policy stays the same."""
    for factor in (100, 0.01):
        other = tabular.soft_value_iteration(
            grid.mdp, factor * grid.reward, factor * 1.0
        )
        assert np.allclose(other.policy, solutions[1.0].policy)
        assert np.allclose(other.value, factor * solutions[1.0].value)


@exact
def the_density_is_that_of_the_actions(density_of, a, normal, CASES):
    """The density with its Jacobian sums to one, and predicts how often
    actions fall into an interval."""
    for mean, std in CASES:
        x, density = torch.tanh(mean + std * normal), density_of(mean, std)
        assert abs(torch.trapezoid(density, a) - 1) < 1e-3
        for low, high in ((-1, -0.9), (-0.9, 0), (0, 0.9), (0.9, 1)):
            counted = ((low < x) & (x < high)).double().mean()
            inside = (low < a) & (a < high)
            predicted = torch.trapezoid(density[inside], a[inside])
            assert abs(counted - predicted) < 0.006  # 5 standard errors


@exact
def the_median_is_not_the_peak(density_of, a):
    """For μ = σ = 0.8 the action without noise is 0.66, and the density
    has its peak at 0.97."""
    assert round(a[density_of(0.8, 0.8).argmax()].item(), 2) == 0.97
    assert round(math.tanh(0.8), 2) == 0.66


@exact
def the_slope_has_a_logarithm_for_every_u():
    """In single precision 1 − tanh² u becomes 0, but the density remains
    finite."""
    assert 1 - torch.tanh(torch.tensor(9.5)) ** 2 == 0
    assert log_density(*torch.tensor([[20.0], [0.4], [-0.5]])).isfinite()


@exact
def a_narrow_gaussian_has_negative_entropy():
    """A Gaussian has negative entropy if σ < 0.24, −1 if σ is 0.09."""
    assert round(1 / math.sqrt(2 * math.pi * math.e), 2) == 0.24
    std = math.exp(-1) / math.sqrt(2 * math.pi * math.e)
    assert round(std, 2) == 0.09
    gaussian = torch.distributions.Normal(0.0, std)
    assert math.isclose(gaussian.entropy().item(), -1, abs_tol=1e-5)


@exact
def the_gradient_through_q_is_less_noisy(density_of, a, normal):
    """The score function's derivative has three times the standard
    deviation of the one that flows through Q."""

    def value(action):
        return -((action - 0.5) ** 2)

    def expected(mean):
        return torch.trapezoid(density_of(mean, 0.5) * value(a), a)

    slope = ((expected(1e-4) - expected(-1e-4)) / 2e-4).item()
    u = 0.5 * normal
    x = torch.tanh(u)
    through = -2 * (x - 0.5) * (1 - x**2)  # dQ/da da/dμ
    score = value(x) * u / 0.5**2  # Q d log π/dμ
    for estimate in (through, score):
        error = estimate.std().item() / math.sqrt(len(u))
        assert abs(estimate.mean().item() - slope) < 5 * error
    assert 2.9 < score.std() / through.std() < 3.1


@live
def your_sac_learns(history):
    """Your SAC learns to swing up the pendulum."""
    step, total, _, _ = np.array(history).T
    assert np.median(total[:5]) < -800  # random actions
    assert np.median(total[step > 3_900]) > -500


@live
def the_temperature_steers_the_entropy(history):
    """The entropy falls to its target, and the temperature falls
    meanwhile."""
    *_, entropy, temperature = np.array(history).T
    assert -2 < entropy[-5:].mean() < 0
    assert temperature.min() < 0.17


@live
def it_stands(states):
    """The policy without noise swings the pendulum up from hanging still,
    and holds it there."""
    assert np.median(np.cos(states[-20:, 0])) > 0.8


@live
def the_ridge_runs_along_the_line_of_energy(x, y, worth, enough):
    """Near the top the ridge of high value runs along the line of just
    enough energy."""
    off = []
    for angle in (-150, -120):
        column = np.abs(x[0] - angle).argmin()
        ridge = y[:60, 0][worth[:60, column].argmax()]
        off.append(abs(ridge + enough[column]))
    assert np.mean(off) < 1.5


@recorded
def slow_copies_decide(curves):
    """SAC and TD3 learn the pendulum in all five seeds; with τ = 1 none
    does, and none of its last ten episodes returns more than −750."""
    last = {name: totals[:, -10:] for name, totals in curves.items()}
    assert {len(totals) for totals in last.values()} == {5}
    for name in ("SAC", "TD3"):
        assert np.median(last[name], 1).min() > -250
    assert last["SAC, τ = 1"].max() < -750


@recorded
def experts_by_the_papers_choice(trained_by, PAPER, RECORDS):
    """Each expert was trained with the temperature, fixed or learned, that
    the paper found best for its task."""
    for task, folder in trained_by.items():
        fixed = records.read(RECORDS / folder).config.learner.temperature
        assert (fixed is None) == (PAPER[task][1] == "learned")


@recorded
def experts_are_nearly_as_good_as_the_papers(shipped, PAPER):
    """On every robot the best expert returns more than 85 % of the paper's
    mean, and on the mazes all are above it."""
    for task, noted in shipped.items():
        if task.startswith("Point"):
            assert min(noted["returns"]) > PAPER[task][0]
        else:
            assert max(noted["returns"]) > 0.85 * PAPER[task][0]


@recorded
def sampling_costs_most_on_hopper(shipped):
    """Demonstrations return less than the experts without noise; sampling
    costs most on Hopper, whose first expert returns 3,063 without noise
    and 2,026 with it."""
    for noted in shipped.values():
        assert noted["demonstrated"][-1] < max(noted["returns"])
    less = {
        task: 1 - noted["demonstrated"][0] / noted["returns"][0]
        for task, noted in shipped.items()
        if not task.startswith("Point")
    }
    assert 0.32 < less.pop("Hopper") < 0.35
    assert max(less.values()) < 0.12
    assert round(shipped["Hopper"]["returns"][0]) == 3063
    assert round(shipped["Hopper"]["demonstrated"][0]) == 2026
    assert experiments.find("what-decides").experts["demo"] == 1


@exact
def without_the_jacobian_noise_has_no_end():
    """The most random action has a σ of about 0.9. Without the Jacobian σ
    goes to its bound, 7.4, and more than 80 % of the actions lie beyond
    ±0.9."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    nodes, weights = torch.tensor(nodes), torch.tensor(weights)
    weights = weights / weights.sum()

    def entropy_of(log_std, jacobian):
        u = log_std.exp() * nodes
        gaussian = 0.5 + log_std + 0.5 * math.log(2 * math.pi)
        slope = 2 * (math.log(2) - u - softplus(-2 * u))
        return gaussian + jacobian * (weights * slope).sum()

    best = {}
    for jacobian in (1, 0):
        raw = torch.zeros((), dtype=torch.float64, requires_grad=True)
        optimizer = torch.optim.Adam([raw], lr=0.05)
        for _ in range(300):
            log_std = -5 + 3.5 * (torch.tanh(raw) + 1)
            descend(-entropy_of(log_std, jacobian), optimizer)
        best[jacobian] = log_std.exp().item()
    assert 0.85 < best[1] < 0.9
    assert 7 < best[0] < 7.5
    beyond = math.erfc(math.atanh(0.9) / 7 / math.sqrt(2))
    assert 0.83 < beyond < 0.85


@exact
def a_wide_range_moves_the_target():
    """At log σ = −20 the log-density reaches 19 for each motor, which for
    eight motors and α = 0.2 moves the target by 30."""
    at_the_peak = 20 - 0.5 * math.log(2 * math.pi)
    assert 19 < at_the_peak < 19.2
    assert 30 < 8 * 0.2 * at_the_peak < 31


@exact
def another_scale_of_the_reward(grid):
    """At α = 0.03 the policy is nearly the best; with the reward divided
    by 100 it loses more than 5."""
    greedy = tabular.soft_value_iteration(grid.mdp, grid.reward, 0.0)
    best = tabular.policy_return(grid.mdp, greedy.policy, grid.reward)
    lost = {}
    for factor in (1, 0.01):
        soft = tabular.soft_value_iteration(
            grid.mdp, factor * grid.reward, 0.03
        )
        lost[factor] = best - tabular.policy_return(
            grid.mdp, soft.policy, grid.reward
        )
    assert lost[1] < 0.2
    assert lost[0.01] > 5


@recorded
def how_the_experts_of_the_maze_train(RECORDS):
    """The experts of the maze train on 100 times the reward, with a target
    of −1 for the entropy of both components together."""
    for side in ("left", "right"):
        learner = records.read(
            RECORDS / f"maze-expert-{side}-demo"
        ).config.learner
        assert learner.reward_scale == 100
        assert learner.target_entropy == -1


@exact
def the_broadcast_learns_the_mean(target, estimate):
    """With the silent broadcast the critic learns the mean of the batch."""
    mean = target.mean().expand(64, 1)
    assert torch.allclose(estimate, mean, atol=1e-4)


@exact
def where_the_printed_gradient_rests(rests):
    """Descent along the printed gradient rests at about half of one
    reward, and with Q − y at 100."""
    assert math.isclose(rests["as printed"], 1 / 1.99, rel_tol=1e-3)
    assert math.isclose(rests["Q - y"], 100, rel_tol=1e-3)


@exact
def the_smaller_of_two(expected):
    """An actor expects 1.54 of ten worthless actions with one critic, and
    0.67 with the smaller of two, whose mean is −0.56."""
    one, two, mean = expected
    assert 1.52 < one < 1.56
    assert 0.66 < two < 0.69
    assert abs(mean + 1 / math.sqrt(math.pi)) < 0.005
