"""Off-policy adversarial inverse reinforcement learning, small and fast."""

from offairl_lite import envs  # noqa: F401  (registers the tasks with Gymnasium)
