"""The emergency-braking episode: a camera, a detector, a brake, and somebody who steps out between parked cars."""
