"""Draw two walkers whose episodes are equally long, one of them slow.

They are the recipe's median and DAC's lowest of five seeds, as recorded
after 500,000 steps.

.venv/bin/python book/_static/slow.py
"""

import compared

RANKS = {
    "locomotion-demo/Walker2d-airl": 2,
    "locomotion-demo/Walker2d-dac": 0,
}

compared.draw("slow", RANKS, lead=1.3, away=4.0)
