"""Records force samples at 1,000 Hz and prints every number once it has been put, until somebody kills it."""

import os
import sys
import time

from needleplan.recording import EVENT, Recorder, Session

with Recorder(sys.argv[1], Session("killed")) as recorder:
    ticks = recorder.channel("/ticks", EVENT)
    number = 0
    while True:
        number += 1
        now_ns = time.monotonic_ns()
        ticks.put(now_ns, {"number": number})
        os.write(1, f"{number} {now_ns}\n".encode())
        time.sleep(0.001)
