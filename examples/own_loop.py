"""The loop, written by hand: one cycle at a time, with every output at zero once the block is left."""

from contextlib import closing

import smolbot
from smolbot.errors import RigError
from smolbot.flight import make_loop, open_rig

mission = smolbot.load_mission("line")
try:
    # Whatever happens in this block (the path's end, Ctrl-C, an error of yours), its end brings every output to zero.
    with closing(open_rig(mission, seed=3)) as rig, make_loop(rig, mission) as loop:
        while not loop.done:
            record = loop.step()  # a shot is checked and played, a pose is estimated and tracked, the law is called
            pose, number = record.trusted, len(loop.run.cycles)
            if pose is not None and number % 20 == 0:
                x, y, z = 1e3 * pose.position  # mm
                print(f"{record.ended:6.2f} s  {record.shot.mode:6}  ({x:5.2f}, {y:5.2f}, {z:5.2f}) mm")
            if record.command.saturated and number > 500:
                break  # a rule of your own: leaving the block stops the robot
except RigError as error:  # the world failed, or the safety stopped it; outputs are at zero by now
    print(f"stopped: {error}")
run = loop.run
print(f"{run.status}: {run.stop_reason}, after {len(run.cycles)} cycles and {run.duration:.0f} s")
