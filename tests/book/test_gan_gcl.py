"""GAN-GCL, the program of the note on whole trajectories: its mathematics and its training."""

import inspect
from pathlib import Path

import nbformat
import torch

import gan_gcl
from gan_gcl import GANGCL, Batch, gan_gcl_loss, trajectory_logit
from offairl_lite import envs, plain
from offairl_lite.plain import log_pi

E, T, OBS, ACT = 2, 3, 3, 2
NOTE = Path(gan_gcl.__file__).parent / "notes/whole_trajectories.ipynb"


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def episodes(rng, count=E, steps=T):
    obs, u, next_obs = (torch.randn(count, steps, n, generator=rng) for n in (OBS, ACT, OBS))
    return Batch(obs, u, next_obs, torch.zeros(count, steps), torch.zeros(count, steps))


def made(seed=0):
    rng = generator(seed)
    model = GANGCL(OBS, ACT, rng)
    return model, episodes(rng), episodes(rng), torch.rand(E, T, 1, generator=rng)


def test_the_note_defines_the_logit_and_the_loss_in_the_same_words():
    cells = [cell.source for cell in nbformat.read(NOTE, as_version=4).cells]
    for function in (trajectory_logit, gan_gcl_loss):
        assert inspect.getsource(function).strip() in cells


def test_the_loss_is_that_of_the_density_of_whole_episodes():
    """D(τ) = exp Σ r / (exp Σ r + Π π); ‖∇r‖ is taken by s and a, where `mix` says."""
    model, expert, policy, mix = made()
    logs = [log_pi(model.actor, side) for side in (expert, policy)]
    f = [model.r(x.obs, x.pre_tanh.tanh()).sum(1).exp() for x in (expert, policy)]
    d_expert, d_policy = (w / (w + log.exp().prod(1)) for w, log in zip(f, logs, strict=True))
    expected = -d_expert.log().mean() - (1 - d_policy).log().mean()
    obs = mix * expert.obs + (1 - mix) * policy.obs
    action = mix * expert.pre_tanh.tanh() + (1 - mix) * policy.pre_tanh.tanh()
    at = obs.requires_grad_(), action.requires_grad_()
    by = torch.autograd.grad(model.r(*at).sum(), at)
    penalty = (torch.cat(by, -1).norm(dim=-1) - 1).square().mean()
    actual = gan_gcl_loss(model.r, expert, policy, logs, mix)
    torch.testing.assert_close(actual, expected + 10 * penalty)


def test_each_step_is_paid_its_term_of_the_log_odds():
    model, expert, *_ = made()
    log_prob = log_pi(model.actor, expert)
    r = model.r(expert.obs, expert.pre_tanh.tanh())
    paid = model.log_odds(expert)
    torch.testing.assert_close(paid, (r - log_prob).detach())
    torch.testing.assert_close(paid.sum(1), trajectory_logit(r, log_prob).detach())


def test_the_loss_has_the_gradient_of_finite_differences():
    torch.set_default_dtype(torch.float64)
    try:
        model, expert, policy, mix = made()
        logs = [log_pi(model.actor, side) for side in (expert, policy)]
        bias, weight = model.reward[-1].bias, model.reward[-1].weight

        def loss(b, w):
            def r(obs, action):
                hidden = model.reward[:-1](torch.cat([obs, action], -1))
                return torch.nn.functional.linear(hidden, w, b).squeeze(-1)

            return gan_gcl_loss(r, expert, policy, logs, mix)

        assert torch.autograd.gradcheck(loss, (bias, weight))
    finally:
        torch.set_default_dtype(torch.float32)


def test_a_short_run_learns_to_tell_the_sides_apart():
    rng = generator()
    task = envs.make("offairl/PointMazeLeft-v0", 3, range(3))
    still = Batch(*(x[:2] for x in episodes(rng, 2, 100)))
    *_, (model, expert, block) = gan_gcl.train(task, still, rng, 2)
    task.close()
    assert block.obs.shape == (3, 100, OBS)
    expert_logit, policy_logit = (model.log_odds(x).sum(1) for x in (expert, block))
    assert plain.cross_entropy(expert_logit, policy_logit) < 0.5
    assert (expert_logit > 0).all()


def test_the_policy_is_trained_towards_what_it_is_paid_for():
    model, block, *_ = made()
    rng = generator(1)
    block = episodes(rng, 8, 20)
    # Actions are as good as they point along the first axis, whatever the density is.
    model.log_odds = lambda batch: batch.pre_tanh.tanh()[..., 0]
    before = model.actor(block.obs)[0][..., 0].mean()
    gan_gcl.update_policy(model, block, rng)
    assert model.actor(block.obs)[0][..., 0].mean() > before + 0.05
