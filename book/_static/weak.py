"""Draw two ants with weak legs, trained on two learned rewards.

Each is the median of five seeds, as recorded after 50,000 steps.

.venv/bin/python book/_static/weak.py
"""

import compared

RANKS = {
    "decides-transfer-demo/velocity/scratch": 2,
    "decides-transfer-demo/state/scratch": 2,
}

compared.draw("weak", RANKS, lead=1.3, away=4.4)
