"""Poses from a lab's own array: nine sensors at places of its own. A simulated tank plays the lab's recording."""

import numpy as np

import smolbot
from sim import TankWorld

places, axes = 0.03 * np.array([[x, y, 0.0] for x in (-1, 0, 1) for y in (-1, 0, 1)]), np.tile(np.eye(3), (3, 1))  # m
own = {"sensors.positions_mm": str((1e3 * places).tolist()), "sensors.axes": str(axes.tolist())}
rig, robot = smolbot.load_rig("tank", own), smolbot.load_robot("gradient")
shot = smolbot.Shot((smolbot.Excite((5.0, 5.0), 103.5, 5), smolbot.RingDown(0.02), smolbot.Listen(20, 103.5)))
with TankWorld.open(rig, robot, (0.004, -0.006), seed=3) as lab:
    recording = lab.play(shot)
print(smolbot.Localizer(smolbot.SensorArray(places, axes), robot.device).locate(recording))
