"""Write three tracked insertions as a lab's own program may write them: ms, cm, and names of its own."""

import numpy as np

random = np.random.default_rng(7)
for number in range(1, 4):
    depth_mm = np.linspace(0, 80, 240)
    radius_mm = random.normal(65, 1.5)
    across_mm = radius_mm * (1 - np.cos(depth_mm / radius_mm)) + random.normal(0, 0.05, 240)
    along_mm = radius_mm * np.sin(depth_mm / radius_mm) + random.normal(0, 0.05, 240)
    table = np.column_stack([1e3 * depth_mm / 10, depth_mm / 10, along_mm / 10, across_mm / 10])
    header = "clock,pushed,tip_along,tip_across"
    np.savetxt(f"insertion_{number}.csv", table, delimiter=",", header=header, comments="", fmt="%.5f")
