"""Draw the README's moving picture, from the runs of `recipe_example`.

PYTHONPATH=book .venv/bin/python book/_static/cart.py RUNS

with `my_robot.py` in the working directory. RUNS/cart is the imitation, and
RUNS/swapped the retraining on its reward.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import plots
from offairl_lite.core.rollouts import rollout
from offairl_lite.runs import records

SIZE, SCALE, RAIL = (640, 260), 2, 3.0
INK, GROUND = "#22303c", "#ffffff"
ROWS = {
    "cart": ("copies what the expert did", plots.COPY),
    "swapped": ("learned what the expert wanted", plots.AGENT),
}


def font(size: int) -> ImageFont.FreeTypeFont:
    """Return a font that comes with Matplotlib."""
    import matplotlib

    fonts = Path(matplotlib.get_data_path(), "fonts/ttf")
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size * SCALE)


def cart(draw: ImageDraw.ImageDraw, x: float, y: int, color: str) -> None:
    """Draw a cart at position `x` of a rail at height `y`."""
    width = SCALE * SIZE[0]
    center = width / 2 + x / RAIL * 0.42 * width
    line = SCALE * 3
    ends = 0.06 * width, 0.94 * width
    draw.line((ends[0], y, ends[1], y), INK, line)
    for end in ends:
        draw.line((end, y - 14 * SCALE, end, y + 6 * SCALE), INK, line)
    draw.polygon(
        [
            (width / 2, y + 6 * SCALE),
            (width / 2 - 8 * SCALE, y + 20 * SCALE),
            (width / 2 + 8 * SCALE, y + 20 * SCALE),
        ],
        INK,
    )
    box = center - 28 * SCALE, y - 40 * SCALE, center + 28 * SCALE
    draw.rounded_rectangle((*box, y - 12 * SCALE), 6 * SCALE, color)
    for wheel in (center - 16 * SCALE, center + 16 * SCALE):
        radius = 8 * SCALE
        draw.ellipse(
            (wheel - radius, y - 2 * radius, wheel + radius, y), INK
        )


def picture(positions: dict[str, float]) -> Image.Image:
    """Return one frame, with the position of each row's cart."""
    image = Image.new("RGB", tuple(SCALE * side for side in SIZE), GROUND)
    draw = ImageDraw.Draw(image)
    for row, (name, (text, color)) in enumerate(ROWS.items()):
        top = row * SIZE[1] // 2
        place = SIZE[0] // 2 * SCALE, (top + 12) * SCALE
        draw.text(place, text, INK, font(16), anchor="mt")
        cart(draw, positions[name], (top + 92) * SCALE, color)
    return image.resize(SIZE, Image.Resampling.LANCZOS)


def main(runs: Path) -> None:
    """Roll the policies out on the swapped cart, and write the film."""
    paths = {}
    for name in ROWS:
        policy = records.read(runs / name).policy.member(0)
        obs = rollout(policy, "my_robot:SwappedCart-v0", (3,), 4).obs[0]
        paths[name] = obs[:, :, 0]
    # The retrained cart must come from afar, or there is nothing to see.
    far = np.abs(paths["swapped"][:, 0]).argsort()[::-1][:2]
    frames = [
        picture({name: path[episode, t] for name, path in paths.items()})
        for episode in far
        for t in range(paths["cart"].shape[1])
    ]
    frames = [f.quantize(32, dither=Image.Dither.NONE) for f in frames]
    place = Path(__file__).with_suffix(".gif")
    frames[0].save(
        place, save_all=True, append_images=frames[1:], duration=60, loop=0
    )
    print(place, f"{place.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    sys.path.append(str(Path.cwd()))
    main(Path(sys.argv[1]))
