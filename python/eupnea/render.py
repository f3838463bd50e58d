"""Pictures of an inspiration, drawn with numpy alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HEIGHT, WIDTH = 240, 480
#: Highest pressure in the upper part of a picture, cmH2O.
PRESSURE_MAX = 45.0
#: Rows of the upper part, which shows pressures; the lower part shows the command.
UPPER = 160
#: Shortest time axis, ticks.
TICKS = 1000

WHITE, GREY, LIGHT = (255, 255, 255), (150, 150, 150), (225, 225, 225)
BLUE, ORANGE = (31, 119, 180), (230, 120, 20)

Curve = NDArray[np.float64]
Picture = NDArray[np.uint8]


def picture(pressure: Curve, target: Curve, command: Curve) -> Picture:
    """Draw the curves of an inspiration.

    Args:
        pressure: True airway pressure of each tick, cmH2O.
        target: Target, cmH2O.
        command: Command of the inspiratory valve, percent.

    Returns:
        An array of shape (240, 480, 3).
    """
    image: Picture = np.full((HEIGHT, WIDTH, 3), WHITE, np.uint8)
    for level in (10, 20, 30, 40):
        image[_rows(np.array([level / PRESSURE_MAX]), 0, UPPER)] = LIGHT
    image[UPPER] = GREY
    _draw(image, target / PRESSURE_MAX, 0, UPPER, GREY)
    _draw(image, pressure / PRESSURE_MAX, 0, UPPER, BLUE)
    _draw(image, command / 100.0, UPPER, HEIGHT, ORANGE)
    return image


def _rows(shares: Curve, top: int, bottom: int) -> NDArray[np.int64]:
    rows = bottom - 2 - shares * (bottom - top - 4)
    return np.clip(rows, top + 1, bottom - 1).astype(np.int64)


def _draw(image: Picture, shares: Curve, top: int, bottom: int, colour: tuple[int, int, int]) -> None:
    if len(shares) == 0:
        return
    ticks = max(TICKS, len(shares))
    columns = np.arange(len(shares)) * (WIDTH - 1) // ticks
    rows = _rows(shares, top, bottom)
    before = np.concatenate([rows[:1], rows[:-1]])
    for column, start, end in zip(columns, np.minimum(before, rows), np.maximum(before, rows), strict=True):
        image[start : end + 1, column] = colour
