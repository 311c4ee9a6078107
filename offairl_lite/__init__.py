"""Off-policy adversarial inverse reinforcement learning, small and fast."""

# The tasks are registered with Gymnasium, and the ablations with the settings.
from offairl_lite import ablations, envs  # noqa: F401
