"""Emergency braking: a camera, a detector, a brake, and a pedestrian who steps out between parked cars."""
