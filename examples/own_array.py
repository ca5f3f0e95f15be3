"""Poses from a lab's own array: nine sensors at places of its own. A simulated tank plays the lab's recording."""

import numpy as np

import smolbot
from sim import TankWorld

places = 0.03 * np.array([[x, y, 0.0] for x in (-1, 0, 1) for y in (-1, 0, 1)])  # m, in the plane below the tank
axes = np.tile(np.eye(3), (3, 1))
own = {"sensors.positions_mm": str((1e3 * places).tolist()), "sensors.axes": str(axes.tolist())}
robot = smolbot.load_robot("gradient")
shot = smolbot.Shot((smolbot.Excite((5.0, 5.0), 103.5, 5), smolbot.RingDown(0.02), smolbot.Listen(20, 103.5)))
with TankWorld.open(smolbot.load_rig("tank", own), robot, (0.004, -0.006), seed=3) as lab:
    heard = lab.play(shot)
pose = smolbot.Localizer(smolbot.SensorArray(places, axes), robot.device).locate(heard)
print("trusted" if pose.trusted else "not trusted", (1e3 * pose.position).round(2), "mm")
