"""Plan, execute and diagnose the steering of flexible bevel-tip needles."""
