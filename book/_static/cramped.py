"""Draw two ants, imitators that are paid by two forms of a learned reward.

Each is the median of three seeds, as recorded: above, Implementation 4 with
the density of the replay and a centred reward, after 100,000 steps; below,
Implementation 1 after 50,000.

.venv/bin/python book/_static/cramped.py
"""

import compared

RANKS = {
    "ant-rewards-centred-demo/implementation-4-mixture": 1,
    "ant-rewards-demo/implementation-1": 1,
}

compared.draw("cramped", RANKS, lead=1.2, away=5.5, steps=(400, 420, 440))
