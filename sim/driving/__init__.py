"""The modular driving system under test: camera geometry, perception after detection, planning, control."""
