"""One thing has one colour, in the figures and in the toys."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import plots

SOURCE = (Path(plots.__file__).parent / "_static/toys/toys.js").read_text("utf-8")
ROLES = {
    "EXPERT": "expert",
    "COPY": "copy",
    "AGENT": "learner",
    "REWARD": "good",
    "STAR": "star",
    "INK": "ink",
}


def palette(page: str) -> dict[str, list[str]]:
    """Return the colours of the toys on a light or a dark page, by name."""
    (body,) = re.findall(rf"const {page} = {{(.*?)\n  }};", SOURCE, re.DOTALL)
    named = re.findall(r'(\w+): (\[[^\]]*\]|"[^"]*")', body)
    return {name: re.findall("#[0-9a-f]{6}", value) for name, value in named}


@pytest.mark.parametrize("role", ROLES)
def test_a_role_has_one_colour_in_figures_and_toys(role):
    assert [getattr(plots, role)] == palette("LIGHT")[ROLES[role]]


def test_maps_of_rewards_have_the_colours_of_the_toys():
    ramp = palette("DARK")["reward"]
    drawn = plots.REWARD_MAP(np.linspace(0, 1, len(ramp)))[:, :3]
    np.testing.assert_allclose(drawn, [to_rgb(colour) for colour in ramp], atol=0.01)


def test_bright_is_a_high_reward_without_colours():
    shades = plots.REWARD_MAP(np.linspace(0, 1, 32))[:, :3] @ [0.21, 0.72, 0.07]
    assert (np.diff(shades) > 0).all()


# What is seen with no red, and with no green, cones (Machado et al. 2009), in linear light.
BLIND = {
    "no red": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "no green": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
}
XYZ = [[0.412, 0.358, 0.180], [0.213, 0.715, 0.072], [0.019, 0.119, 0.950]]


@pytest.mark.parametrize("page", ["LIGHT", "DARK"])
@pytest.mark.parametrize("eyes", BLIND)
def test_roles_differ_for_the_colour_blind(page, eyes):
    """A distance in CIELAB of 10 is seen at a glance."""
    colours = palette(page)
    seen = []
    for role in ("expert", "copy", "learner", "good"):
        rgb = np.array(to_rgb(colours[role][0]))
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        xyz = XYZ @ np.clip(BLIND[eyes] @ linear, 0, 1) / np.sum(XYZ, 1)
        x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
        seen.append((116 * y - 16, 500 * (x - y), 200 * (y - z)))
    far = np.linalg.norm(np.array(seen)[:, None] - np.array(seen), axis=-1)
    assert far[np.triu_indices(4, 1)].min() > 30
