"""State-only DAC, and what the paper's released code does, each with settings of its own."""

from offairl_lite.ablations import released, state_pairs  # noqa: F401
