"""
A target that cannot be reached
===============================

A ring of bone closes the target in. The plan converges and says so: no entry has any chance.
"""

import needleplan as npl

table = npl.plan("unreachable")
entry = table.best_entry()
print(f"{table.stats.status}, best success {entry.success:.2f}")
table.plot()
