"""Setpoints of sines one after another, written down by hand."""

import math

import numpy as np

STEP = 1 / 100  # s


def schedule(plan, pause=2.0, lead=5.0, amplitude=3.0, step=STEP):
    """Return time and setpoint: one frequency after another, each from rest and back to it."""
    plan = [
        (omega, math.ceil(least * omega / (2 * math.pi)) * 2 * math.pi / omega)
        for omega, least in plan
    ]
    t, now = np.arange(0, lead + sum(duration + pause for _, duration in plan) + 3, step), lead
    r, starts = np.zeros(t.size), []
    for omega, duration in plan:
        inside = (t >= now) & (t < now + duration)
        r[inside] = amplitude * np.sin(omega * (t[inside] - now))
        starts.append((now, now + duration))
        now += duration + pause
    return t, r, starts
