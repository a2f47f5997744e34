"""The circle, in lab twins that hide something: plan, insert, diagnose, plan with what was named, insert again."""
