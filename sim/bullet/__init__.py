"""All code that needs PyBullet."""
