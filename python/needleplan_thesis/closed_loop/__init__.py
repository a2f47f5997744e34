"""The closed loop in lab twins with a hidden effect: plan, insert, diagnose, plan with the diagnosed model, insert."""
