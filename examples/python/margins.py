"""Repeats the disk margins of `lab margins --json` with python-control.

  python3 margins.py margins.json

The JSON holds the measured loop gain L(jw) of every operating point. A transfer function is fitted to each, from which
python-control computes the disk margin; it must agree with the trainer's.
"""
import json, sys

import control
import numpy as np

ORDER, ROUNDS = 6, 20  # of the fitted function: its dead time is part of it
TOLERANCE = 0.05, 0.01  # share of the margin, and absolute: noise matters near -1


def fitted(hz, loop):
    """The rational function of this order closest to the loop gain, by least squares (Sanathanan and Koerner 1963)."""
    scale = 2 * np.pi * np.sqrt(hz[0] * hz[-1])  # keeps the powers of s near one
    powers = np.vander(1j * 2 * np.pi * hz / scale, ORDER + 1)
    weight = 1 / np.abs(1 + loop)  # near -1 counts most
    for _ in range(ROUNDS):
        # numerator - loop * (denominator without its leading one) = loop * s^ORDER
        rows = np.hstack([powers, -loop[:, None] * powers[:, 1:]]) * weight[:, None]
        target = loop * powers[:, 0] * weight
        solution = np.linalg.lstsq(
            np.vstack([rows.real, rows.imag]), np.hstack([target.real, target.imag]), rcond=None
        )[0]
        numerator, denominator = solution[: ORDER + 1], np.hstack([1, solution[ORDER + 1 :]])
        weight = 1 / np.abs(1 + loop) / np.abs(powers @ denominator)
    unscale = scale ** np.arange(-ORDER, 1.0)
    return control.tf(numerator * unscale, denominator * unscale)


measured = json.load(open(sys.argv[1]))
worst = 0.0
for plant in measured["plants"]:
    for point in plant["points"]:
        if point["margins"] is None:
            continue  # it oscillates by itself
        hz = np.array([at["hz"] for at in point["response"]])
        loop = np.array([complex(*at["loop"]) for at in point["response"]])
        grid = 2 * np.pi * np.geomspace(hz[0], hz[-1], 2000)
        disk, gain_db, phase_deg = control.disk_margins(fitted(hz, loop), grid, skew=0.0)
        own = point["margins"]["disk_margin"]
        worst = max(worst, abs(disk - own) / (TOLERANCE[0] * own + TOLERANCE[1]))
        print(
            f"{plant['plant']}, PIP {point['pip']:g}: disk margin {disk:.3f} by python-control, {own:.3f} by the trainer;"
            f" gain {10 ** (gain_db / 20):.2f}, phase {phase_deg:.1f} degrees at once"
        )
assert worst < 1, f"a margin differs by {worst:.1f} times the tolerance"
print(f"largest difference: {100 * worst:.0f} % of the tolerance")
