"""Move the robot 30 mm in, under the guard that stops it if a sample is late, and back out."""

import sys
import time

from needleplan.devices import open_stage

with open_stage(sys.argv[1]) as stage:
    stage.start()
    for depth_mm in (30.0, 0.0):
        stage.insert(depth_mm, 10.0)
        while (sample := stage.read(1.0)) is None or sample.moving:
            stage.heartbeat()
        print(f"depth {sample.depth_mm:.2f} mm")
        time.sleep(0.1)
