"""Simulation of one servo for the fit: a spring with damping and friction, after a delay and the backlash of gears."""

from __future__ import annotations

import numpy as np

from dqwalk_ros.compiled import jit

__all__ = ["simulate"]


@jit
def simulate(time, measured, tau, inertia, sent, goals, x, limit, step):  # type: ignore[no-untyped-def]
    """Return the angles of the model, starting at rest at the first measured angle.

    Friction has its full value if abs(v + lead v') > creep, and is proportional to v + lead v' below. For ideal dry
    friction creep and lead are zero; in a physics engine both are positive.

    Parameters
    ----------
    time : ndarray, shape (m,)
        [s]
    measured : ndarray, shape (m,)
        Measured angles, of which only the first is used [rad].
    tau : ndarray, shape (m,)
        Load torque [N m].
    inertia : ndarray, shape (m,)
        Inertia about the joint without the rotor [kg m^2].
    sent, goals : ndarray, shape (k,)
        Times at which the goals were sent [s], and goals [rad].
    x : ndarray, shape (9,)
        T [s], K [N m/rad], D [N m s/rad], b [rad], f [N m] (see `fit`), inertia of the rotor [kg m^2], zero of the
        goals [rad], creep [rad/s] and lead [s].
    limit : float
        Largest torque [N m].
    step : float
        Largest integration step [s].

    Returns
    -------
    ndarray, shape (m,)
        Angles [rad].
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
            while at < last and sent[at + 1] + delay < now + h:  # the goal changes within this step
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
