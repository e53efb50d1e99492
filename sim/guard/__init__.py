"""The guard: a runtime monitor that judges from what a car can observe whether it is about to become unsafe."""
