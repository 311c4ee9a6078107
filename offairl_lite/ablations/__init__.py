"""What exists for one experiment of the book only.

Other bounds on the discriminator, and what the paper's released code does. Each has settings of its
own, by whose type it is chosen.
"""

from offairl_lite.ablations import bottleneck, penalties, released, state_pairs  # noqa: F401
