"""Frames of a MuJoCo simulation, cast by rays on the CPU: always the same bytes."""

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

# Each pixel is the mean of 2x2 samples, and each of the four has a lamp of its own: the average of
# four hard shadows is a soft shadow at the cost of one. Lamps are given as directions in the scene.
_SAMPLES = 2
_FIELD_OF_VIEW = 40.0  # Vertical, in degrees.
_LAMPS = np.array([[-0.55, -0.5, 1], [-0.43, -0.5, 1], [-0.49, -0.56, 1], [-0.49, -0.44, 1]])
_LAMPS /= np.linalg.norm(_LAMPS, axis=1, keepdims=True)

_ZENITH = np.array([0.36, 0.56, 0.85])
_HORIZON = np.array([0.84, 0.90, 0.96])
_TILES = np.array([[0.56, 0.62, 0.70], [0.69, 0.75, 0.82]])


class Camera(NamedTuple):
    """The camera of a frame; lengths in metres, angles in degrees."""

    lookat: tuple[float, float, float]  #: The point (x, y, z) in the middle of the frame.
    distance: float  #: From the eye to `lookat`.
    azimuth: float = 90.0  #: Direction of view in the ground plane; 90 looks along +y.
    elevation: float = -15.0  #: Angle of view above the ground plane; negative looks down.
    body: int = 0  #: The body with which `lookat` moves along x and y; 0, the world, does not move.
    tiles: bool = True
    """Whether planes are a checker board, which shows motion, instead of in their own colour."""


def render(
    model: mujoco.MjModel, data: mujoco.MjData, width: int, height: int, camera: Camera
) -> np.ndarray:
    """Return one frame, `(height, width, 3)` uint8; the kinematics of `data` must be current."""
    centre = np.array(camera.lookat)
    centre[:2] += data.xpos[camera.body, :2]
    eye = centre - camera.distance * _axes(camera)[0]
    lamps = centre + 50 * _LAMPS
    # The colour of each geom, or of its material if it has none itself.
    rgba = model.geom_rgba.copy()
    grey = np.array([0.5, 0.5, 0.5, 1], np.float32)  # MuJoCo's own.
    unpainted = (model.geom_matid >= 0) & (rgba == grey).all(axis=1)
    rgba[unpainted] = model.mat_rgba[model.geom_matid[unpainted]]
    palette = np.concatenate([rgba[:, :3], _TILES])
    floor = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & camera.tiles
    total = np.zeros((height * width, 3))
    for lamp, directions in zip(lamps, _rays(width, height, camera), strict=True):
        total += _trace(model, data, eye, lamp, directions, palette, floor)
    return np.rint(total * (255 / _SAMPLES**2)).astype(np.uint8).reshape(height, width, 3)


def _trace(model, data, eye, lamp, directions, palette, floor) -> np.ndarray:
    """Return the colours, (rays, 3) from 0 to 1, that rays from an eye meet in a lamp's light."""
    geom, distance, normal = _cast(model, data, eye, directions)
    point = eye + distance[:, None] * directions
    # MuJoCo casts many rays from one origin only, so they go from the lamp to the points.
    from_lamp = point - lamp
    length = np.sqrt(np.einsum("ij,ij->i", from_lamp, from_lamp))
    from_lamp /= length[:, None]
    _, obstacle, _ = _cast(model, data, lamp, from_lamp)
    # The tolerance keeps a point from casting a shadow on itself.
    lit = (obstacle < 0) | (obstacle > length - 1e-4)
    direct = lit * np.maximum(0, -np.einsum("ij,ij->i", normal, from_lamp))
    # Skylight: surfaces that face up see the sky, surfaces that face down the darker ground.
    light = 0.31 + 0.12 * normal[:, 2] + 0.65 * direct
    # The tiles are the palette's last two colours. Haze hides where they become finer than pixels.
    on_floor = floor[geom] & (geom >= 0)
    odd = np.floor(point[:, 0]).astype(int) + np.floor(point[:, 1]).astype(int) & 1
    opacity = np.where(on_floor, np.clip((33 - distance) / 25, 0, 1), geom >= 0)
    colour = np.take(palette, np.where(on_floor, odd - 2, geom), axis=0, mode="wrap")
    colour *= light[:, None]
    sky = _HORIZON + np.maximum(directions[:, 2:], 0) * (_ZENITH - _HORIZON)
    colour -= sky
    colour *= opacity[:, None]
    colour += sky
    return np.clip(colour, 0, 1, out=colour)


def _cast(model, data, origin, directions):
    """Return geom, distance and outward normal where rays from one origin end; -1 for no geom."""
    count = len(directions)
    geom, distance = np.empty(count, np.int32), np.empty(count)
    normal = np.empty(3 * count)
    mujoco.mj_multiRay(
        model, data, origin, directions.ravel(), None, 1, -1, geom, distance, normal, count, 1e6
    )
    return geom, distance, normal.reshape(-1, 3)


def _axes(camera: Camera) -> np.ndarray:
    """Return the camera's unit vectors forward, right and up, (3, 3)."""
    azimuth, elevation = np.deg2rad([camera.azimuth, camera.elevation])
    horizontal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    forward = np.cos(elevation) * horizontal + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([horizontal[1], -horizontal[0], 0.0])
    return np.stack([forward, right, np.cross(right, forward)])


@lru_cache(maxsize=8)
def _rays(width: int, height: int, camera: Camera) -> np.ndarray:
    """Return unit vectors from the eye through the samples of every pixel, (4, pixels, 3)."""
    forward, right, up = _axes(camera)
    half = np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2)
    rows, columns = _SAMPLES * height, _SAMPLES * width
    y = half * (1 - (2 * np.arange(rows) + 1) / rows)
    x = half * width / height * ((2 * np.arange(columns) + 1) / columns - 1)
    rays = forward + y[:, None, None] * up + x[:, None] * right
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = rays.reshape(height, _SAMPLES, width, _SAMPLES, 3).transpose(1, 3, 0, 2, 4)
    return rays.reshape(_SAMPLES**2, height * width, 3)
