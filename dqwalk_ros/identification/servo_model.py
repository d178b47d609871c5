"""One servo as the fit has it: a spring behind a delay and the play of gears, with damping and friction."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.compiled import jit

__all__ = ["simulate"]


@jit
def simulate(time, measured, tau, inertia, sent, goals, x, limit, step):  # type: ignore[no-untyped-def]
    """Return the angles (m,) of the model at `time`, from rest at the first one that was measured.

    `sent` and `goals` (k,) are when which goal was sent; `x` is T, K, D, b, f, the rotor, the zero of the goals, and
    how soft friction is: it is all there where v + lead v' is beyond creep, and less in proportion below. Dry friction
    has neither; that of a physics engine has both.
    """
    delay, K, D, b, f, rotor, zero, creep, lead = x
    out = np.empty(time.shape[0])
    q, v = measured[0], 0.0
    out[0] = q
    last = sent.shape[0] - 1
    at = 0
    while at < last and sent[at + 1] + delay <= time[0]:
        at += 1
    for k in range(time.shape[0] - 1):
        count = max(1, round((time[k + 1] - time[k]) / step))
        h = (time[k + 1] - time[k]) / count
        M = 0.5 * (inertia[k] + inertia[k + 1]) + rotor
        for i in range(count):
            now = time[k] + i * h
            goal = goals[at]
            while at < last and sent[at + 1] + delay < now + h:  # it changes within this step
                part = min(max((sent[at + 1] + delay - now) / h, 0.0), 1.0)
                goal = part * goal + (1.0 - part) * goals[at + 1]
                at += 1
            load = tau[k] + (i + 0.5) / count * (tau[k + 1] - tau[k])
            e = goal + zero - q
            e = e - min(max(e, -0.5 * b), 0.5 * b)
            drive = min(max(K * e, -limit), limit)
            free = (M * v + h * (drive - load)) / (M + h * D)
            brake = h * f / (M + h * D)
            soft, ahead = brake / creep, lead / h
            slow = (free + soft * ahead * v) / (1.0 + soft * (1.0 + ahead))
            slips = slow + ahead * (slow - v)
            if slips > creep:
                v = free - brake
            elif slips < -creep:
                v = free + brake
            else:
                v = slow
            q += h * v
        out[k + 1] = q
    return out
