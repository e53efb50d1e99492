"""Everything that needs PyBullet."""
