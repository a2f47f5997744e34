"""A control side in a process of its own: moves the robot at an address and reads on until it is ended.

Prints `moving` once it does, and what fault ends it.
"""

import sys

from needleplan.devices.robot import RobotStage, RobotTiming
from needleplan.errors import DeviceFault

if __name__ == "__main__":
    # A robot that has to wait for a processor is not silent.
    stage = RobotStage.open(sys.argv[1], timing=RobotTiming(answer_s=20.0, lost_s=20.0))
    stage.insert(170.0, 5.0)
    said = False
    try:
        while True:
            stage.heartbeat()
            sample = stage.read(0.1)
            if sample is not None and sample.depth_mm > 0.1 and not said:
                said = True
                print("moving", flush=True)
    except DeviceFault as fault:
        print(fault, flush=True)
